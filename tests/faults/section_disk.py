"""Disks that are full, read-only, broken, slow or gone, under the journal; each is made well again after a while."""

import contextlib
import os
import shutil
import subprocess
import time
from functools import partial
from pathlib import Path

from campaign import Skip
from rig import Rig
from section_broker import acknowledged_since
from table import Line
from volatile_disk import VolatileDisk, available
from volatile_disk import run as command

SOON = {"daemon.store.DISTRUST_AFTER_S": 1.0, "daemon.store.LOOK_AGAIN_S": 0.5}
"""The shipped daemon waits a minute before it leaves a disk, and another before it looks at it again."""
MEGABYTES = 24
PEAK_MB = 150.0
"""A daemon that takes more memory than this while its disk is of no use is about to do harm."""


class SmallDisk:
    """A tmpfs that can be filled, made read-only, and taken away."""

    def __init__(self, place, megabytes):
        self.place = place
        self._aside = place.with_name(f"{place.name}-aside")
        place.mkdir(parents=True)
        command("mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "none", place)

    def fill(self, but_mb=0.0):
        """Not a byte is left, or so many megabytes."""
        with (self.place / "ballast").open("ab", buffering=0) as ballast:
            try:
                while (free := shutil.disk_usage(self.place).free) > but_mb * 1e6 or not but_mb:
                    ballast.write(bytes(4096 if free < but_mb * 1e6 + 200_000 else 65536))
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

    def take_out(self):
        """The mount point is an empty directory; what is on the disk stays on it."""
        self._aside.mkdir(exist_ok=True)
        command("mount", "--move", self.place, self._aside)

    def put_in(self):
        command("mount", "--move", self._aside, self.place)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        subprocess.run(["umount", "-lq", self._aside], check=False, capture_output=True)
        subprocess.run(["umount", "-l", self.place], check=False)


def run_full(campaign, times, *, kill):
    """Full; the daemon waits for space, or is killed and started on the full disk."""
    directory = campaign.fresh("disk")
    with SmallDisk(directory / "disk", MEGABYTES) as disk:
        # Who starts on a full disk keeps the readings in memory at once, and looks again later.
        sets = SOON if kill else {}
        with Rig(directory, state_dir=disk.place / "state", runtime=True, virtual=False, sets=sets) as rig:
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
    with SmallDisk(directory / "disk", MEGABYTES) as disk:
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


def run_missing(campaign, times):
    """The disk of the state directory is not there when the node starts; an empty mount point is no new node."""
    directory = campaign.fresh("disk")
    with SmallDisk(directory / "disk", MEGABYTES) as disk:
        with Rig(directory, state_dir=disk.place / "state", runtime=True, virtual=False, sets=SOON) as rig:
            service = directory / "service"  # what systemd gives in any case, on the system's own disk
            service.mkdir()
            recovery, broken, forgotten = [], [], set()
            rig.start(STATE_DIRECTORY=str(service))
            rig.wait_good(2)
            for number in range(times):
                rig.kill()
                disk.take_out()
                known = max(rig.witness.sent)
                rig.start(STATE_DIRECTORY=str(service))
                rig.wait_for(lambda: (p := rig.page()) and "disk is missing" in p["health"]["journal"], 60)
                acknowledged_since(rig, time.monotonic())  # published as ever
                rig.wait_good(2)
                if number % 3 == 2:  # the power fails meanwhile, and memory with it: these were sent, and are gone
                    rig.kill()
                    gone = {n for n in rig.witness.sent if n > known}
                    shutil.rmtree(rig.runtime / "volatile")
                    rig.start(STATE_DIRECTORY=str(service))
                    rig.wait_for(lambda gone=gone: max(rig.witness.sent) > max(gone), 60)
                    later = min(n for n in rig.witness.sent if n not in gone and n > known)
                    if later <= max(gone):
                        broken.append(f"number {later} came after {max(gone)}")
                    forgotten |= gone
                disk.put_in()
                recovery.append(recorded_again(rig))
            rig.last_run()
            for number in forgotten:
                del rig.witness.sent[number]
            return of("disk missing at the start: journal in memory, published, carried over", times, rig, recovery,
                      gaps=True, broken=broken, forgotten=len(forgotten),
                      remark=f"{len(forgotten)} published, and in memory alone when the power failed")  # fmt: skip


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
                unmounted(disk)  # still failing, or the node might be home again before somebody takes it out
                disk.failing = False
                time.sleep(campaign.random.uniform(0.0, 1.0))
                disk.repaired()
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
    raise AssertionError(f"{disk.place} is held by {holders(disk.place)}")


def holders(place):
    """Open files below a directory, with their processes."""
    found = []
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):
            if str(link.readlink()).startswith(str(place)):
                found.append(
                    f"{(link.parents[1] / 'comm').read_text().strip()} {link.parts[2]}: {link.readlink().name}"
                )
    return found


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


