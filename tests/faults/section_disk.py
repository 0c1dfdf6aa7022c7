"""Disks that are full, read-only, broken, slow or gone, under the journal; each is made well again after a while."""

import contextlib
import os
import subprocess
import time

from campaign import Skip
from rig import Rig
from section_broker import acknowledged_since
from table import Line
from volatile_disk import VolatileDisk, available
from volatile_disk import run as command

SOON = {"daemon.store.DISTRUST_AFTER_S": 1.0, "daemon.store.LOOK_AGAIN_S": 0.5}
"""The shipped daemon waits a minute before it leaves a disk, and another before it looks at it again."""


class SmallDisk:
    """A tmpfs that can be filled, made read-only, and taken away."""

    def __init__(self, place, megabytes):
        self.place = place
        place.mkdir(parents=True)
        command("mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "none", place)

    def fill(self):
        with (self.place / "ballast").open("ab", buffering=0) as ballast:
            try:
                while ballast.write(bytes(4096)):
                    pass
            except OSError:
                return

    def empty(self):
        (self.place / "ballast").unlink(missing_ok=True)

    def remount(self, how):
        for _ in range(50):  # busy for as long as somebody is writing
            done = subprocess.run(["mount", "-o", f"remount,{how}", self.place], check=False, capture_output=True)
            if done.returncode == 0:
                return
            time.sleep(0.02)
        raise OSError(done.returncode, done.stderr.decode())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        subprocess.run(["umount", "-l", self.place], check=False)


def run_full(campaign, times, *, kill):
    """Full; the daemon waits for space, or is killed and started on the full disk."""
    directory = campaign.fresh("disk")
    with SmallDisk(directory / "disk", 12) as disk:
        with Rig(directory, state_dir=disk.place / "state", runtime=True, virtual=False) as rig:
            recovery = []
            rig.start()
            rig.wait_good(2)
            for _ in range(times):
                disk.fill()
                time.sleep(campaign.random.uniform(0.2, 1.0))
                if kill:
                    rig.kill()
                    rig.start()
                    time.sleep(campaign.random.uniform(0.0, 1.5))
                disk.empty()
                recovery.append(recorded_again(rig))
            rig.last_run()
            title = "disk full, and the daemon killed meanwhile" if kill else "disk full (ENOSPC)"
            return of(title, times, rig, recovery, gaps=kill)


def run_read_only(campaign, times):
    """The card was found damaged at boot and mounted read-only; later somebody makes it well, or it is replaced."""
    directory = campaign.fresh("disk")
    with SmallDisk(directory / "disk", 12) as disk:
        with Rig(directory, state_dir=disk.place / "state", runtime=True, virtual=False, sets=SOON) as rig:
            recovery = []
            rig.start()
            rig.wait_good(2)
            for number in range(times):
                rig.kill()
                disk.remount("ro")
                rig.start()
                rig.wait_for(lambda: (p := rig.page()) and "in memory" in p["health"]["journal"], 60)
                acknowledged_since(rig, time.monotonic())  # published as ever
                rig.wait_good(2)
                if number % 3 == 2:
                    rig.kill()  # what is in memory outlives the process
                    rig.start()
                    rig.wait_good(2)
                disk.remount("rw")
                recovery.append(recorded_again(rig))
            rig.last_run()
            title = "disk read-only at the start (EROFS): journal in memory, published, carried over"
            return of(title, times, rig, recovery, gaps=True)


def run_errors(campaign, times):
    directory = campaign.fresh("disk")
    with VolatileDisk(directory / "disk", 16, campaign.random) as disk:
        with Rig(directory, state_dir=disk.place / "state", runtime=True, virtual=False, sets=SOON) as rig:
            recovery = []
            rig.start()
            rig.wait_good(2)
            for _ in range(times):
                disk.failing = True
                # the kernel makes it read-only, and the node leaves it
                rig.wait_for(lambda: (p := rig.page()) and "in memory" in p["health"]["journal"], 90)
                rig.wait_good(1)
                disk.failing = False
                unmounted(disk)  # somebody repairs it and mounts it again
                time.sleep(campaign.random.uniform(0.0, 1.0))
                subprocess.run(["fsck.ext4", "-p", disk.device], check=False, capture_output=True)
                disk.mount()
                recovery.append(recorded_again(rig))
            refused = disk.refused
            rig.last_run()
            return of("disk answers with EIO, turns read-only, is gone, and is mounted again", times, rig, recovery,
                      gaps=True, remark=f"{refused} requests refused")  # fmt: skip


def unmounted(disk):
    """Busy for the moments in which the node looks whether it is well again."""
    for _ in range(200):
        with contextlib.suppress(OSError):
            return disk.unmount()
        time.sleep(0.05)
    return disk.unmount()


def run_slow(campaign, times):
    directory = campaign.fresh("disk")
    with VolatileDisk(directory / "disk", 16, campaign.random) as disk:
        with Rig(directory, state_dir=disk.place / "state", runtime=True, virtual=False) as rig:
            recovery = []
            rig.start()
            rig.wait_good(2)
            for _ in range(times):
                disk.slow_s = campaign.random.uniform(0.05, 0.6)
                time.sleep(campaign.random.uniform(1.0, 3.0))
                disk.slow_s = 0.0
                recovery.append(recorded_again(rig))
            rig.last_run()
            return of("disk that takes up to 0.6 s for each request", times, rig, recovery)


def run(campaign):
    if os.geteuid() != 0:
        raise Skip("mounting small disks needs root")
    yield run_full(campaign, campaign.count(12), kill=False)
    yield run_full(campaign, campaign.count(8), kill=True)
    yield run_read_only(campaign, campaign.count(8))
    missing = available()
    if missing:
        raise Skip(missing)
    yield run_errors(campaign, campaign.count(8))
    yield run_slow(campaign, campaign.count(5))


def recorded_again(rig):
    """Seconds until a reading that is made from now on is acknowledged and the state directory has it."""
    began = time.monotonic()

    def home():
        page = rig.page()
        return page and page["written_monotonic_s"] > began and page["health"]["journal"] == "ok"

    rig.wait_for(home, 60, 0.02)
    rig.wait_for(lambda: rig.witness.first_acknowledged_after(time.monotonic() - 0.3), 60)
    return time.monotonic() - began


def of(title, times, rig, recovery, *, gaps=False, remark=""):
    books = rig.books(allowed_gaps=gaps)
    broken = []
    if books.in_flight > rig.kills:
        broken.append(f"{books.in_flight} answers were never recorded, and the daemon was killed {rig.kills} times")
    if books.gaps:
        remark = f"{remark}{', ' if remark else ''}numbers skipped"
    return Line.of("disk", title, times, books, recovery=recovery, limit_s=60.0, broken=broken, remark=remark,
                   allowed_repeats=(rig.kills + times) * 70)  # fmt: skip
