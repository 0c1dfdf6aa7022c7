"""A closer look at a wire that was found across a curve: where exactly it lies.

The kernel that finds a wire takes in background on both sides, since that tells a wire from an edge. To say where it
lies that background is no help: what changes slowly across the wire, clouds, hills and the folds of a wood, is by far
the larger part of a picture's texture, and pulls a broad kernel more than the sensor's noise does. A kernel as sharp as
the sharpest lens, in a window that hardly reaches beyond the wire, sees little of it. With the wire's profile k and its
derivative d across, both without mean and slope within the window, least squares give ``a k + b d``, and the wire lies
b / a farther. Where a plain sky and a faint wire leave nothing but the sensor's noise, the broad kernel is surer; which
of them is, both say themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.kernels import STEP_PX, steps, wire_kernel, wire_slope

SHARP_BLUR_PX = 0.7
"""Standard deviation of the blur of a sharp picture."""
SHARP_MARGIN_PX = 1.0
"""Background that the window takes in on either side of the wire's blurred edge."""
LEAST_REACH = 2
"""Least half length of a window, steps: two on either side tell a line from a slope."""
ROUNDS = 2
"""Steps of Gauss and Newton's method."""
LONGEST_PX, SHORT_PX = 0.5, 0.02
"""Longest of these steps, and one after which another would change nothing."""
FARTHEST_PX = 0.75
"""What lies farther than this from where the wire was found is another thing."""


@dataclass(frozen=True)
class Close:
    """What the closer look shows of M blocks.

    Attributes:
        farther: how much farther across the wire lies than where it was found, px (M,); NaN where nothing was found, or
            where something else lies.
        noise: mean square of what the fit leaves (M,).
        uneven: mean square of that of it which is not alike on both sides (M,); 0 where nothing was found.
        steepness: what a noise is to be divided by for the place's uncertainty, 1/px (M,), if wires of height 1 were as
            sharp as the kernel.
        reply: the same as the picture shows it, grey levels a px (M,), for its own wires as sharp as it is, positive
            for bright ones. One block by itself shows it badly.
    """

    farther: FloatArray
    noise: FloatArray
    uneven: FloatArray
    steepness: FloatArray
    reply: FloatArray


def look_closer(
    profiles: list[FloatArray],
    middles: FloatArray,
    width: FloatArray,
    found: FloatArray,
    margin_px: float,
    most: int,
) -> Close:
    """Fit the wires of M blocks where they were found.

    Args:
        profiles: across each sub-conductor, (M, K), steps apart.
        middles: where the sub-conductors lie across the centre line, px (m, M).
        width: of one wire, px (M,).
        found: column of the profiles at which each lies (M,), with its fraction; not finite where none was found.
        margin_px: background that may be taken in.
        most: farthest that a window may reach to either side, steps.
    """
    wires, lost = len(profiles), ~np.isfinite(found)
    middle = np.rint(np.where(lost, profiles[0].shape[1] // 2, found))
    start = np.where(lost, 0.0, STEP_PX * (found - middle))
    asked = (0.5 * width + 1.5 * SHARP_BLUR_PX + min(margin_px, SHARP_MARGIN_PX)) / STEP_PX
    reach = np.clip(np.ceil(asked), LEAST_REACH, most).astype(np.int64)
    window = _Window(middle.astype(np.intp), steps(int(reach.max())), reach)
    seen = np.stack([window.level(window.of(profile)) for profile in profiles])
    moving = np.stack([window.of(profile, 1) - window.of(profile, -1) for profile in profiles]) / (2 * STEP_PX)
    place = seen_from = start.copy()
    going = ~lost
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            seen_from = np.where(going, place, seen_from)
            shown, moved = _shapes(window, middles, width, seen_from)
            square = _sum(shown, shown)
            moved = moved - (_sum(shown, moved) / square)[:, None] * shown
            alone = _sum(moved, moved)
            height, turn = _sum(shown, seen) / square, _sum(moved, seen) / alone
            step = np.clip(turn / height, -LONGEST_PX, LONGEST_PX)
            place = np.where(going, place + step, place)
            going = going & ~(np.abs(step) < SHORT_PX)
        farther = np.where(lost | ~(np.abs(place - start) <= FARTHEST_PX), np.nan, place - start)
        steepness = np.sqrt(alone)
        reply = -_sum(moved, moving) / steepness
    rest = seen - height[:, None] * shown - turn[:, None] * moved
    order = np.argsort(middles.mean(axis=1))
    odd = 0.5 * (rest[order] - rest[order[::-1], :, ::-1])
    noise = _sum(rest, rest) / (wires * (2 * reach + 1) - 2 * wires - 2)
    uneven = _sum(odd, odd) / np.maximum(wires * reach - wires - 1, 1)
    known = np.isfinite(rest).all(axis=(0, 2)) & ~lost
    parts = (np.where(known, part, 0.0) for part in (noise, uneven, steepness, reply))
    return Close(farther, *parts)


@dataclass(frozen=True)
class _Window:
    """Columns of M profiles: ``steps`` (n,) about a middle (M,), of which each block uses its reach (M,)."""

    middle: NDArray[np.intp]
    steps: FloatArray
    reach: NDArray[np.int64]

    def of(self, profile: FloatArray, aside: int = 0) -> FloatArray:
        """What a profile (M, K) shows there, or some columns aside."""
        columns = self.middle[:, None] + self.steps.astype(np.intp) + aside
        return np.take_along_axis(profile, np.clip(columns, 0, profile.shape[1] - 1), axis=1)

    def level(self, values: FloatArray) -> FloatArray:
        """Values (M, n) in the windows without mean and slope, zero beyond."""
        used = np.abs(self.steps) <= self.reach[:, None]
        count = 2 * self.reach[:, None] + 1
        inner = np.where(used, values, 0.0)
        tilt = np.where(used, self.steps, 0.0)
        slope = np.sum(inner * tilt, axis=1, keepdims=True) / np.sum(tilt**2, axis=1, keepdims=True)
        return np.where(used, inner - inner.sum(axis=1, keepdims=True) / count - slope * tilt, 0.0)


def _shapes(
    window: _Window, middles: FloatArray, width: FloatArray, place: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What all wires together show about each of them (m, M, n), and how that changes as they move.

    Each lies ``place`` (M,) px off the middle of its window.
    """
    across = STEP_PX * window.steps - place[:, None]
    shown, moved = [], []
    for own in middles:
        aside = [across - (other - own)[:, None] for other in middles]
        shown.append(window.level(np.sum([wire_kernel(width, one, SHARP_BLUR_PX) for one in aside], axis=0)))
        moved.append(window.level(np.sum([-wire_slope(width, one, SHARP_BLUR_PX) for one in aside], axis=0)))
    return np.stack(shown), np.stack(moved)


def _sum(one: FloatArray, other: FloatArray) -> FloatArray:
    """Sums (M,) of products (m, M, n) over windows and wires."""
    return np.asarray(np.sum(one * other, axis=(0, 2)))
