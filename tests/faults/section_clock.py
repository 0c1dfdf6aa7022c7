"""Clocks that are wrong, jump, and are set; the schedule neither floods nor stops, and every stamp is honest."""

import itertools
import time
from datetime import datetime, timedelta
from functools import partial

from rig import Rig
from table import Line

YEAR = 365 * 86400.0
STEPS = {
    "back to 1970, then right": (-56 * YEAR, 0.0),
    "forward by a year, and back": (YEAR, 0.0),
    "back by an hour (clock set by hand to winter time), and forward": (-3600.0, 0.0),
    "a leap second, and small corrections": (1.0, 0.0, -1.0, 0.5, 0.0),
    "at random between 2000 and 2060": None,
}
INTERVAL_S = 0.1


def run(campaign):
    works = [partial(stepping, title=title, offsets=offsets) for title, offsets in STEPS.items()]
    return campaign.side_by_side(*works, at_once=3)


def stepping(campaign, title, offsets):
    steps = campaign.count(60)
    with Rig(campaign.fresh("clock"), virtual=False, interval_s=INTERVAL_S, clock=True) as rig:
        rig.start()
        rig.wait_good(3)
        began, good_before = time.monotonic(), rig.good()
        stepped = []
        for number in range(steps):
            offset = offsets[number % len(offsets)] if offsets else campaign.random.uniform(-26 * YEAR, 34 * YEAR)
            fresh = rig.clock.with_suffix(".new")
            fresh.write_text(f"{offset}")
            fresh.replace(rig.clock)
            stepped.append(time.monotonic())
            time.sleep(campaign.random.uniform(0.05, 0.4))
        rig.clock.write_text("0")
        elapsed = time.monotonic() - began
        made = rig.good() - good_before
        rig.wait_good(3)
        good_at = [at for at, what, _ in rig.entries() if what == "G"]
        recovery = [min(at for at in good_at if at >= step) - step for step in stepped]
        rig.last_run()
        books = rig.books()
        broken = []
        most = elapsed / INTERVAL_S + steps + 5  # each step may make one reading due
        if made > most:
            broken.append(f"{made} readings in {elapsed:.0f} s: it floods")
        broken += dishonest(rig)
        return Line.of("clock", title, steps, books, recovery=recovery, limit_s=INTERVAL_S + 3.0, broken=broken)


def dishonest(rig):
    """Monotonic stamps must ascend whatever the time of day did, and the boot be the same."""
    readings = [r for r, _ in rig.rows().values()]
    stamps = [r["monotonic_s"] for r in readings]
    said = []
    if any(b < a - 1e-6 for a, b in itertools.pairwise(stamps)):
        said.append("monotonic_s does not ascend with the sequence")
    if len({r["boot_id"] for r in readings}) != 1:
        said.append("more than one boot_id")
    if any(datetime.fromisoformat(r["acquired_at"]).utcoffset() != timedelta(0) for r in readings):
        said.append("a time that is not UTC")
    return said
