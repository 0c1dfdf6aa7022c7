"""Which functions the remaining time goes to, and the floor: the picture's samples and OpenCV's own work alone."""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from performance_frames import Shot, shot
from performance_plan import Plan
from performance_stages import replaced
from sagnode.pipeline import measure_frame

VIEWS = ("tower", "field")
TOP = 18
PICTURE_CALLS = ("remap", "matchTemplate", "calcOpticalFlowPyrLK", "filter2D", "sepFilter2D", "meanStdDev", "calcHist")
"""OpenCV's functions that read pixels in the pipeline; those that it does not call cost nothing here."""


def measure(plan: Plan) -> dict[str, Any]:
    """By view."""
    cv2.setNumThreads(1)
    return {name: _profile(shot(name, plan.folder), plan.rounds) for name in VIEWS}


def _profile(picture: Shot, rounds: int) -> dict[str, Any]:
    def work() -> object:
        return measure_frame(picture.site, picture.image)

    work()
    plain = _least(work, rounds)
    profiler = cProfile.Profile(time.process_time)
    profiler.enable()
    for _ in range(rounds):
        work()
    profiler.disable()
    stats = pstats.Stats(profiler)
    total = float(stats.total_tt) / rounds  # type: ignore[attr-defined]
    scale = plain / total
    rows = [
        {
            "name": _name(*function),
            "calls": calls / rounds,
            "own_ms": 1e3 * own / rounds * scale,
            "cumulative_ms": 1e3 * cumulative / rounds * scale,
        }
        for function, (_, calls, own, cumulative, _) in stats.stats.items()  # type: ignore[attr-defined]
    ]
    rows.sort(key=lambda row: -row["own_ms"])
    return {
        "conductors": sum(c.measured for c in picture.site.conductors),
        "cpu_ms": 1e3 * plain,
        "slowdown": total / plain,
        "top": rows[:TOP],
        "kinds": _kinds(rows),
        "floor": list(_floor(picture, rounds)),
    }


def _name(file: str, line: int, function: str) -> str:
    if file.startswith("~") or not line:
        return function.strip("<>")
    path = Path(file)
    place = path.stem if "sagnode" in file else f"numpy {path.stem}" if "numpy" in file else path.stem
    return f"{place}.{function}"


def _kinds(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Own time, ms: OpenCV's functions, NumPy's, and Python's in this program."""
    kinds = {"OpenCV": 0.0, "NumPy": 0.0, "sagnode's own Python": 0.0}
    for row in rows:
        name = row["name"]
        if name in PICTURE_CALLS or name.startswith(("cv2", "built-in method cv2")):
            kinds["OpenCV"] += row["own_ms"]
        elif "numpy" in name or name.startswith(("method", "built-in")):
            kinds["NumPy"] += row["own_ms"]
        else:
            kinds["sagnode's own Python"] += row["own_ms"]
    return kinds


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
