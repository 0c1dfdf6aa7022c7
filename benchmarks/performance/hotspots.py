"""Which functions the remaining time goes to, and the floor under it.

py-spy looks at the stack from outside some hundred times a second, so that it makes nothing slower that is looked at:
a tracing profiler would charge Python for its own bookkeeping.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from collections import Counter
from pathlib import Path
from typing import Any

import cv2

from performance.floor import floor, least
from performance.frames import shot
from performance.node import write_node
from performance.plan import Plan
from sagnode.pipeline import measure_frame

HERE = Path(__file__).parent
VIEWS = ("tower", "field")
TOP = 16
RATE_HZ = 250
ENTRY = "measure_frame"


def measure(plan: Plan) -> dict[str, Any]:
    """By view."""
    cv2.setNumThreads(1)
    return {name: _profile(plan, name) for name in VIEWS}


def _profile(plan: Plan, name: str) -> dict[str, Any]:
    picture = shot(name, plan.folder)

    def work() -> object:
        return measure_frame(picture.site, picture.image)

    work()
    plain = least(work, plan.rounds)
    stacks = _sampled(plan, write_node(picture, plan.folder / f"node-{name}").path)
    rows, kinds = summed(stacks, 1e3 * plain)
    return {
        "conductors": sum(c.measured for c in picture.site.conductors),
        "cpu_ms": 1e3 * plain,
        "samples": sum(stacks.values()),
        "top": rows[:TOP],
        "kinds": kinds,
        "floor": list(floor(picture, plan.rounds)),
    }


def _sampled(plan: Plan, node: Path) -> Counter[tuple[str, ...]]:
    """Stacks below the pipeline's entry, from the entry to the innermost function, and how often each was seen."""
    program = shutil.which("py-spy", path=sysconfig.get_path("scripts")) or shutil.which("py-spy")
    if program is None:
        raise SystemExit("py-spy is not installed: pip install 'sagnode[dev]'")
    raw = plan.folder / "stacks.txt"
    words = [program, "record", "--format", "raw", "--rate", str(RATE_HZ), "--output", str(raw), "--"]
    words += [sys.executable, str(HERE / "child.py"), "repeat", str(node)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"py-spy cannot look at a process here (it needs ptrace): {done.stderr.strip()[-300:]}")
    stacks: Counter[tuple[str, ...]] = Counter()
    for line in raw.read_text(encoding="utf-8").splitlines():
        frames, _, count = line.rpartition(" ")
        # "function (file:line)", outermost first
        stack = tuple(frame.rpartition(":")[0] for frame in frames.split(";"))
        begin = [k for k, frame in enumerate(stack) if frame.startswith(f"{ENTRY} (")]
        if begin:
            stacks[stack[begin[0] :]] += int(count)
    return stacks


def summed(stacks: Counter[tuple[str, ...]], total_ms: float) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Time by this program's functions, and by where the innermost frame was.

    Args:
        stacks: sampled stacks, frames as ``function (file``.
        total_ms: what all samples together stand for.

    Returns:
        Rows by own time, most first: a function's own time has that of NumPy's and OpenCV's functions it calls, but not
        that of this program's; and time by kind of innermost frame.
    """
    samples = max(sum(stacks.values()), 1)
    own: Counter[str] = Counter()
    inside: Counter[str] = Counter()
    kinds: Counter[str] = Counter()
    for stack, count in stacks.items():
        ours = [_name(frame) for frame in stack if "sagnode/" in frame]
        own[ours[-1]] += count
        for name in set(ours):
            inside[name] += count
        kinds["NumPy's Python" if "numpy/" in stack[-1] else "this program's lines, with the C they call"] += count
    ms = total_ms / samples
    rows = [{"name": n, "own_ms": ms * c, "cumulative_ms": ms * inside[n]} for n, c in own.most_common()]
    return rows, {name: ms * count for name, count in kinds.most_common()}


def _name(frame: str) -> str:
    function, _, file = frame.partition(" (")
    return f"{Path(file).stem}.{function}"
