"""What a disk refuses is neither lost nor recorded twice, over restarts too; real journals, real files."""

import os
import shutil
import subprocess
from datetime import UTC, datetime

import pytest
from readings import reading

from sagnode.daemon.journal import Journal
from sagnode.daemon.recorder import Recorder
from sagnode.daemon.spool import Spool
from sagnode.daemon.store import Stores
from sagnode.errors import DiskError, SagnodeError


def refuse(journal):
    """A full disk: not a page more than now. Returns how many readings still went into the last pages."""
    journal._db.execute("PRAGMA max_page_count = 1")
    count = 0
    try:
        while True:
            journal.append([reading(1000 + count, "filler")], owed=False)
            count += 1
    except DiskError:
        return count


def recorder(journal, tmp_path):
    return Recorder(journal, owed=True, keep_days=400, keep_mb=100, spool=Spool(tmp_path / "spool"))


def held(journal):
    return [(row.sequence, row.conductor) for row in journal.pending(0, 1000)]


def test_what_waits_outlives_the_process(tmp_path):
    journal = Journal(tmp_path / "journal.sqlite")
    fillers = refuse(journal)
    first = recorder(journal, tmp_path)
    for number in range(1, 6):
        first.record([reading(number), reading(number, "L2")])
    assert first.waiting == 5
    first.finish()
    journal.close()
    journal = Journal(tmp_path / "journal.sqlite")
    second = recorder(journal, tmp_path)
    assert second.waiting == 0
    assert held(journal) == [(fillers + n, "L1" if n % 2 else "L2") for n in range(1, 11)]
    assert not (tmp_path / "spool").exists()


def test_a_process_killed_before_it_cleared_the_spool_records_nothing_twice(tmp_path):
    journal = Journal(tmp_path / "journal.sqlite")
    fillers = refuse(journal)
    first = recorder(journal, tmp_path)
    for number in range(1, 4):
        first.record([reading(number)])
    shutil.copy(tmp_path / "spool", tmp_path / "kept")
    journal._db.execute("PRAGMA max_page_count = 100000")
    first.retry()
    shutil.copy(tmp_path / "kept", tmp_path / "spool")
    recorder(journal, tmp_path)
    assert held(journal) == [(fillers + 1, "L1"), (fillers + 2, "L1"), (fillers + 3, "L1")]


def test_a_line_that_was_cut_or_flipped_is_passed_over(tmp_path):
    spool = Spool(tmp_path / "spool")
    for number in range(1, 4):
        spool.keep([reading(number)])
    data = bytearray((tmp_path / "spool").read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "spool").write_bytes(data[:-20])
    assert [burst[0].sequence for burst in spool.load()] == [1]


def test_a_commit_that_ended_with_an_error_and_was_made_is_not_made_again(tmp_path):
    journal = Journal(tmp_path / "journal.sqlite")
    burst = [reading(1), reading(1, "L2")]
    numbered = journal.append(burst, owed=True)
    journal._suspect = True  # as after a COMMIT that said I/O error
    assert journal.append(burst, owed=True) == numbered
    assert len(held(journal)) == 2


def test_without_any_place_it_is_said(tmp_path, caplog):
    journal = Journal(tmp_path / "journal.sqlite")
    refuse(journal)
    (tmp_path / "spool").mkdir()
    alone = recorder(journal, tmp_path)
    alone.record([reading(1)])
    alone.finish()
    assert "1 bursts of readings are lost with this process" in caplog.text


# -- the state directory and its substitute in memory


@pytest.fixture
def small_disk(tmp_path):
    """A disk of one megabyte that can be made read-only."""
    if os.geteuid() != 0:
        pytest.skip("mounting a small disk needs root")
    place = tmp_path / "disk"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "none", place], check=False).returncode:
        pytest.skip("no tmpfs can be mounted here")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_a_read_only_card_is_replaced_by_memory_and_carried_over_later(tmp_path, small_disk):
    state, runtime = small_disk / "state", tmp_path / "run"
    runtime.mkdir()
    stores = Stores(state, runtime)
    with stores.opened() as store:
        assert not store.volatile
        store.journal.append([reading(1)], owed=True)
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with stores.opened() as store:
        assert store.volatile
        assert "lost with the power" in store.journal.note
        made = store.journal.append([reading(2)], owed=True)
        assert made[0].sequence > 1000  # no number of the card's own can meet it
        stores._looked_at = float("-inf")
        assert not stores.better(0)
    subprocess.run(["mount", "-o", "remount,rw", small_disk], check=True)
    with stores.opened():
        stores._looked_at = float("-inf")
        assert stores.better(0)
    with stores.opened() as store:
        assert not store.volatile
        assert [row.sequence for row in store.journal.pending(0, 10)] == [1, made[0].sequence]
        assert store.journal.next_sequence > made[0].sequence
    assert not (runtime / "volatile").exists()


