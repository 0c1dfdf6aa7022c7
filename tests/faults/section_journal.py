"""A journal that was damaged while the node was off: cut short, bits flipped, sectors lost, files gone.

No number may be wrong and none be given out twice. A reading may be gone only where the damage hit its own bytes: every
reading whose text is still whole in the damaged files must be found again.
"""

import contextlib
import json
import logging
import re
import shutil
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from datetime import UTC, datetime
from functools import partial

from coded import is_true
from section_backlog import coded_reading, fill
from steps import killed_before, lines_of
from table import Line
from volatile_disk import VolatileDisk, available
from volatile_disk import run as run_program

from sagnode.daemon.journal import Journal
from sagnode.daemon.journal_file import checksum
from sagnode.daemon.sequence import BLOCK

COUNT = 600
KILLS = 200
CUTS = 60
CUTS_AT_ONCE = 8
MEGABYTES = 24
READINGS = 120
_BEGIN = re.compile(rb'\{"schema_version":')
_SEQUENCE = re.compile(rb'"sequence":(\d+)')


def flip(random, data):
    for _ in range(random.choice((1, 1, 2, 8, 64))):
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def cut(random, data):
    del data[random.randrange(len(data)) :]


def lose_sectors(random, data):
    for _ in range(random.choice((1, 1, 3, 20))):
        start = random.randrange(len(data)) // 512 * 512
        data[start : start + 512] = bytes(len(data[start : start + 512]))


