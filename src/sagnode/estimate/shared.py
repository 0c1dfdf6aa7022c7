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
from sagnode.estimate.offsets import CORRELATED_PX, CORRELATED_SHARE, CORRELATION_LENGTH_PX, CurveObservations
from sagnode.geometry.camera import FloatArray
from sagnode.native import kernels
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
    products, spread = _products(curve, solution.white, rows)
    known = survey.prior_information()
    target = known @ survey.prior_mean()
    known[CAMERA, CAMERA] += solution.camera.precision
    target[CAMERA] += solution.camera.vector
    total = products[:, :-1, :-1] + known[np.ix_(free, free)]
    pull = products[:, :-1, -1] + (target - known @ solution.theta)[free]
    scale = 1 / np.sqrt(np.diagonal(total, axis1=1, axis2=2))
    scaled = total * scale[:, :, None] * scale[:, None, :]
    freedom = np.linalg.slogdet(scaled)[1] - 2 * np.log(scale).sum(axis=1)
    step = np.linalg.solve(scaled, (scale * pull)[..., None])[..., 0]
    return np.asarray(-0.5 * (spread + freedom + products[:, -1, -1] - np.sum(scale * pull * step, axis=1)))


def _products(curve: CurveObservations, white: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Products (G, K, K) of the columns of rows (M, K) whitened by every member of the grid, and log det (G,)."""
    if kernels is None:
        whitened, spread = _whitened(curve, white, rows)
        return np.swapaxes(whitened, 1, 2) @ whitened, spread
    products, spread = np.empty((len(GRID), rows.shape[1], rows.shape[1])), np.empty(len(GRID))
    own = (np.ascontiguousarray(part, dtype=np.float64) for part in (_kept(curve), curve.sigma, white, rows))
    kernels.shared_products(*own, GRID, products, spread)
    return products, spread


def _kept(curve: CurveObservations) -> FloatArray:
    """What an error keeps of itself from one offset to the next (M,); nothing at the first."""
    return np.asarray(np.exp(-np.diff(curve.arc, prepend=-np.inf) / CORRELATION_LENGTH_PX))


def _whitened(curve: CurveObservations, white: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows (M, K) whitened by the offsets' covariance for every member of the grid (G, M, K), and its log det (G,).

    An error that falls off exponentially along the curve is a first-order Markov process: a scalar Kalman filter
    follows it from one offset to the next, and its normalised innovations are the whitened rows.
    """
    shared = GRID[:, :1] ** 2 + (GRID[:, 1:] * curve.sigma) ** 2
    kept = _kept(curve)
    state, variance = np.zeros((len(GRID), rows.shape[1])), np.ones(len(GRID))
    whitened, spread = np.empty((len(GRID), *rows.shape)), np.zeros(len(GRID))
    for n, row in enumerate(rows):
        own = np.sqrt(shared[:, n])
        before = kept[n] ** 2 * variance + (1 - kept[n] ** 2)
        total = shared[:, n] * before + white[n]
        foreseen = kept[n] * state
        surprise = row - own[:, None] * foreseen
        state = foreseen + (own * before / total)[:, None] * surprise
        whitened[:, n] = surprise / np.sqrt(total)[:, None]
        variance = before * white[n] / total
        spread += np.log(total)
    return whitened, spread


def shared_error(evens: Iterable[tuple[Survey, Solution]]) -> tuple[float, float]:
    """Least error that neighbours share in a frame, px, and the same relative to an offset's own."""
    log = before_looking()
    for survey, solution in evens:
        if solution.converged and solution.curve.in_order:
            log = log + evidence_of_sharing(survey, solution)
    weight = np.exp(log - log.max())
    px, share = np.sqrt(weight @ GRID**2 / weight.sum())
    return float(px), float(share)
