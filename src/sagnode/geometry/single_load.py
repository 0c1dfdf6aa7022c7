"""One load on one stretch of a span, a weight or ice, as terms of an uneven load (:mod:`sagnode.geometry.conductor`).

The load carries the share r of all that hangs from the conductor, evenly over the stretch of the length l about the
place x, both as fractions of the span: ``w(s) = w̄ (1 - r + r/l)`` on it and ``w̄ (1 - r)`` beside it. A weight is a
stretch too short to be told from a point. With F = Pₖ₊₁ - Pₖ₋₁, whose derivative is (2k+1) Pₖ, and the ends of the
stretch at 2x - 1 ± l on the way from -1 to 1, the terms are ``cₖ = r (F(2x-1+l) - F(2x-1-l)) / 2l``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sagnode.geometry.camera import FloatArray


def single_load_terms(share: ArrayLike, place: ArrayLike, length: ArrayLike, count: int) -> FloatArray:
    """The first ``count`` terms (..., count) of one load, or of many.

    Args:
        share: of all that hangs from the conductor (...).
        place: middle of the stretch, as a fraction of the span (...).
        length: of the stretch, as a fraction of the span (...), greater than 0; all of it within the span.
        count: how many terms.
    """
    share, place, length = np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in (share, place, length)))
    k = np.arange(1, count + 1)
    first, last = (
        values[..., k + 1] - values[..., k - 1]
        for values in (np.polynomial.legendre.legvander(2 * place - 1 + side * length, count + 1) for side in (-1, 1))
    )
    # of one load NumPy makes a row
    return np.asarray(((share / (2 * length))[..., None] * (last - first)).reshape(*share.shape, count))
