"""The journal after damage, power cuts and other accidents: what is whole comes back, and no number twice."""

import contextlib
import os
import random
import shutil
import sqlite3
from datetime import UTC, datetime

import pytest
from readings import fill, numbers

from sagnode.daemon import salvage
from sagnode.daemon import sequence as sequence_module
from sagnode.daemon.journal import Journal
from sagnode.daemon.wal import lost_frames
from sagnode.errors import DiskError, JournalError

NOW = datetime(2026, 7, 1, tzinfo=UTC)


def flip(file, offset, bit=0):
    with file.open("r+b") as stream:
        stream.seek(offset)
        byte = stream.read(1)[0]
        stream.seek(offset)
        stream.write(bytes([byte ^ (1 << bit)]))


def wal_frames_end(wal):
    return wal.stat().st_size


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


def test_a_torn_tail_of_the_log_is_normal(path, tmp_path):
    journal = Journal(path)
    fill(journal, 2)
    wal = path.with_name(path.name + "-wal")
    torn = tmp_path / "torn-wal"
    torn.write_bytes(wal.read_bytes()[:-1000])
    assert not lost_frames(torn)
    assert not lost_frames(tmp_path / "absent")
    journal.close()


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


def test_a_disk_that_fills_while_a_damaged_file_is_mended_costs_no_reading(path, monkeypatch):
    """The disk's part is played: a real one cannot be made to fill between two rows."""
    journal = Journal(path)
    fill(journal, 50)
    journal.close()
    with path.open("r+b") as stream:
        stream.write(b"not a database any more")
    whole = salvage.salvage

    def cut_short(*words):
        yield next(whole(*words))
        raise sqlite3.OperationalError("database or disk is full")

    with monkeypatch.context() as full:
        full.setattr(salvage, "salvage", cut_short)
        with pytest.raises(DiskError, match="full"):
            Journal(path)
    mended = Journal(path)
    assert numbers(mended) == list(range(1, 151))
    mended.close()


def test_a_reading_whose_conductor_alone_is_damaged_is_restored_from_its_text(path):
    journal = Journal(path)
    fill(journal, 2)
    journal.close()
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute("UPDATE readings SET conductor = 'L\x01', validity = 'gooe' WHERE sequence = 2")
        db.commit()
    journal = Journal(path)
    assert [(row.sequence, row.conductor) for row in journal.pending(0, 3)] == [(1, "L1"), (2, "L2"), (3, "L3")]
    journal.close()
    with contextlib.closing(sqlite3.connect(path)) as db:
        found = db.execute("SELECT conductor, validity, fate FROM readings WHERE sequence = 2").fetchone()
    assert found == ("L2", "good", "pending")
