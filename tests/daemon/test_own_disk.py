"""A missing disk is known before anything is made on its empty mount point; readings and their count go on."""

import os
import shutil
import subprocess

import pytest
from readings import reading

from sagnode.daemon import store as store_module
from sagnode.daemon.own_disk import OwnDisk
from sagnode.daemon.sequence import BLOCK, Ceiling
from sagnode.daemon.store import Stores
from sagnode.errors import DiskError


@pytest.fixture
def disk(tmp_path):
    """A mount point and what puts a disk there; the same one each time."""
    if os.geteuid() != 0:
        pytest.skip("mounting a disk needs root")
    place, elsewhere = tmp_path / "srv disk", tmp_path / "elsewhere"
    place.mkdir()
    elsewhere.mkdir()

    class Disk:
        at = place

        def put_in(self):
            subprocess.run(["mount", "--move", elsewhere, place], check=True)

        def take_out(self):
            subprocess.run(["mount", "--move", place, elsewhere], check=True)

    # A mount can be moved only where its parent mount is private to this test.
    subprocess.run(["mount", "--bind", tmp_path, tmp_path], check=True)
    subprocess.run(["mount", "--make-private", tmp_path], check=True)
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "none", place], check=False).returncode:
        subprocess.run(["umount", "-l", tmp_path], check=True)
        pytest.skip("no tmpfs can be mounted here")
    yield Disk()
    subprocess.run(["umount", "-l", tmp_path], check=True)


@pytest.fixture
def fstab(tmp_path, disk):
    file = tmp_path / "fstab"
    escaped = str(disk.at).replace(" ", r"\040")
    file.write_text(f"# disks\nPARTUUID=1 / ext4 defaults 0 1\nnone /tmp tmpfs\nLABEL=s {escaped} ext4 nofail 0 2\n")
    return file


def test_what_fstab_wants_there_and_is_not_is_named_with_its_remedy(disk, fstab):
    OwnDisk(disk.at / "state", fstab=fstab).expect()
    disk.take_out()
    with pytest.raises(DiskError, match=r"LABEL=s is not mounted on .*srv disk; .*mount .*srv disk"):
        OwnDisk(disk.at / "state", fstab=fstab).expect()
    OwnDisk(disk.at.parent, fstab=fstab).expect()  # another place is no business of that line
    OwnDisk(disk.at / "state", fstab=fstab.with_name("none")).expect()


def test_without_fstab_the_mark_in_the_services_own_directory_tells(tmp_path, disk):
    service = tmp_path / "service"
    service.mkdir()
    own = OwnDisk(disk.at / "state", service, tmp_path / "no-fstab")
    own.expect()  # a new node has no mark
    own.found()
    own.expect()
    disk.take_out()
    with pytest.raises(DiskError, match=r"disk is missing on which it lay; mount it .* delete"):
        own.expect()
    OwnDisk(disk.at / "other", service, tmp_path / "no-fstab").expect()
    (service / "state-disk").unlink()  # as the remedy says
    own.expect()


def test_readings_go_on_in_memory_and_come_home_with_the_disk(tmp_path, disk, fstab):
    runtime = tmp_path / "run"
    runtime.mkdir()

    def stores():
        return Stores(disk.at / "state", runtime, "boot-1", fstab=fstab)

    with stores().opened() as store:
        first = store.journal.append([reading(1)], owed=True)
    disk.take_out()
    away = stores()
    with away.opened() as store:
        assert store.volatile
        assert "LABEL=s is not mounted" in store.journal.note
        second = store.journal.append([reading(2)], owed=True)
        assert not list(disk.at.iterdir())  # nothing is made below the disk
        away._looked_at = float("-inf")
        assert not away.better(0)
        disk.put_in()
        away._looked_at = float("-inf")
        assert away.better(0)
    with away.opened() as store:
        assert not store.volatile
        assert [row.sequence for row in store.journal.pending(0, 9)] == [first[0].sequence, second[0].sequence]
        assert store.journal.next_sequence == second[0].sequence + 1


def test_what_was_counted_in_memory_and_lost_with_it_is_not_given_out_again(tmp_path, disk):
    runtime, service = tmp_path / "run", tmp_path / "service"
    used = [0]

    def one_more(*, volatile):
        runtime.mkdir(exist_ok=True)
        with Stores(disk.at / "state", runtime, "boot-1", service, tmp_path / "no-fstab").opened() as store:
            assert store.volatile == volatile
            (made,) = store.journal.append([reading(1)], owed=True)
            used.append(made.sequence)

    service.mkdir()
    one_more(volatile=False)
    disk.take_out()
    for _ in range(3):
        shutil.rmtree(runtime)  # the power fails
        one_more(volatile=True)
    shutil.rmtree(runtime)
    disk.put_in()
    one_more(volatile=False)
    assert used == sorted(set(used))


def test_a_count_that_runs_ahead_elsewhere_is_brought_home(tmp_path):
    ahead = Ceiling(tmp_path / "elsewhere")
    ahead.cover(5 * BLOCK)
    home = Ceiling(tmp_path / "home", tmp_path / "elsewhere")
    assert home.next_after(None) == 5 * BLOCK + 1
    home.cover(5 * BLOCK + 1)
    assert Ceiling(tmp_path / "home").value == Ceiling(tmp_path / "elsewhere").value == 6 * BLOCK


def test_an_elsewhere_that_refuses_is_no_harm(tmp_path):
    home = Ceiling(tmp_path / "home", tmp_path / "gone" / "elsewhere")
    home.cover(1)
    assert home.value == BLOCK


def test_numbers_that_nobody_can_keep_follow_the_clock_and_chance():
    leap = store_module._leap_over
    at = 1_780_000_000.0
    assert leap(0, at) < leap(0, at + 120) < 2**53
    assert len({leap(0, at) for _ in range(3)}) > 1  # a clock that begins each boot at the same time
    before = leap(0, at)
    assert leap(before, 60.0) > before  # a clock that went back
    assert leap(17 * BLOCK + 3, 0.0) % BLOCK == 0
