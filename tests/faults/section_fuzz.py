"""Files, lines, commands, rows and pictures that somebody, or a worn card, has mutilated: read, or refused in words.

In this one process, over the functions that read and judge them, and not one process for each. Whatever is raised must
be one of the program's own errors; nothing may take long. Bytes are mutilated as they lie in a file, and documents key
by key after parsing, which reaches behind the parser.
"""

import logging
import tempfile
import time
from pathlib import Path

from fuzz_targets import targets
from table import Line

from sagnode.errors import SagnodeError

COUNTS = {
    "node file": 5_000, "node file, key by key": 15_000, "span file": 7_000, "span file, key by key": 10_000,
    "calibration file": 10_000, "calibration file, key by key": 8_000, "picture": 25_000, "picture's header": 25_000,
    "worker's line": 20_000, "command": 20_000, "journal row": 6_000, "spool, count and memory files": 5_000,
    "clicks and numbers on the command line": 3_000,
}  # fmt: skip
SLOW_S = 10.0
"""Of the processor's time."""
SCRATCH = Path("/dev/shm")  # noqa: S108 - a place in memory, where there is one


def run(campaign):
    quiet = [(logging.getLogger(name), logging.getLogger(name).level) for name in ("sagnode", "PIL")]
    for logger, _ in quiet:
        logger.setLevel(logging.CRITICAL + 1)  # every refusal is a line
    try:
        with tempfile.TemporaryDirectory(dir=SCRATCH if SCRATCH.is_dir() else None) as scratch:
            for title, target in targets(campaign, Path(scratch)).items():
                yield fuzzed(title, target, campaign.count(COUNTS[title]))
    finally:
        for logger, level in quiet:
            logger.setLevel(level)


def fuzzed(title, target, times):
    """One kind of input, so often."""
    began, slowest, refused, uncaught = time.monotonic(), 0.0, 0, {}
    for _ in range(times):
        at = time.process_time()
        try:
            refused += bool(target())
        except SagnodeError as error:
            refused += 1
            str(error)
        except Exception as error:  # noqa: BLE001 - what this is about
            text = f"{type(error).__name__}: {error}"[:200]
            uncaught[text] = uncaught.get(text, 0) + 1
        slowest = max(slowest, time.process_time() - at)
    broken = [f"{count} times {text}" for text, count in uncaught.items()]
    if slowest > SLOW_S:
        broken.append(f"one took {slowest:.0f} s")
    return Line("fuzz", title, times, broken=broken, refused=refused, uncaught=sum(uncaught.values()),
                seconds=time.monotonic() - began, slowest_s=slowest)  # fmt: skip