def run_pictures_give_way(campaign, times):
    """Readings and pictures on one disk that others fill: the pictures go, and not one reading is refused."""
    directory = campaign.fresh("disk")
    with SmallDisk(directory / "disk", MEGABYTES) as disk:
        with Rig(directory, state_dir=disk.place / "state", virtual=False, pictures=True) as rig:
            drawn = rig.state / "pictures"
            recovery, broken = [], []
            rig.start()
            for _ in range(times):
                rig.wait_for(lambda: list(drawn.glob("*.jpg")), 60)
                disk.fill(but_mb=campaign.random.uniform(1.0, 3.0))
                filled = time.monotonic()
                rig.wait_for(lambda: not list(drawn.glob("*.jpg*")), 60)
                recovery.append(time.monotonic() - filled)
                rig.wait_good(2)
                if rig.page()["health"]["journal"] != "ok":
                    broken.append(f"the journal says {rig.page()['health']['journal']}")
                disk.empty()
            rig.wait_for(lambda: list(drawn.glob("*.jpg")), 60)
            rig.last_run()
            return of("disk filled by others: the pictures give way to the readings", times, rig, recovery,
                      broken=broken, remark="recovery: until they have gone")  # fmt: skip


def run_pictures_refused(campaign, times):
    """The place of the pictures is full, read-only or broken by turns; the readings' own place is well."""
    directory = campaign.fresh("disk")
    with contextlib.ExitStack() as stack:
        small = stack.enter_context(SmallDisk(directory / "small", 6))
        bad = stack.enter_context(VolatileDisk(directory / "bad", 16, campaign.random))
        rig = stack.enter_context(Rig(directory, runtime=True, virtual=False, pictures=True))
        link, recovery = rig.runtime / "pictures", []
        for number in range(times):
            kind = ("full", "read-only", "broken")[number % 3]
            place = bad.place if kind == "broken" else small.place
            (place / "pictures").mkdir(exist_ok=True)
            fresh = link.with_name("fresh")
            fresh.symlink_to(place / "pictures")
            fresh.replace(link)  # in one step: the daemon would make a directory where there is none
            if rig.daemon is None:
                rig.start()
            rig.wait_for(lambda place=place: list((place / "pictures").glob("*.jpg")), 60)
            at = time.monotonic()
            if kind == "full":
                small.fill()
            elif kind == "read-only":
                small.remount("ro")
            else:
                bad.failing = True
            rig.wait_good(3)
            if kind == "full":
                small.empty()
            elif kind == "read-only":
                small.remount("rw")
            else:
                unmounted(bad)
                bad.failing = False
                bad.repaired()
            recovery.append(next(t for t, what, _ in rig.entries(tail=20_000) if t > at and what == "G") - at)
        rig.last_run()
        return of("pictures alone refused: ENOSPC, EROFS, EIO by turns", times, rig, recovery)


def run(campaign):
    if os.geteuid() != 0:
        raise Skip("mounting small disks needs root")
    missing = available()
    if missing:
        raise Skip(missing)
    works = [
        partial(run_full, times=campaign.count(15), kill=False),
        partial(run_full, times=campaign.count(10), kill=True),
        partial(run_read_only, times=campaign.count(10)),
        partial(run_missing, times=campaign.count(12)),
        partial(run_pictures_give_way, times=campaign.count(10)),
        partial(run_pictures_refused, times=campaign.count(12)),
        partial(run_errors, times=campaign.count(10)),
        partial(run_slow, times=campaign.count(10)),
    ]
    return campaign.side_by_side(*works, at_once=3)


def recorded_again(rig):
    """Seconds until a reading that is made from now on is acknowledged and the state directory has it."""
    began = time.monotonic()

    def home():
        page = rig.page()
        return page and page["written_monotonic_s"] > began and page["health"]["journal"] == "ok"

    try:
        rig.wait_for(home, 60, 0.02)
    except AssertionError as error:
        room = shutil.disk_usage(rig.state).free if rig.state.exists() else None
        raise AssertionError(f"not at home: {rig.page()['health']['journal']}; {room} bytes free there") from error
    rig.wait_for(lambda: rig.witness.first_acknowledged_after(time.monotonic() - 0.3), 60)
    return time.monotonic() - began


def of(title, times, rig, recovery, *, gaps=False, broken=(), remark="", forgotten=0):
    books = rig.books(allowed_gaps=gaps)
    broken = list(broken)
    if rig.peak_mb > PEAK_MB:
        broken.append(f"the daemon took {rig.peak_mb:.0f} MB of memory")
    if books.in_flight > rig.kills + forgotten:
        broken.append(f"{books.in_flight} answers were never recorded, and the daemon was killed {rig.kills} times")
    if books.gaps:
        remark = f"{remark}{', ' if remark else ''}numbers skipped"
    remark = f"{remark}{'; ' if remark else ''}daemon {rig.peak_mb:.0f} MB at most"
    return Line.of("disk", title, times, books, recovery=recovery, limit_s=60.0, broken=broken, remark=remark,
                   allowed_repeats=(rig.kills + times) * 70)  # fmt: skip
