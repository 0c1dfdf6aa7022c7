"""A journal that is being mended when the process is killed: whatever was done by then, nothing is lost or repeated."""

import random
import shutil
import sqlite3
from functools import partial

import pytest
from readings import fill
from steps import killed_before, lines_of

from sagnode.daemon import journal as journal_module
from sagnode.daemon.journal import Journal
from sagnode.daemon.sequence import BLOCK
from sagnode.errors import DiskError

BURSTS = 12
USED = 3 * BURSTS
STEP = 25
"""Every so many lines here; the fault campaign tries hundreds."""


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A node's directory as a kill leaves it: half of the readings in the log alone."""
    live, copy = tmp_path_factory.mktemp("live"), tmp_path_factory.mktemp("original")
    journal = Journal(live / "journal.sqlite", "boot-1")
    fill(journal, BURSTS // 2)
    journal.close()
    journal = Journal(live / "journal.sqlite", "boot-1")
    fill(journal, BURSTS - BURSTS // 2)
    for file in live.iterdir():
        shutil.copy(file, copy)
    journal.close()
    return copy


def overwrite(path, at, size):
    data = bytearray(path.read_bytes())
    data[at : at + size] = random.Random(1).randbytes(len(data[at : at + size]))
    path.write_bytes(data)


DAMAGES = {
    "file": lambda place: overwrite(place / "journal.sqlite", 4096, 6000),
    "file and log": lambda place: (
        overwrite(place / "journal.sqlite", 8192, 3000),
        overwrite(place / "journal.sqlite-wal", 20_000, 300),
    ),
    "log": lambda place: overwrite(place / "journal.sqlite-wal", 20_000, 300),
    "gone": lambda place: (place / "journal.sqlite").unlink(),
}


def numbers(journal):
    return {row.sequence for row in journal.pending(0, 10_000)}


def open_and_close(place, boot_id):
    Journal(place / "journal.sqlite", boot_id).close()


@pytest.mark.parametrize("boot_id", ["boot-1", "boot-2"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_killed_at_any_line_the_next_start_finds_the_same_and_counts_on(original, tmp_path, damage, boot_id):
    def damaged(name):
        place = tmp_path / name
        shutil.copytree(original, place)
        DAMAGES[damage](place)
        return place

    whole = damaged("whole")
    lines = lines_of(partial(open_and_close, whole, boot_id))
    undisturbed = Journal(whole / "journal.sqlite", boot_id)
    expected = numbers(undisturbed)
    assert undisturbed.next_sequence > USED
    undisturbed.close()
    for line in lines[random.Random(damage + boot_id).randrange(STEP) :: STEP]:
        place = damaged("killed")
        killed_before(partial(open_and_close, place, boot_id), line)
        journal = Journal(place / "journal.sqlite", boot_id)
        assert numbers(journal) == expected, line
        assert USED < journal.next_sequence <= USED + 5 * BLOCK, line
        assert {path.name for path in place.iterdir() if path.suffix in {".begun", ".mended", ".kept"}} == set()
        journal.close()
        shutil.rmtree(place)


def test_a_log_that_waits_for_its_journal_is_kept_once(original, tmp_path, monkeypatch):
    place = tmp_path / "state"
    shutil.copytree(original, place)

    def refuse(_):
        raise sqlite3.OperationalError("database or disk is full")

    size = (place / "journal.sqlite-wal").stat().st_size
    with monkeypatch.context() as full:
        full.setattr(journal_module, "open_file", refuse)
        for _ in range(3):
            with pytest.raises(DiskError):
                Journal(place / "journal.sqlite", "boot-2")
    assert (place / "journal.sqlite-wal.kept").stat().st_size == size
    journal = Journal(place / "journal.sqlite", "boot-2")
    assert len(numbers(journal)) == USED
    journal.close()
    assert not (place / "journal.sqlite-wal.kept").exists()
