"""Which functions the remaining time goes to, and the floor: the picture's samples and OpenCV's own work alone.

py-spy looks at the stack from outside some hundred times a second, so that it makes nothing slower that is looked at:
a tracing profiler would charge Python for its own bookkeeping.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from performance.frames import Shot, shot
from performance.node import write_node
from performance.plan import Plan
from performance.stages import replaced
from sagnode.pipeline import measure_frame

HERE = Path(__file__).parent
VIEWS = ("tower", "field")
TOP = 16
RATE_HZ = 250
ENTRY = "measure_frame"
PICTURE_CALLS = ("remap", "matchTemplate", "calcOpticalFlowPyrLK", "filter2D", "sepFilter2D", "meanStdDev", "calcHist")
"""OpenCV's functions that read pixels in the pipeline; those that it does not call cost nothing here."""


def measure(plan: Plan) -> dict[str, Any]:
    """By view."""
    cv2.setNumThreads(1)
    return {name: _profile(plan, name) for name in VIEWS}


def _profile(plan: Plan, name: str) -> dict[str, Any]:
    picture = shot(name, plan.folder)

    def work() -> object:
        return measure_frame(picture.site, picture.image)

    work()
    plain = _least(work, plan.rounds)
    stacks = _sampled(plan, write_node(picture, plan.folder / f"node-{name}").path)
    rows, kinds = summed(stacks, 1e3 * plain)
    return {
        "conductors": sum(c.measured for c in picture.site.conductors),
        "cpu_ms": 1e3 * plain,
        "samples": sum(stacks.values()),
        "top": rows[:TOP],
        "kinds": kinds,
        "floor": list(_floor(picture, plan.rounds)),
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


def _floor(picture: Shot, rounds: int) -> Iterator[tuple[str, float]]:
    """What the reading of the needed pixels and the arithmetic on them cost by themselves, ms."""
    with _recorded() as calls:
        measure_frame(picture.site, picture.image)
    whole = 0.0
    for name, recorded in calls.items():
        if recorded:
            function = getattr(cv2, name)
            seconds = _least(lambda f=function, r=recorded: [f(*a, **k) for a, k in r], rounds)
            whole += seconds
            yield f"the same {len(recorded)} calls of `cv2.{name}` with the same arguments again", 1e3 * seconds
    samples = sum(int(np.size(arguments[1])) for arguments, _ in calls["remap"])
    yield "all of these together", 1e3 * whole
    places = _places(picture, calls["remap"])
    flat = picture.image.reshape(-1)
    yield f"reading each of the {len(places):,} pixels under them once", 1e3 * _least(lambda: flat.take(places), rounds)
    yield (
        f"arithmetic of the line response on {samples:,} samples (three of them one response)",
        1e3 * _arithmetic(samples // 3, rounds),
    )
    frame = picture.image
    yield (
        f"reading each of the frame's {frame.size / 1e6:.1f} million pixels once (`cv2.sumElems`)",
        1e3 * _least(lambda: cv2.sumElems(frame), rounds),
    )
    data = np.fromfile(picture.jpeg, dtype=np.uint8)
    yield (
        "decoding the frame from JPEG",
        1e3 * _least(lambda: cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), rounds),
    )


@contextmanager
def _recorded() -> Iterator[dict[str, list[tuple[tuple[Any, ...], dict[str, Any]]]]]:
    """Note the arguments of every call of OpenCV that reads pixels."""
    calls: dict[str, list[tuple[tuple[Any, ...], dict[str, Any]]]] = {name: [] for name in PICTURE_CALLS}

    def noted(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            calls[name].append((arguments, named))
            return original(*arguments, **named)

        return call

    with ExitStack() as stack:
        for name in PICTURE_CALLS:
            stack.enter_context(replaced("cv2", name, noted(name, getattr(cv2, name))))
        yield calls


def _places(picture: Shot, calls: list[tuple[tuple[Any, ...], dict[str, Any]]]) -> np.ndarray:
    """Flat indices (K,) of the pixels nearest to all samples of the frame, each once."""
    height, width = picture.image.shape
    seen = np.zeros(height * width, dtype=bool)
    for arguments, _ in calls:
        source, u, v = arguments[:3]
        if source.shape != picture.image.shape or u is None or u.ndim != 2 or v is None:
            continue
        column, row = (np.rint(np.asarray(part)).astype(np.int64) for part in (u, v))
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        seen[(row * width + column)[inside]] = True
    return np.flatnonzero(seen)


def _arithmetic(responses: int, rounds: int) -> float:
    """The response of so many triples of samples, and its mean, s."""
    rng = np.random.default_rng(1)
    side, other, centre = (rng.integers(0, 255, responses).astype(np.int16) for _ in range(3))

    def respond() -> float:
        a, b = side - centre, other - centre
        response = np.maximum(np.minimum(a, b), -np.maximum(a, b))
        np.clip(response, -24, 24, out=response)
        return float(response.mean())

    return _least(respond, rounds)


def _least(call: Callable[[], object], rounds: int) -> float:
    spent = []
    for _ in range(rounds):
        began = time.process_time()
        call()
        spent.append(time.process_time() - began)
    return min(spent)