def test_a_disk_that_refuses_for_long_is_left_until_it_has_room(tmp_path, small_disk):
    runtime = tmp_path / "run"
    runtime.mkdir()
    stores = Stores(small_disk / "state", runtime)
    with stores.opened():
        assert not stores.better(refused_s=59)
        assert stores.better(refused_s=61)
    (small_disk / "ballast").write_bytes(bytes(3_500_000))
    with stores.opened() as store:
        assert store.volatile
        stores._looked_at = float("-inf")
        assert not stores.better(0)
        (small_disk / "ballast").unlink()
        assert not stores.better(0)  # it looks once a minute
        stores._looked_at = float("-inf")
        assert stores.better(0)


def test_a_disk_without_room_for_what_is_in_memory_waits_and_gets_it_whole(tmp_path, small_disk):
    runtime = tmp_path / "run"
    runtime.mkdir()
    stores = Stores(small_disk / "state", runtime)
    with stores.opened():
        assert stores.better(refused_s=61)
    with stores.opened() as store:
        for number in range(1, 901, 30):
            store.journal.append([reading(number + i) for i in range(30)], owed=True)
        store.journal.mark_delivered([store.journal.next_sequence - 1], reading(1).acquired_at)
        in_memory = sum(file.stat().st_size for file in store.directory.iterdir())
        assert in_memory > 1_500_000
        (small_disk / "ballast").write_bytes(bytes(3_800_000 - in_memory))
        stores._looked_at = float("-inf")
        assert not stores.better(0)  # a megabyte would go in, all of them would not
        (small_disk / "ballast").unlink()
        stores._looked_at = float("-inf")
        assert stores.better(0)
        home = Journal(small_disk / "state" / "journal.sqlite")
        assert home.adopt(store.journal.path) == 900  # what was taken over in part is taken over again
        home.close()
    with stores.opened() as store:
        assert len(store.journal.pending(0, 5000)) == 899
        log_file = store.journal.path.with_name("journal.sqlite-wal")
        assert log_file.stat().st_size < in_memory  # carried in pieces: twice the room is not needed


def test_a_disk_with_another_number_is_known_by_its_count_and_an_empty_one_is_not(tmp_path, small_disk):
    state, runtime = small_disk / "state", tmp_path / "run"
    runtime.mkdir()
    stores = Stores(state, runtime)
    with stores.opened() as store:
        store.journal.append([reading(1)], owed=True)
        assert stores.better(refused_s=61)
    shutil.copytree(state, tmp_path / "kept")
    with stores.opened() as store:
        assert store.volatile
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "none", small_disk], check=True)
        try:
            stores._looked_at = float("-inf")
            assert not stores.better(0)  # empty: counting would begin anew on it
            shutil.rmtree(state)
            shutil.copytree(tmp_path / "kept", state)
            stores._looked_at = float("-inf")
            assert stores.better(0)
        finally:
            subprocess.run(["umount", "-l", small_disk], check=True)


def test_a_second_homecoming_brings_what_was_delivered_meanwhile(tmp_path):
    for place in ("away", "home"):
        (tmp_path / place).mkdir()
    away, home = (Journal(tmp_path / place / "journal.sqlite") for place in ("away", "home"))
    away.append([reading(n) for n in range(1, 6)], owed=True)
    assert home.adopt(away.path) == 5
    away.mark_delivered([1, 2], reading(9).acquired_at)
    home.mark_delivered([5], reading(9).acquired_at)
    assert home.adopt(away.path) == 5
    assert [row.sequence for row in home.pending(0, 10)] == [3, 4]


def test_without_a_directory_in_memory_the_refusal_stands(tmp_path, small_disk):
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with pytest.raises(DiskError, match="Read-only"), Stores(small_disk / "state", None).opened():
        pass


def test_two_do_not_share_a_directory(tmp_path):
    with (
        Stores(tmp_path, None).opened(),
        pytest.raises(SagnodeError, match="in use by another"),
        Stores(tmp_path, None).opened(),
    ):
        pass


def test_a_limit_of_ages_ago_keeps_everything_at_any_time_of_the_clock(tmp_path):
    """A date before the first one there is would end the daemon at its first reading."""
    journal = Journal(tmp_path / "journal.sqlite")
    for keep_days in (1e6, 1e9, 1e300):
        keeper = Recorder(journal, owed=False, keep_days=keep_days, keep_mb=100)
        keeper.record([reading(1)])
        for now in (datetime(1970, 1, 1, tzinfo=UTC), datetime(2026, 6, 21, tzinfo=UTC)):
            keeper._pruned_at = float("-inf")
            keeper.prune(now, clock_synced=True)
    assert len(journal.find([reading(1)])) == 1
    journal.close()
