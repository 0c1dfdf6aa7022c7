r"""What neighbouring offsets of one frame share: as much as this very frame shows.

Neighbours along a wire share an error: what the lens model leaves over, the wire's own shading, an edge behind it. How
much differs from lens to lens and from sky to sky. The residuals of an even curve show it: were neighbours to share
nothing, residuals beside each other would not be alike. With K the covariance of the offsets for some size of the
shared error, J their derivatives by θ, r the residuals and P the prior about the solution, the logarithm of what the
offsets are worth as evidence is, with all of θ free,

``-½ (log|K| + log|P⁻¹ + JᵀK⁻¹J| + rᵀK⁻¹r - bᵀ(P⁻¹ + JᵀK⁻¹J)⁻¹b)``, b being the pull of residuals and prior on θ

(restricted likelihood: Patterson and Thompson, Biometrika 58, 1971, with a prior). It is worked out on a grid; all
conductors of a frame, seen through one lens under one sky, answer together, and what is used is the mean over the grid.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sagnode.estimate.joint import Solution
from sagnode.estimate.offsets import CORRELATED_PX, CORRELATED_SHARE
from sagnode.estimate.steps import solved_each
from sagnode.estimate.whitened import whitened_products
from sagnode.geometry.camera import FloatArray
from sagnode.survey import CAMERA, Survey

LEVELS_PX = (0.02, 0.025, 0.03, 0.04, 0.055, 0.075, 0.1)
"""Least shared errors that are compared. What a lens model leaves over may change so slowly across the picture that the
curve follows it and no residual shows it: less than the first is never believed, whatever neighbours show."""
SHARES = (0.2, 0.35, 0.5, 0.7, 1.0)
"""Shares of an offset's own uncertainty that are compared."""
SPREAD = np.log(2.0)
"""Standard deviation of the logarithms of both before looking, about what is usual."""
GRID = np.array([(level, share) for level in LEVELS_PX for share in SHARES])


def before_looking() -> FloatArray:
    """Logarithm (G,) of the probabilities of the grid."""
    apart = np.log(GRID / (CORRELATED_PX, CORRELATED_SHARE)) / SPREAD
    return np.asarray(-0.5 * np.sum(apart**2, axis=1))


def evidence_of_sharing(survey: Survey, solution: Solution) -> FloatArray:
    """Logarithm (G,) of the evidence of an even solution's residuals for every size of the shared error."""
    curve = solution.curve
    free = survey.unknowns()
    rows = np.column_stack([solution.jacobian[:, free], solution.residual])
    products, spread = whitened_products(curve, solution.white, rows, GRID)
    known = survey.prior_information()
    target = known @ survey.prior_mean()
    known[CAMERA, CAMERA] += solution.camera.precision
    target[CAMERA] += solution.camera.vector
    total = products[:, :-1, :-1] + known[np.ix_(free, free)]
    pull = products[:, :-1, -1] + (target - known @ solution.theta)[free]
    step, freedom = solved_each(total, pull[..., None])
    return np.asarray(-0.5 * (spread + freedom + products[:, -1, -1] - np.sum(pull * step[..., 0], axis=1)))


def shared_error(evens: Iterable[tuple[Survey, Solution]]) -> tuple[float, float]:
    """Least error that neighbours share in a frame, px, and the same relative to an offset's own."""
    log = before_looking()
    for survey, solution in evens:
        if solution.converged and solution.curve.in_order:
            log = log + evidence_of_sharing(survey, solution)
    weight = np.exp(log - log.max())
    px, share = np.sqrt(weight @ GRID**2 / weight.sum())
    return float(px), float(share)
