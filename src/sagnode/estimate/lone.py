"""A single block of wire that decides alone: what is told must hold without it as well.

Before hills or a tower's lattice, one block may be all that shows the far half of a span. The chance that it is texture
is small, but known badly, and where it is, the estimate is wrong by many of its uncertainties. Where others say the
same, leaving it out changes little.
"""

from __future__ import annotations

import numpy as np

from sagnode.estimate.joint import Solution
from sagnode.geometry.camera import FloatArray
from sagnode.survey import SAG

ALONE = (1.5, 2.0)
"""Factor by which the uncertainty of sag grows without a block, from which that counts, and from which it counts in
full. A block that weighs as much as all else together makes it 1.4."""


def lone_block(solution: Solution, tip: int | None = None) -> FloatArray:
    """Covariance (28, 28) by which the estimate is less sure without the block that decides most, and as far off.

    With C what the offsets err by, P the posterior and ``G = P Jᵀ C⁻¹``, leaving block k out is giving it an unknown
    error of its own: P grows by ``gₖgₖᵀ / sₖ`` with ``sₖ = (C⁻¹ - C⁻¹ J G)ₖₖ``, and θ moves by ``-gₖ (C⁻¹r)ₖ / sₖ``.

    The ``tip`` of a fold is no such block: it is beyond doubt that no other place along the fold is.
    """
    inverse = solution.precision / solution.inflation
    weighed = inverse @ solution.jacobian
    gain = solution.covariance @ weighed.T
    own = np.diag(inverse) - np.einsum("mi,im->m", weighed, gain)
    own = np.maximum(own, 1e-9 * np.diag(inverse))
    growth = np.sqrt(1 + gain[SAG] ** 2 / own / max(solution.covariance[SAG, SAG], 1e-18))
    if tip is not None:
        growth[tip] = 1.0
    k = int(np.argmax(growth))
    weight = float(np.clip((growth[k] - ALONE[0]) / (ALONE[1] - ALONE[0]), 0.0, 1.0))
    pull = float(inverse[k] @ solution.residual)
    return np.asarray(weight * (1 + pull**2 / own[k]) / own[k] * np.outer(gain[:, k], gain[:, k]))
