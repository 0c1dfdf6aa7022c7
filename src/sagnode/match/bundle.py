"""What of a bundle can be told apart in the picture: its sub-conductors, or lines that several of them make."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sagnode.match.ribbon import SIDE_OFFSET_PX

RESOLVED_PX = 2.0
"""Two wires whose middles are nearer than this, or whose edges nearly touch, are one line in the picture."""
CLEAR_PX = 1.5
"""Background that must show between the edges of two wires, and that is taken beside a line's edge."""
SHORTER_SIDE = 0.3
"""By which share of a band's step a wire's sides may be looked at nearer to it than elsewhere."""
LEAST_STEP_PX = 0.5


def beside(width: NDArray[Any], step: NDArray[Any] | None = None) -> NDArray[Any]:
    """How far from the middle of a single line its background is looked at, px (...), by its width, px (...).

    Where a line is looked for in a band, with ``step`` (n,) between its places along the first axis, it is a whole
    number of steps: the sides of one place are the middles and sides of others.
    """
    outside = np.asarray(np.maximum(width.dtype.type(SIDE_OFFSET_PX), 0.5 * width + width.dtype.type(CLEAR_PX)))
    if step is None:
        return outside
    wide = step.reshape(-1, *(1,) * (width.ndim - 1))
    snapped = wide * np.maximum(np.ceil(outside / np.maximum(wide, LEAST_STEP_PX) - SHORTER_SIDE), 1)
    return np.asarray(np.where(wide >= LEAST_STEP_PX, snapped, outside), dtype=width.dtype)


def lines(members: NDArray[Any], width: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Where to look for the line that each sub-conductor belongs to, and how far from there for its background.

    Args:
        members: offsets of the sub-conductors from the centre line across it, px (m, ...).
        width: projected width of one wire, px (...).

    Returns:
        For each sub-conductor, in rising order, the middle of its line (m, ...) and the distance of the sides from
        that (m, ...), px. No side reaches farther than halfway to the next line.
    """
    outside = beside(width)
    if len(members) == 1:
        return members, outside[None]
    order = np.sort(members, axis=0)
    touching = np.maximum(RESOLVED_PX, width + CLEAR_PX).astype(order.dtype)
    first, last = order.copy(), order.copy()
    before, after = np.full_like(order, -np.inf), np.full_like(order, np.inf)
    for k in range(1, len(order)):
        joined = order[k] - order[k - 1] < touching
        first[k] = np.where(joined, first[k - 1], order[k])
        before[k] = np.where(joined, before[k - 1], order[k - 1])
    for k in range(len(order) - 2, -1, -1):
        joined = order[k + 1] - order[k] < touching
        last[k] = np.where(joined, last[k + 1], order[k])
        after[k] = np.where(joined, after[k + 1], order[k + 1])
    half, gap = 0.5 * (last - first), np.minimum(first - before, after - last)
    return 0.5 * (first + last), half + np.minimum(outside, 0.5 * gap)
