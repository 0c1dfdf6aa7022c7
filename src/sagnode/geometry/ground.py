"""The ground below the span: a profile of straight pieces, and obstacles that stand on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sagnode.geometry.camera import FloatArray


@dataclass(frozen=True)
class GroundProfile:
    """Heights of the site frame over the horizontal distance from A; constant beyond its ends.

    Attributes:
        along: distances (N,), ascending, m.
        height: heights (N,), m.
        obstacles: (M, 3) rows of from, to (along) and top height, m.
        height_u: standard uncertainty of the heights, m.
    """

    along: FloatArray
    height: FloatArray
    obstacles: FloatArray
    height_u: float

    def top(self, along: FloatArray) -> FloatArray:
        """Height of the ground or of the obstacle that stands there (same shape as ``along``), m."""
        top = np.interp(along, self.along, self.height)
        for start, end, height in self.obstacles:
            top = np.where((along >= start) & (along <= end), np.maximum(top, height), top)
        return np.asarray(top)
