"""The floor: what reading the needed pixels and the arithmetic on them cost by themselves."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import product
from typing import Any

import cv2
import numpy as np

from performance.frames import Shot
from performance.stages import replaced
from sagnode import native
from sagnode.pipeline import measure_frame

PICTURE_CALLS = ("remap", "matchTemplate", "calcOpticalFlowPyrLK", "filter2D", "sepFilter2D", "meanStdDev", "calcHist")
"""OpenCV's functions that read pixels in the pipeline; those that it does not call cost nothing here."""
RESPONSES = ("response", "response_sums")
"""Compiled functions that read pixels: image, u, v, nu, nv, places, sides and band are the first they are given."""

SMALL_MS = 0.3
"""Rows of less are put together."""
COPIED_MOST = 10_000
"""Numbers of an array that may be changed by a call."""

Call = tuple[tuple[Any, ...], dict[str, Any]]
Calls = dict[str, list[Call]]


def floor(picture: Shot, rounds: int) -> Iterator[tuple[str, float]]:
    """Rows of words and ms, measured on one frame of all conductors."""
    with recorded() as (opencv, compiled):
        measure_frame(picture.site, picture.image)
    rows = [
        (f"{name}.{function}", len(same), 1e3 * _again(getattr(owner, function), same, rounds))
        for owner, name, calls in ((native.kernels, "sagnode.native", compiled), (cv2, "cv2", opencv))
        for function, same in calls.items()
        if same
    ]
    large = [row for row in rows if row[2] >= SMALL_MS]
    for name, count, ms in large:
        yield f"the same {count} calls of `{name}` with the same arguments again", ms
    if len(large) < len(rows):
        rest = sum(ms for _, _, ms in rows if ms < SMALL_MS)
        yield f"{len(rows) - len(large)} more such functions of less than {SMALL_MS:g} ms each", rest
    whole = sum(ms for *_, ms in rows)
    yield "all of these together", whole
    responses = [call for name in RESPONSES for call in compiled.get(name, [])]
    # without compiled functions it is cv2.remap that takes them; where single precision is read it has another end
    responses += [call for call in opencv["remap"] if call[0][0].dtype == np.uint8]
    samples, pixels = sampled(responses)
    yield (
        f"reading each of the {sum(len(places) for _, places in pixels):,} pixels under line responses once",
        1e3 * least(lambda: [flat.take(places) for flat, places in pixels], rounds),
    )
    yield (
        f"arithmetic of line responses on their {samples:,} samples (three are one response), by NumPy",
        1e3 * _arithmetic(samples // 3, rounds),
    )
    frame = picture.image
    yield (
        f"reading each of the frame's {frame.size / 1e6:.1f} million pixels once (`cv2.sumElems`)",
        1e3 * least(lambda: cv2.sumElems(frame), rounds),
    )
    data = np.fromfile(picture.jpeg, dtype=np.uint8)
    yield (
        "decoding the frame from JPEG",
        1e3 * least(lambda: cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), rounds),
    )


class _Noted:
    """Stands for the compiled functions; each call of one is noted."""

    def __init__(self, kernels: Any, calls: Calls) -> None:
        self._kernels = kernels
        self._calls = calls

    def __getattr__(self, name: str) -> Any:
        return _noted(getattr(self._kernels, name), self._calls.setdefault(name, []))


@contextmanager
def recorded() -> Iterator[tuple[Calls, Calls]]:
    """Note the arguments of every call of OpenCV that reads pixels, and of every call of a compiled function.

    What calls compiled functions must be imported before.
    """
    opencv: Calls = {name: [] for name in PICTURE_CALLS}
    compiled: Calls = {}
    kernels = native.kernels
    with ExitStack() as stack:
        for name in PICTURE_CALLS:
            stack.enter_context(replaced("cv2", name, _noted(getattr(cv2, name), opencv[name])))
        for name, module in list(sys.modules.items()):
            ours = name.startswith("sagnode.") and name != native.__name__
            if kernels is not None and ours and getattr(module, "kernels", None) is kernels:
                stack.enter_context(replaced(name, "kernels", _Noted(kernels, compiled)))
        yield opencv, compiled


def _again(function: Callable[..., Any], calls: list[Call], rounds: int) -> float:
    """CPU seconds of the quickest of some rounds of the same calls."""
    spent = []
    for _ in range(rounds):
        # some of them change what they are given
        fresh = [(tuple(_kept(a) for a in arguments), named) for arguments, named in calls]
        began = time.process_time()
        for arguments, named in fresh:
            function(*arguments, **named)
        spent.append(time.process_time() - began)
    return min(spent)


def _kept(argument: Any) -> Any:
    """An argument as it is now: a copy, but of pictures and what else is large, which nobody changes."""
    small = isinstance(argument, np.ndarray) and argument.size <= COPIED_MOST
    return argument.copy() if small else argument


def _noted(original: Callable[..., Any], calls: list[Call]) -> Callable[..., Any]:
    def call(*arguments: Any, **named: Any) -> Any:
        calls.append((tuple(_kept(a) for a in arguments), named))
        return original(*arguments, **named)

    return call


def sampled(calls: list[Call]) -> tuple[int, list[tuple[np.ndarray, np.ndarray]]]:
    """How many samples some calls take, and by picture the flat indices (K,) of the pixels nearest to them, each once.

    Args:
        calls: of ``cv2.remap`` or one of :data:`RESPONSES`; remaps without maps of two axes are left out.
    """
    samples = 0
    pictures: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for arguments, _ in calls:
        source, u, v = arguments[:3]
        if u is None or v is None or u.ndim != 2:
            continue
        _, seen = pictures.setdefault(id(source), (source, np.zeros(source.shape, dtype=bool)))
        for columns, rows in _places(arguments):
            samples += columns.size
            _mark(seen, columns, rows)
    return samples, [(source.reshape(-1), np.flatnonzero(seen)) for source, seen in pictures.values()]


def _places(arguments: tuple[Any, ...]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Columns and rows (M, N) of the samples that one call takes."""
    _, u, v, *others = arguments
    if len(others) < 5 or not isinstance(others[4], np.ndarray):  # a remap
        yield u, v
        return
    nu, nv, places, sides, band = others[:5]
    for shift, (place, side), way in product(band, zip(places, sides, strict=True), (-1, 0, 1)):
        away = place + shift[:, None] + way * side
        yield u + away * nu, v + away * nv


def _mark(seen: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> None:
    height, width = seen.shape
    inside = (columns >= 0) & (columns <= width - 1) & (rows >= 0) & (rows <= height - 1)
    column, row = (np.rint(part[inside]).astype(np.int64) for part in (columns, rows))
    seen[row, column] = True


def _arithmetic(responses: int, rounds: int) -> float:
    """The response of so many triples of samples, and its mean, s."""
    rng = np.random.default_rng(1)
    side, other, centre = (rng.integers(0, 255, responses).astype(np.int16) for _ in range(3))

    def respond() -> float:
        a, b = side - centre, other - centre
        response = np.maximum(np.minimum(a, b), -np.maximum(a, b))
        np.clip(response, -24, 24, out=response)
        return float(response.mean())

    return least(respond, rounds)


def least(call: Callable[[], object], rounds: int) -> float:
    """CPU seconds of the quickest of some calls."""
    spent = []
    for _ in range(rounds):
        began = time.process_time()
        call()
        spent.append(time.process_time() - began)
    return min(spent)
