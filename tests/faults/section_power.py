"""The power fails while the daemon writes: the disk keeps what was flushed and a random half of the rest.

Looked at after every cut: the file system mounts, ``quick_check`` is clean, every reading that anybody can have heard
of is there, unchanged, and no number can be given out twice. Every tenth time the node is started again on what is
left.
"""

import contextlib
import json
import os
import signal
import sqlite3
import time
from functools import partial

from campaign import Skip
from coded import is_true
from rig import Rig
from table import Line
from volatile_disk import VolatileDisk, available
from volatile_disk import run as command

from sagnode.daemon.journal import Journal

CUTS = 240
DISKS = 12
"""A new disk and a new node for each twelfth of the cuts: so many meet a start, and none a disk that has filled up."""
AT_ONCE = 3
MEGABYTES = 12


def run(campaign):
    missing = available()
    if missing:
        raise Skip(missing)
    works = [partial(cut_again_and_again, wanted=wanted) for wanted in campaign.divided(CUTS, DISKS)]
    lines = campaign.side_by_side(*works, at_once=AT_ONCE)
    (line,) = lines
    line.remark = (
        f"quick_check clean after {line.counts['clean']} of {line.times}; {line.counts['restarts']} restarts on what"
        f" was left, {line.counts['flushes']} flushes"
    )
    return lines


def cut_again_and_again(campaign, wanted):
    """One node on one disk."""
    looked = restarts = 0
    broken, recovery = [], []
    directory = campaign.fresh("power")
    with VolatileDisk(directory / "disk", MEGABYTES, campaign.random) as disk:
        with Rig(directory, state_dir=disk.place / "state", virtual=False) as rig:
            rig.start()
            while looked < wanted:
                time.sleep(campaign.random.uniform(0, 0.2))
                if looked % 10 != 9:
                    known, image = known_and_image(rig, disk)
                else:
                    stand_still(rig.daemon)  # what it did after this moment never happened
                    known, image = known_and_image(rig, disk)
                    began = time.monotonic()
                    power_off_and_on(rig, disk, image)
                    restarts += 1
                    rig.wait_good(1)
                    recovery.append(time.monotonic() - began)
                looked += 1
                if looked == wanted // 4:  # the first ones meet a daemon that starts on an empty disk
                    rig.wait_good(1)
                broken += [f"cut {looked}: {text}" for text in examine(directory, image, known)]
            rig.wait_good(1)  # it may be in the middle of its start
            rig.last_run()
            books = rig.books(allowed_gaps=True)  # a log with sectors missing leaves one
    # what was made in the moment of a cut and heard of by nobody is no reading; see known_and_image
    books.in_flight = 0
    return Line.of("power", "power cut (ext4 on a disk that forgets unflushed sectors)", looked, books,
                   recovery=recovery, limit_s=60.0, allowed_repeats=restarts * 70, broken=broken,
                   counts={"clean": looked - len(broken), "restarts": restarts, "flushes": disk.flushes})  # fmt: skip


def stand_still(process):
    """SIGSTOP, and wait until it is so; the kernel goes on writing what it was given."""
    process.send_signal(signal.SIGSTOP)
    os.waitpid(process.pid, os.WUNTRACED)


def known_and_image(rig, disk):
    """Numbers that somebody has heard of (broker or another process at the node), then the disk of that moment."""
    known = set(rig.witness.sent)
    with (
        contextlib.suppress(sqlite3.Error),
        contextlib.closing(sqlite3.connect(f"file:{rig.state}/journal.sqlite?mode=ro", uri=True, timeout=5)) as db,
    ):
        known |= {sequence for (sequence,) in db.execute("SELECT sequence FROM readings")}
    return known, disk.cut()


def power_off_and_on(rig, disk, image):
    rig.kill()
    disk.replace(image)
    rig.start()


def examine(directory, image, known):
    """What is wrong with a disk after a cut; nothing, if all is well."""
    file, place = directory / "cut.img", directory / "cut"
    place.mkdir(exist_ok=True)
    file.write_bytes(image)
    try:
        command("mount", "-o", "loop", file, place)
    except OSError as error:
        return [f"the file system does not mount: {error}"]
    try:
        return list(_examine(place / "state" / "journal.sqlite", known))
    finally:
        command("umount", place)


def _examine(path, known):
    if not path.exists():
        if known:
            yield "there is no journal"
        return
    with contextlib.closing(sqlite3.connect(path)) as db:
        verdict = db.execute("PRAGMA quick_check").fetchone()[0]
        if verdict != "ok":
            yield f"quick_check: {verdict}"
            return
    journal = Journal(path)
    if journal.note != "ok":
        yield f"journal: {journal.note}"
    if journal.next_sequence <= max(known, default=0):
        yield f"the next number would be {journal.next_sequence}, and {max(known)} was used"
    journal.close()
    with contextlib.closing(sqlite3.connect(path)) as db:
        rows = dict(db.execute("SELECT sequence, json FROM readings"))
    if known - rows.keys():
        yield f"readings that were heard of are gone: {sorted(known - rows.keys())[:5]}"
    if not all(is_true(json.loads(text)) for text in rows.values()):
        yield "a reading has changed"
