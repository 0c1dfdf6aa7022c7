"""How near the other conductors come to one in the picture, and whether they cross it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.ribbon import normals

MERGED_PX = 3.0
"""Two wires nearer than this are one line to the picture: each lies within the other's blurred profile."""
NEAR_PX = 25.0
"""Beyond this another wire disturbs nothing."""
_AT_ONCE = 64
"""Points compared with a whole polyline in one go."""


@dataclass(frozen=True)
class Neighbour:
    """Another conductor in the picture."""

    conductor: str
    closest_px: float
    """Least distance from this conductor's curve."""
    at_share: float
    """Where along the span, 0 to 1 from A."""
    merged_share: float
    """Share of the visible span along which it is nearer than MERGED_PX."""
    crosses: bool
    """Whether it passes from one side of the curve to the other."""


def neighbours(curve: FloatArray, others: Mapping[str, FloatArray]) -> list[Neighbour]:
    """Conductors that come nearer than NEAR_PX to a curve, the nearest first.

    Args:
        curve: pixels (N, 2) by equal steps along the span; NaN where not in the frame.
        others: the same of other conductors, by id.
    """
    found = []
    share = np.linspace(0.0, 1.0, len(curve))
    visible = np.isfinite(curve).all(axis=1)
    normal = normals(curve)
    for name, other in others.items():
        signed, beside = np.full(len(curve), np.nan), np.zeros(len(curve), dtype=bool)
        kept = visible & np.isfinite(normal).all(axis=1)
        signed[kept], beside[kept] = _signed_distance(curve[kept], normal[kept], other)
        distance = np.abs(signed)
        if not np.isfinite(distance).any() or np.nanmin(distance) > NEAR_PX:
            continue
        nearest = int(np.nanargmin(distance))
        found.append(
            Neighbour(
                name,
                float(distance[nearest]),
                float(share[nearest]),
                float(np.count_nonzero(distance[kept] < MERGED_PX) / max(int(visible.sum()), 1)),
                _crosses(np.where(beside, signed, np.nan)),
            )
        )
    return sorted(found, key=lambda neighbour: neighbour.closest_px)


def _signed_distance(points: FloatArray, normal: FloatArray, other: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Distance (N,) from points (N, 2) to a polyline (K, 2), negative on the side away from the normal (N, 2).

    With it, which points (N,) have the polyline beside them and not only one of its ends ahead.
    """
    start, end = other[:-1], other[1:]
    whole = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    start, end = start[whole], end[whole]
    result, beside = np.full(len(points), np.nan), np.zeros(len(points), dtype=bool)
    if not len(start):
        return result, beside
    step = end - start
    length2 = np.maximum(np.sum(step**2, axis=1), 1e-12)
    for some in np.array_split(np.arange(len(points)), len(points) // _AT_ONCE + 1):
        offset = points[some, None, :] - start
        along = np.clip(np.sum(offset * step, axis=2) / length2, 0.0, 1.0)
        away = along[..., None] * step - offset
        nearest = np.argmin(np.sum(away**2, axis=2), axis=1)
        row = np.arange(len(some))
        foot, place = away[row, nearest], along[row, nearest]
        result[some] = np.copysign(np.hypot(*foot.T), np.sum(foot * normal[some], axis=1))
        beside[some] = ~(((nearest == 0) & (place <= 0)) | ((nearest == len(start) - 1) & (place >= 1)))
    return result, beside


def _crosses(signed: FloatArray) -> bool:
    """Whether the sign changes between neighbouring points that are both near; NaN is no neighbour."""
    before, after = signed[:-1], signed[1:]
    with np.errstate(invalid="ignore"):
        near = (np.abs(before) < NEAR_PX) & (np.abs(after) < NEAR_PX)
        return bool(np.any(near & (np.sign(before) != np.sign(after))))
