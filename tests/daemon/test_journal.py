"""The journal on real files: commits, damage, full disks, retention, and numbers that never repeat."""

import json
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import textwrap
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from readings import START, fill, reading

from sagnode.daemon import sequence as sequence_module
from sagnode.daemon.journal import Journal
from sagnode.daemon.journal_file import SCHEMA_VERSION
from sagnode.daemon.journal_table import used_bytes
from sagnode.daemon.wal import lost_frames
from sagnode.errors import DiskError, JournalError

NOW = datetime(2026, 7, 1, tzinfo=UTC)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.sqlite"


def numbers(journal):
    return [row.sequence for row in journal.pending(0, 1_000_000)]


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
    from readings import fill
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


def flip(file, offset, bit=0):
    with file.open("r+b") as stream:
        stream.seek(offset)
        byte = stream.read(1)[0]
        stream.seek(offset)
        stream.write(bytes([byte ^ (1 << bit)]))


def test_a_destroyed_file_is_set_aside_and_numbers_go_on_above(path):
    journal = Journal(path)
    fill(journal, 5)
    journal.close()
    path.write_bytes(b"this is no database" * 1000)
    fresh = Journal(path)
    assert fresh.next_sequence == sequence_module.BLOCK + 1
    assert "damaged" in fresh.note
    assert len(list(path.parent.glob("journal-damaged-*.sqlite"))) == 1
    fill(fresh, 1)
    fresh.close()
    assert Journal(path).next_sequence == sequence_module.BLOCK + 4


def test_a_lost_file_does_not_take_the_count_with_it(path):
    journal = Journal(path)
    fill(journal, 5)
    journal.close()
    path.unlink()
    assert Journal(path).next_sequence == sequence_module.BLOCK + 1


def test_an_old_copy_put_back_does_not_take_the_count_back(path, monkeypatch):
    monkeypatch.setattr(sequence_module, "BLOCK", 10)
    journal = Journal(path)
    fill(journal, 1)
    journal.close()
    old = path.read_bytes()
    journal = Journal(path)
    fill(journal, 10)
    journal.close()
    path.write_bytes(old)
    assert Journal(path).next_sequence > 33


def test_the_ceiling_survives_one_damaged_copy(path):
    journal = Journal(path)
    fill(journal, 1)
    journal.close()
    path.with_name("sequence").write_bytes(b"\xff\x00garbage")
    path.unlink()
    assert Journal(path).next_sequence == sequence_module.BLOCK + 1


def test_a_file_cut_short_gives_back_what_can_be_read(path):
    journal = Journal(path)
    fill(journal, 60)
    journal.close()
    size = path.stat().st_size
    os.truncate(path, size // 2 // 4096 * 4096 + 1000)
    mended = Journal(path)
    held = numbers(mended)
    assert mended.next_sequence == sequence_module.BLOCK + 1
    assert held == sorted(set(held))
    assert len(held) > 30
    assert "damaged" in mended.note


def test_flipped_bits_never_make_a_wrong_number_nor_a_repeated_one(path):
    journal = Journal(path)
    fill(journal, 40)
    journal.close()
    sound = path.read_bytes()
    truth = {row.sequence: row.json for row in Journal(path).pending(0, 1000)}
    chance = random.Random(3)
    for round_ in range(40):
        for old in path.parent.glob("journal*"):
            old.unlink()
        path.write_bytes(sound)
        for _ in range(3):
            flip(path, chance.randrange(len(sound)), chance.randrange(8))
        try:
            journal = Journal(path)
        except JournalError as error:  # the schema version's own byte was hit: told, not overwritten
            assert "later sagnode" in str(error)
            continue
        for row in [*journal.pending(0, 1000), *journal.latest_pending()]:
            assert row.json == truth[row.sequence], round_
        assert journal.next_sequence > 120
        fill(journal, 1)
        journal.close()


def test_damage_in_the_log_is_noticed_and_numbers_leave_a_gap(path):
    journal = Journal(path)
    fill(journal, 4)
    wal = path.with_name(path.name + "-wal")
    copy = path.parent / "copy"
    copy.mkdir()
    for part in path.parent.glob("journal.sqlite*"):
        if not part.name.endswith("-shm"):
            shutil.copy(part, copy / part.name)
    shutil.copy(path.with_name("sequence"), copy / "sequence")
    assert not lost_frames(wal)
    journal.close()
    flip(copy / "journal.sqlite-wal", wal_frames_end(copy / "journal.sqlite-wal") - 3000)
    assert lost_frames(copy / "journal.sqlite-wal")
    mended = Journal(copy / "journal.sqlite")
    assert mended.next_sequence == sequence_module.BLOCK + 1
    assert "gap" in mended.note


def wal_frames_end(wal):
    return wal.stat().st_size


def test_a_torn_tail_of_the_log_is_normal(path, tmp_path):
    journal = Journal(path)
    fill(journal, 2)
    wal = path.with_name(path.name + "-wal")
    torn = tmp_path / "torn-wal"
    torn.write_bytes(wal.read_bytes()[:-1000])
    assert not lost_frames(torn)
    assert not lost_frames(tmp_path / "absent")
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


def test_a_file_that_is_destroyed_under_it_is_mended_at_the_next_attempt(path):
    journal = Journal(path)
    fill(journal, 100)
    journal._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with path.open("r+b") as stream:
        stream.write(os.urandom(20_000))
    journal._db.execute("PRAGMA shrink_memory")  # what SQLite still had in memory would hide it
    with pytest.raises(JournalError):
        fill(journal, 1)
    fill(journal, 1)
    assert "damaged" in journal.note
    assert journal.next_sequence == sequence_module.BLOCK + 4


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


def test_after_a_power_cut_numbers_leave_a_gap_and_after_a_kill_they_do_not(path):
    journal = Journal(path, "boot-1")
    fill(journal, 2, ("L1",))
    del journal  # killed: nothing is folded, no mark is taken away
    journal = Journal(path, "boot-1")
    assert journal.next_sequence == 3
    journal = Journal(path, "boot-2")
    assert journal.next_sequence > 1000
    fill(journal, 1, ("L1",))
    following = journal.next_sequence
    journal.close()
    assert Journal(path, "boot-3").next_sequence == following  # an orderly end of the boot before


def test_a_count_with_a_flipped_digit_is_not_believed(path):
    journal = Journal(path)
    fill(journal, 1, ("L1",))
    journal.close()
    for name in ("sequence", "sequence.copy"):
        file = path.with_name(name)
        file.write_text(file.read_text().replace("1000 ", "91000 "))
    assert Journal(path).next_sequence == 2


def test_readings_behind_a_damaged_page_are_found_by_their_bytes(path):
    journal = Journal(path)
    fill(journal, 100, ("L1", "L2"))
    journal.mark_delivered(range(1, 50), datetime.now(UTC))
    journal.close()
    data = bytearray(path.read_bytes())
    root = next(start for start in range(4096, len(data), 4096) if data[start] == 5)  # the table's only inner page
    data[root : root + 4096] = bytes(4096)
    path.write_bytes(data)
    journal = Journal(path)
    assert journal.backlog().depth == 200 - 49
    assert [row.sequence for row in journal.pending(0, 500)] == list(range(50, 201))


def test_another_disk_at_the_same_place_is_not_counted_on(path, monkeypatch):
    journal = Journal(path)
    fill(journal, 1, ("L1",))
    journal._suspect, journal._device = True, -1
    with pytest.raises(DiskError, match="another disk"):
        fill(journal, 1, ("L1",))
