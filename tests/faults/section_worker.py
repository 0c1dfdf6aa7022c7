"""What a worker can do wrong, done to the real daemon hundreds of times; between two faults one good reading."""

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
COUNTS = (500, 700, 5000, 150, 100, 3600, 100)
HANG_DEADLINE_S = 0.4


def run(campaign):
    for (title, kinds), count in zip(GROUPS.items(), COUNTS, strict=True):
        hangs = "hang" in kinds
        deadline_s = HANG_DEADLINE_S if hangs else 5.0
        with Rig(campaign.fresh("worker"), kinds, deadline_s=deadline_s) as rig:
            wanted = campaign.count(count)
            rig.start()
            rig.wait_for(lambda rig=rig, wanted=wanted: injected(rig) >= wanted, 60 + wanted, 1.0)
            rig.last_run()
            books = rig.books()
            # a period here is as long as the daemon takes; what counts is deadline, kill, start
            yield Line.of("worker", title, injected(rig), books, recovery=rig.recoveries(), limit_s=deadline_s + 10)


def injected(rig):
    return sum(1 for _, what, _ in rig.entries() if what == "F")
