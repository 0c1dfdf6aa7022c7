"""The journal on real files: commits, kills, full disks, retention, and numbers that never repeat."""

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import textwrap
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from readings import START, fill, numbers, reading

from sagnode.daemon.journal import Journal
from sagnode.daemon.journal_file import SCHEMA_VERSION
from sagnode.daemon.journal_table import used_bytes
from sagnode.errors import JournalError

NOW = datetime(2026, 7, 1, tzinfo=UTC)


def test_a_burst_is_committed_whole_and_found_again(path):
    journal = Journal(path)
    fill(journal, 2)
    journal.close()
    again = Journal(path)
    assert numbers(again) == [1, 2, 3, 4, 5, 6]
    assert again.next_sequence == 7
    assert json.loads(again.pending(0, 1)[0].json)["sag_m"] == 8.0
    assert [row.sequence for row in again.latest_pending()] == [4, 5, 6]
    assert again.note == "ok"


def test_numbers_are_given_by_the_journal(path):
    journal = Journal(path)
    numbered = journal.append([reading(77), reading(77, "L2")], owed=True)
    assert [r.sequence for r in numbered] == [1, 2]
    assert [json.loads(row.json)["sequence"] for row in journal.pending(0, 9)] == [1, 2]


def test_delivered_is_not_owed(path):
    journal = Journal(path)
    fill(journal, 2)
    journal.mark_delivered([1, 4, 6], NOW)
    assert numbers(journal) == [2, 3, 5]
    backlog = journal.backlog()
    assert backlog.depth == 3
    assert backlog.oldest_acquired_at == START + timedelta(minutes=30)


def test_the_recent_ones_are_there_delivered_or_not_oldest_first(path):
    journal = Journal(path)
    fill(journal, 3)
    journal.mark_delivered([6, 7], NOW)
    assert [row.sequence for row in journal.recent(5)] == [5, 6, 7, 8, 9]
    with sqlite3.connect(path) as db:
        db.execute("UPDATE readings SET json = replace(json, '8.0', '9.0') WHERE sequence = 8")
    assert [row.sequence for row in journal.recent(5)] == [5, 6, 7, 9]
    assert [row.sequence for row in journal.recent(3)] == [6, 7, 9]


def test_without_a_broker_nothing_is_owed(path):
    journal = Journal(path)
    fill(journal, 1, owed=False)
    assert journal.backlog().depth == 0
    assert journal.latest_pending() == []


def test_durable_settings_are_in_force(path):
    journal = Journal(path)
    assert journal._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert journal._db.execute("PRAGMA synchronous").fetchone() == (2,)
    assert journal._db.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)


def test_others_read_while_it_writes(path):
    journal = Journal(path)
    fill(journal, 1)
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as reader:
        assert reader.execute("SELECT count(*) FROM readings").fetchone() == (3,)
        fill(journal, 1)
        assert reader.execute("SELECT count(*) FROM readings").fetchone() == (6,)


def test_two_threads_share_it(path):
    journal = Journal(path)
    faults = []

    def deliver():
        try:
            for _ in range(60):
                journal.mark_delivered([row.sequence for row in journal.pending(0, 5)], NOW)
        except (JournalError, sqlite3.Error) as error:
            faults.append(error)

    thread = threading.Thread(target=deliver)
    thread.start()
    fill(journal, 60, ("L1",))
    thread.join()
    assert faults == []
    assert journal.next_sequence == 61


WRITER = textwrap.dedent(
    """
    import sys
    from pathlib import Path
    sys.path.insert(0, {here!r})
    from readings import fill, numbers
    from sagnode.daemon.journal import Journal
    journal = Journal(Path(sys.argv[1]))
    while True:
        first = journal.next_sequence
        fill(journal, 1)
        print(first + 2, flush=True)
    """
)


def test_killed_at_random_moments_it_loses_nothing_and_repeats_nothing(path):
    script = WRITER.format(here=str(Path(__file__).parents[1] / "support"))
    acknowledged = 0
    chance = random.Random(7)
    for _ in range(6):
        process = subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE, text=True)
        lines = [process.stdout.readline() for _ in range(chance.randint(1, 40))]
        process.send_signal(signal.SIGKILL)
        lines += process.stdout.readlines()
        process.wait()
        acknowledged = max([acknowledged, *(int(line) for line in lines if line.endswith("\n"))])
        journal = Journal(path)
        held = numbers(journal)
        assert held == list(range(1, len(held) + 1))
        assert len(held) >= acknowledged
        assert journal.note == "ok"
        journal.close()


def test_a_full_disk_is_an_error_and_the_same_numbers_work_later(path):
    journal = Journal(path)
    fill(journal, 1)
    pages = journal._db.execute("PRAGMA page_count").fetchone()[0]
    journal._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(JournalError, match="full"):
        fill(journal, 20)
    reached = journal.next_sequence
    journal._db.execute("PRAGMA max_page_count = 100000")
    fill(journal, 1)
    assert numbers(journal) == list(range(1, reached + 3))


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk needs root")
def test_a_small_disk_that_fills_recovers_by_itself(tmp_path):
    small = tmp_path / "small"
    small.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(small)], check=False).returncode:
        pytest.skip("this machine does not allow a mount")
    try:
        journal = Journal(small / "journal.sqlite")
        fill(journal, 3)
        ballast = small / "ballast"
        with pytest.raises(OSError, match="space"):
            ballast.write_bytes(b"x" * 2_000_000)
        with pytest.raises(JournalError, match="df"):
            fill(journal, 100)
        before = journal.next_sequence
        ballast.unlink()
        fill(journal, 3)
        assert journal.next_sequence == before + 9
        journal.close()
        again = Journal(small / "journal.sqlite")
        assert numbers(again) == list(range(1, before + 9))
        again.close()
    finally:
        subprocess.run(["umount", "-l", str(small)], check=False)


def test_a_directory_that_is_missing_is_one_clear_error(tmp_path):
    with pytest.raises(JournalError, match="check the disk"):
        Journal(tmp_path / "nowhere" / "journal.sqlite")


def test_a_later_schema_is_refused_and_left_alone(path):
    Journal(path).close()
    with sqlite3.connect(path) as db:
        db.execute("PRAGMA user_version = 99")
    with pytest.raises(JournalError, match="later sagnode"):
        Journal(path)
    assert not list(path.parent.glob("*damaged*"))


def test_age_deletes_only_what_is_not_owed(path):
    journal = Journal(path)
    fill(journal, 10, ("L1",))
    journal.mark_delivered([1, 2, 3, 10], NOW)
    assert journal.prune(max_bytes=1e9, older_than=NOW) == 0
    assert [s for (s,) in journal._db.execute("SELECT sequence FROM readings")] == [4, 5, 6, 7, 8, 9, 10]


def test_size_takes_what_is_owed_last_and_says_so(path):
    journal = Journal(path)
    fill(journal, 400)
    journal.mark_delivered(range(300, 1201), NOW)
    full = used_bytes(journal._db)
    assert journal.prune(max_bytes=0.5 * full, older_than=None) == 0
    assert journal.backlog().depth == 299
    assert journal.note == "ok"
    lost = journal.prune(max_bytes=20_000, older_than=None)
    assert lost == 299
    assert "299 undelivered readings deleted" in journal.note
    assert journal.next_sequence == 1201
    journal.close()
    assert Journal(path).next_sequence == 1201
