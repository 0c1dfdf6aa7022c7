"""The median of few values: NumPy's own takes fifty times as long as sorting them."""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray


def median(values: FloatArray) -> float:
    """Median of values (N,), at least one; NaN where any of them is."""
    order = np.sort(values)
    middle = len(order) // 2
    if np.isnan(order[-1]):
        return float("nan")
    return float(order[middle] if len(order) % 2 else 0.5 * (order[middle - 1] + order[middle]))
