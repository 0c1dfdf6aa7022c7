"""What a worker can do wrong, done to the real daemon hundreds of times; between two faults one good reading."""

from functools import partial

from rig import Rig
from table import Line

GROUPS = {
    "worker dies (exit, SIGKILL, SIGSEGV, SIGABRT, SIGTERM)": ("exit", "kill", "segfault", "abort", "terminate"),
    "worker answers garbage, half a line, another request, a second hello": (
        "garbage", "half-line", "flipped-bits", "long-line", "wrong-id", "old-reply", "second-hello",
    ),
    "worker's numbers contradict themselves or are none": (
        "not-a-number", "infinite", "interval-inside-out", "negative-uncertainty", "numbers-with-invalid",
        "without-sag", "conductor-missing", "conductor-unknown",
    ),
    "worker's memory blows up or leaks": ("memory-blow-up", "leak"),
    "worker hangs, is stopped, or hangs with a child": ("hang", "stop", "hang-with-child"),
    "camera: fault, night, stale frame, calibration unreadable": ("camera-fault", "night", "stale", "fatal"),
    "worker slow, or floods its output": ("slow", "noisy"),
}  # fmt: skip
COUNTS = (500, 700, 4800, 150, 100, 3600, 100)
NODES = (2, 2, 6, 1, 2, 5, 1)
AT_ONCE = 6
HANG_DEADLINE_S = 0.4


def run(campaign):
    works = [
        partial(misbehaving, title=title, kinds=kinds, wanted=wanted)
        for (title, kinds), count, nodes in zip(GROUPS.items(), COUNTS, NODES, strict=True)
        for wanted in campaign.divided(count, nodes)
    ]
    return campaign.side_by_side(*works, at_once=AT_ONCE)


def misbehaving(campaign, title, kinds, wanted):
    """One node with a worker that fails in these ways."""
    deadline_s = HANG_DEADLINE_S if "hang" in kinds else 5.0
    with Rig(campaign.fresh("worker"), kinds, deadline_s=deadline_s) as rig:
        rig.start()
        rig.wait_for(lambda: injected(rig) >= wanted, 120 + 2 * wanted, 1.0)
        rig.last_run()
        books = rig.books()
        # a period here is as long as the daemon takes; what counts is deadline, kill, start
        return Line.of("worker", title, injected(rig), books, recovery=rig.recoveries(), limit_s=deadline_s + 10)


def injected(rig):
    return sum(1 for _, what, _ in rig.entries() if what == "F")
