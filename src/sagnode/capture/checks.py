"""Frames that a faulty camera delivers without an error: constant, half written, or the same one again.

A real sensor's noise makes no two rows and no two frames alike, bit for bit; only clipped ones are.
"""

from __future__ import annotations

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.errors import FrameError
from sagnode.quality import Cause

_DARK = 16  # black of limited-range video
_CABLE = "check the camera's cable and power; if it goes on, restart the node"


def check_frame(image: GreyImage, previous: GreyImage | None, source: str) -> None:
    """Refuse a frame (h, w) that is constant, ends in unwritten rows, or repeats rows of the previous one.

    Raises:
        FrameError: dark, bad-frame or stale-frame.
    """
    low, high = int(image.min()), int(image.max())
    if low == high:
        if high <= _DARK:
            raise FrameError(f"{source}: black, every pixel is {low}", "lens cap, exposure, cable", Cause.DARK)
        cause = Cause.OVEREXPOSED if low == 255 else Cause.BAD_FRAME
        raise FrameError(f"{source}: every pixel is {low}", _CABLE, cause)
    if previous is not None and previous.shape == image.shape:
        first, repeated = _longest_run((image == previous).all(axis=1))
        if repeated == len(image):
            raise FrameError(f"{source}: the same frame again, bit for bit", _CABLE, Cause.STALE_FRAME)
        # noise alone keeps rows of two frames apart; rows without any may be burnt out in both
        if repeated >= _few(image) and int(np.ptp(image[first : first + repeated])) > 0:
            rows = f"rows {first} to {first + repeated - 1}"
            raise FrameError(f"{source}: two frames in one, {rows} are the last one's", _CABLE, Cause.BAD_FRAME)
    unwritten = _run_from_below((image == image[-1, -1]).all(axis=1))
    if unwritten >= _few(image) and image[-1, -1] < 255:
        what = f"{source}: half a frame, its lower {unwritten} rows are all {image[-1, -1]}"
        raise FrameError(what, _CABLE, Cause.BAD_FRAME)


def _few(image: GreyImage) -> int:
    return max(8, len(image) // 16)


def _longest_run(rows: np.ndarray) -> tuple[int, int]:
    """Where the longest run of rows that hold begins, and how many they are."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(np.int8), [0]])))
    if not len(ends):
        return 0, 0
    lengths = ends[1::2] - ends[::2]
    longest = int(np.argmax(lengths))
    return int(ends[2 * longest]), int(lengths[longest])


def _run_from_below(rows: np.ndarray) -> int:
    """How many rows hold from the lowest upwards."""
    misses = np.flatnonzero(~rows)
    return len(rows) if misses.size == 0 else len(rows) - 1 - int(misses[-1])