def swap_sectors(random, data):
    one, two = (random.randrange(len(data) // 512) * 512 for _ in range(2))
    data[one : one + 512], data[two : two + 512] = data[two : two + 512], data[one : one + 512]


def scribble(random, data):
    start = random.randrange(len(data))
    data[start : start + 4096] = random.randbytes(len(data[start : start + 4096]))


DAMAGES = {"bits flipped": flip, "cut short": cut, "sectors zeroed": lose_sectors, "sectors swapped": swap_sectors,
           "pages overwritten": scribble}  # fmt: skip


def run(campaign):
    logging.getLogger("sagnode").setLevel(logging.CRITICAL)  # it says of each what it found
    original = campaign.fresh("journal")
    fill(original / "journal.sqlite", READINGS)
    log_of_last_readings(original)
    texts = rows_of(original / "journal.sqlite")
    stored = {sequence: as_stored(sequence, text) for sequence, text in texts.items()}
    place = campaign.fresh("journal") / "state"
    for title, damage in DAMAGES.items():
        times = campaign.count(COUNT / len(DAMAGES))
        total = Counter()
        broken, recovery = [], []
        for number in range(times):
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(original, place)
            target = place / campaign.random.choice(("journal.sqlite", "journal.sqlite", "journal.sqlite-wal"))
            data = bytearray(target.read_bytes())
            damage(campaign.random, data)
            target.write_bytes(data)
            if number % 10 == 9:  # and the count is damaged with it
                flip(campaign.random, count := bytearray((place / "sequence").read_bytes()))
                (place / "sequence").write_bytes(count)
            began = time.monotonic()
            found, wrong = reopened(place, texts, stored)
            recovery.append(time.monotonic() - began)
            broken += [f"{title}, number {number}: {text}" for text in wrong]
            total.update(found)
        yield Line("journal", f"journal or its log: {title}", times, total["whole"], total["found"],
                   total["whole"] - total["found"], 0, total["false"], recovery=recovery, limit_s=60.0, broken=broken,
                   remark=f"{total['destroyed']} of {times * len(texts)} destroyed with their bytes")  # fmt: skip
    yield killed_while_it_mends(campaign, original, texts, stored)
    if not available():
        yield cut_while_it_mends(campaign, original, texts, stored)


def killed_while_it_mends(campaign, original, texts, stored):
    """Any of the damages; whoever mends it is killed before a line of the code, any of those it comes to."""
    place, rehearsal = (campaign.fresh("journal") / "state" for _ in range(2))
    times, total, broken, recovery, lines = campaign.count(KILLS), Counter(), [], [], set()
    for number in range(times):
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(original, place)
        damage = campaign.random.choice(list(DAMAGES.values()))
        target = place / campaign.random.choice(("journal.sqlite", "journal.sqlite", "journal.sqlite-wal"))
        damage(campaign.random, data := bytearray(target.read_bytes()))
        target.write_bytes(data)
        whole = whole_in(raw_of(place), stored)
        shutil.rmtree(rehearsal, ignore_errors=True)
        shutil.copytree(place, rehearsal)
        line = campaign.random.choice(lines_of(partial(opened_and_closed, rehearsal)))
        killed_before(partial(opened_and_closed, place), line)
        lines.add(line)
        began = time.monotonic()
        found, wrong = reopened(place, texts, stored, whole)
        recovery.append(time.monotonic() - began)
        broken += [f"killed before {line}, number {number}: {text}" for text in wrong]
        total.update(found)
    return Line("journal", "journal damaged, and its process killed while it mends it", times, total["whole"],
                total["found"], total["whole"] - total["found"], 0, total["false"], recovery=recovery, limit_s=60.0,
                broken=broken, remark=f"at {len(lines)} different lines of the code; {total['destroyed']} of"
                f" {times * len(texts)} destroyed with their bytes")  # fmt: skip


def cut_while_it_mends(campaign, original, texts, stored):
    """The same on a disk that forgets: how it would be found if the power failed at moments of the repair."""
    times, total, broken, recovery, looked = campaign.count(CUTS), Counter(), [], [], 0
    while looked < times:
        directory = campaign.fresh("journal")
        with VolatileDisk(directory / "disk", MEGABYTES, campaign.random) as disk:
            state = disk.place / "state"
            shutil.copytree(original, state)
            target = state / campaign.random.choice(("journal.sqlite", "journal.sqlite-wal"))
            campaign.random.choice(list(DAMAGES.values()))(campaign.random, data := bytearray(target.read_bytes()))
            target.write_bytes(data)
            whole = whole_in(raw_of(state), stored)
            run_program("sync", "-f", state)
            images = images_while_it_mends(campaign, disk, state)
        for image in images[: times - looked]:
            looked += 1
            began = time.monotonic()
            with mounted(directory, image) as place:
                found, wrong = reopened(place / "state", texts, stored, whole)
            recovery.append(time.monotonic() - began)
            broken += [f"power cut number {looked}: {text}" for text in wrong]
            total.update(found)
    return Line("journal", "journal damaged, and the power cut while it is mended", looked, total["whole"],
                total["found"], total["whole"] - total["found"], 0, total["false"], recovery=recovery, limit_s=60.0,
                broken=broken,
                remark=f"{total['destroyed']} of {looked * len(texts)} destroyed with their bytes")  # fmt: skip


def images_while_it_mends(campaign, disk, state):
    """What would be found if the power failed, from the moment on in which the journal is opened."""
    words = (
        "import sys; from pathlib import Path; from sagnode.daemon.journal import Journal; print(flush=True);"
        "Journal(Path(sys.argv[1]), 'boot-2').close()"
    )
    images = []
    with subprocess.Popen([sys.executable, "-c", words, state / "journal.sqlite"], stdout=subprocess.PIPE) as mender:
        mender.stdout.read(1)
        while mender.poll() is None and len(images) < CUTS_AT_ONCE:
            images.append(disk.cut())
            time.sleep(campaign.random.uniform(0.0, 0.06))
    return images


@contextlib.contextmanager
def mounted(directory, image):
    file, place = directory / "cut.img", directory / "cut"
    file.write_bytes(image)
    place.mkdir(exist_ok=True)
    run_program("mount", "-o", "loop", file, place)
    try:
        yield place
    finally:
        run_program("umount", place)


def opened_and_closed(place):
    """By the boot after the one that ended with the damage."""
    Journal(place / "journal.sqlite", "boot-2").close()


def log_of_last_readings(original):
    """A third of the readings is in the log only, as after a power cut; some are delivered."""
    path = original / "journal.sqlite"
    fill(path, READINGS // 2)
    live = original.with_name("live")
    shutil.copytree(original, live)
    journal = Journal(live / "journal.sqlite", "boot-1")
    fill_into(journal, READINGS // 2)
    journal.mark_delivered(range(1, READINGS // 3), datetime.now(UTC))
    for file in live.iterdir():  # as a running process leaves it: nothing folded
        shutil.copy(file, original)
    journal.close()


def fill_into(journal, count):
    for start in range(0, count, 30):
        journal.append([coded_reading(start + i, datetime.now(UTC)) for i in range(30)], owed=True)


def rows_of(path):
    copy = path.parent.with_name("reading")
    shutil.copytree(path.parent, copy)
    with sqlite3.connect(copy / "journal.sqlite") as db:
        return dict(db.execute("SELECT sequence, json FROM readings"))


def as_stored(sequence, text):
    """The text with its checksum behind it, as a number of 4 or 6 bytes."""
    crc = checksum(sequence, json.loads(text)["conductor"], text)
    return [text.encode() + crc.to_bytes(size, "big") for size in (4, 6)]


def whole_in(raw, stored):
    """Numbers of the readings whose bytes are all there."""
    starts = [match.start() for match in _BEGIN.finditer(raw)]
    by_number = [(int(found[1]), at) for at in starts if (found := _SEQUENCE.search(raw, at, at + 3000))]
    return {n for n, at in by_number if any(raw.startswith(text, at) for text in stored.get(n, ()))}


def raw_of(place):
    return b"".join(
        file.read_bytes() for file in sorted(place.glob("journal.sqlite*")) if not file.name.endswith("shm")
    )


def reopened(place, texts, stored, whole=None):
    """Open the damaged journal as the daemon does; counts, and sentences on what is wrong.

    Args:
        whole: numbers of the readings that must be found; as many as are whole in the files, where none are given.
    """
    whole = whole_in(raw_of(place), stored) if whole is None else whole
    wrong = []
    journal = Journal(place / "journal.sqlite", "boot-2")
    highest = max(texts)
    if journal.next_sequence <= highest:
        wrong.append(f"next number {journal.next_sequence}, and {highest} was used")
    if journal.next_sequence > highest + 3 * BLOCK:
        wrong.append(f"the count leapt to {journal.next_sequence}")
    journal.pending(0, 10_000)  # what fails its checksum is set aside
    journal.close()
    with contextlib.closing(sqlite3.connect(place / "journal.sqlite")) as db:
        rows = list(db.execute("SELECT sequence, json FROM readings WHERE fate <> 'damaged'"))
    false = sum(1 for sequence, text in rows if texts.get(sequence) != text or not is_true(json.loads(text)))
    found = whole & {sequence for sequence, _ in rows}
    if whole - found:
        wrong.append(f"{len(whole - found)} readings are whole in the damaged files and were not found")
    return {"whole": len(whole), "found": len(found), "false": false, "destroyed": len(texts) - len(whole)}, wrong
