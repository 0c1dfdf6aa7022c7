"""A journal whose file is removed or replaced while the daemon has it open."""

import os
import shutil
import sqlite3
import subprocess
import sys
import textwrap

import pytest
from nodes import readings, start_daemon, status, wait_for, write_node
from readings import START, fill

from sagnode.daemon.journal import Journal
from sagnode.errors import JournalError


def kept(path):
    """Numbers and fates on the disk, for whoever comes next."""
    journal = Journal(path)
    try:
        assert journal._db.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        return dict(journal._db.execute("SELECT sequence, fate FROM readings ORDER BY sequence"))
    finally:
        journal.close()


FATES = {1: "delivered", 2: "pending", 3: "pending", 4: "pending"}


@pytest.mark.parametrize("names", [("journal.sqlite",), ("journal.sqlite", "journal.sqlite-wal", "journal.sqlite-shm")])
@pytest.mark.parametrize("folded", [True, False])
def test_a_removed_journal_is_put_back_with_the_next_reading(path, names, folded):
    journal = Journal(path)
    fill(journal, 3, ("L1",))
    journal.mark_delivered([1], START)
    if folded:
        journal._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    for name in names:
        path.with_name(name).unlink()
    fill(journal, 1, ("L1",))
    assert path.exists()
    assert "was removed while it was in use" in journal.note
    assert journal.backlog().depth == 3
    assert [row.sequence for row in journal.pending(0, 10)] == [2, 3, 4]
    journal.close()
    assert kept(path) == FATES
    assert sorted(file.name for file in path.parent.glob("journal*")) == ["journal.sqlite"]


def test_what_is_acknowledged_while_its_name_is_gone_stays_so(path):
    journal = Journal(path)
    fill(journal, 3, ("L1",))
    path.unlink()
    journal.mark_delivered([1], START)
    fill(journal, 1, ("L1",))
    journal.close()
    assert kept(path) == FATES


def test_without_a_further_reading_it_is_put_back_at_the_end(path):
    journal = Journal(path)
    fill(journal, 4, ("L1",))
    journal.mark_delivered([1], START)
    path.unlink()
    journal.close()
    assert kept(path) == FATES


def test_a_file_in_its_place_gets_what_it_has_not(path, tmp_path):
    journal = Journal(path)
    fill(journal, 2, ("L1",))
    backup = tmp_path / "backup"
    with sqlite3.connect(path) as db:
        db.execute("VACUUM INTO ?", (str(backup),))
    journal.mark_delivered([1], START)
    fill(journal, 1, ("L1",))
    for file in path.parent.glob("journal.sqlite*"):
        file.unlink()
    shutil.move(backup, path)
    fill(journal, 1, ("L1",))
    assert "3 readings were brought back" in journal.note
    journal.close()
    assert kept(path) == FATES
    assert sorted(file.name for file in path.parent.glob("journal*")) == ["journal.sqlite"]


def test_a_directory_that_is_gone_refuses_and_gets_all_of_it_once_it_is_there_again(tmp_path):
    path = tmp_path / "state" / "journal.sqlite"
    path.parent.mkdir()
    journal = Journal(path)
    fill(journal, 3, ("L1",))
    journal.mark_delivered([1], START)
    path.parent.rename(tmp_path / "elsewhere")
    shutil.rmtree(tmp_path / "elsewhere")
    with pytest.raises(JournalError, match=r"journal\.sqlite"):
        fill(journal, 1, ("L1",))
    path.parent.mkdir()
    fill(journal, 1, ("L1",))
    journal.close()
    assert kept(path) == FATES


KILLED = """
import os, sys
sys.path[:0] = {paths!r}
from pathlib import Path
from readings import fill
from sagnode.daemon import removed
from sagnode.daemon.journal import Journal
from readings import START
path = Path(sys.argv[1])
journal = Journal(path)
fill(journal, 3, ("L1",))
journal.mark_delivered([1], START)
path.unlink()
removed.Removal.put_back = lambda self: os._exit(9)
fill(journal, 1, ("L1",))
"""


def test_killed_between_the_copy_and_its_place_nothing_is_lost(path):
    code = textwrap.dedent(KILLED.format(paths=[p for p in sys.path if p]))
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False).returncode == 9
    assert not path.exists()
    assert kept(path) == {number: FATES[number] for number in (1, 2, 3)}


@pytest.mark.skipif(os.geteuid() != 0, reason="mounts a disk, which only root can")
def test_on_a_disk_without_room_for_the_copy_the_reading_waits(tmp_path):
    place = tmp_path / "small"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "none", place], check=False).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        journal = Journal(place / "journal.sqlite")
        fill(journal, 100, ("L1",))
        (place / "journal.sqlite").unlink()
        room = os.statvfs(place)
        ballast = place / "ballast"
        ballast.write_bytes(bytes(room.f_bavail * room.f_frsize))
        with pytest.raises(JournalError, match="full"):
            fill(journal, 1, ("L1",))
        ballast.unlink()
        fill(journal, 1, ("L1",))
        journal.close()
        assert list(kept(place / "journal.sqlite")) == list(range(1, 102))
    finally:
        subprocess.run(["umount", "-l", place], check=True)


def test_a_running_daemon_loses_nothing_and_says_it(tmp_path):
    node = write_node(tmp_path, more='[mqtt]\nhost = "127.0.0.1"\nport = 1')
    process = start_daemon(node, tmp_path / "log")
    try:
        wait_for(lambda: (s := status(tmp_path)) and s["health"]["readings_made"] >= 6)
        (tmp_path / "state" / "journal.sqlite").unlink()
        wait_for(lambda: "was removed" in status(tmp_path)["health"]["journal"])
        process.terminate()
        assert process.wait(20) == 0
    finally:
        process.kill()
        process.wait()
    made = [reading["sequence"] for reading in readings(tmp_path)]
    assert made == list(range(1, len(made) + 1))
    assert len(made) > 6
