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


def lines(members: NDArray[Any], width: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Where to look for the line that each sub-conductor belongs to, and how far from there for its background.

    Args:
        members: offsets of the sub-conductors from the centre line across it, px (m, ...).
        width: projected width of one wire, px (...).

    Returns:
        For each sub-conductor, in rising order, the middle of its line (m, ...) and the distance of the sides from
        that (m, ...), px. No side reaches farther than halfway to the next line.
    """
    outside = np.maximum(width.dtype.type(SIDE_OFFSET_PX), 0.5 * width + width.dtype.type(CLEAR_PX))
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
