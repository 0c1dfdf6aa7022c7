"""Blocks of wire that decide and may be texture: what is told must hold without them as well.

Before hills or a tower's lattice, one block may be all that shows the far half of a span. The chance that it is texture
is small, but known badly, and where it is, the estimate is wrong by many of its uncertainties. Where others say the
same, leaving it out changes little.

Under an even load one linear step tells what would be left. Under an uneven one other loads may be the likely ones
without the block, and all of them are weighed again. There, too, several blocks in a row along a streak of a meadow can
decide together, since a load bends to all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sagnode.estimate.joint import Solution
from sagnode.estimate.matched import Matched, texture_chance
from sagnode.estimate.register import Registered
from sagnode.estimate.steps import solved
from sagnode.estimate.weigh import solve_loads
from sagnode.geometry.camera import FloatArray
from sagnode.geometry.conductor import load_shapes
from sagnode.survey import CAMERA, LOAD, SAG, SIZE

ALONE = (1.5, 2.0)
"""Factor by which the uncertainty of sag grows without a block, from which that counts, and from which it counts in
full. A block that weighs as much as all else together makes it 1.4."""
MAY_DECIDE = 1.2
"""The same factor, were the load any one and all else linear, from which loads are weighed without a block."""
TEXTURE_CHANCE = 1e-3
"""Chance that a block looked at texture from which it is asked about under an uneven load: what shows so plainly that
it is less is the wire, and nothing else may be all there is of half a span."""
TEXTURE_LIKELY = 0.03
"""The same chance from which blocks are asked about together: a curve that was lost before a forest meets texture after
texture. How much those decide, no linear step foretells: a load that bends to them agrees with all of them."""


def lone_block(solution: Solution, tip: int | None = None) -> FloatArray:
    """Covariance (28, 28) by which the estimate is less sure without the block that decides most, and as far off.

    With C what the offsets err by, P the posterior and ``G = P Jᵀ C⁻¹``, leaving block k out is giving it an unknown
    error of its own: P grows by ``gₖgₖᵀ / sₖ`` with ``sₖ = (C⁻¹ - C⁻¹ J G)ₖₖ``, and θ moves by ``-gₖ (C⁻¹r)ₖ / sₖ``.

    The ``tip`` of a fold is no such block: it is beyond doubt that no other place along the fold is.
    """
    gain, own = _leaving_out(solution, solution.covariance)
    growth = np.sqrt(1 + gain[SAG] ** 2 / own / max(solution.covariance[SAG, SAG], 1e-18))
    if tip is not None:
        growth[tip] = 1.0
    k = int(np.argmax(growth))
    weight = counts(float(growth[k]))
    pull = float(solution.precision[k] @ solution.residual) / solution.inflation
    return np.asarray(weight * (1 + pull**2 / own[k]) / own[k] * np.outer(gain[:, k], gain[:, k]))


def _leaving_out(solution: Solution, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The gain G (28, M) of the offsets under a posterior, and what each says that the others do not, s (M,)."""
    inverse = solution.precision / solution.inflation
    weighed = inverse @ solution.jacobian
    gain = covariance @ weighed.T
    own = np.diag(inverse) - np.sum(weighed * gain.T, axis=1)
    return gain, np.maximum(own, 1e-9 * np.diag(inverse))


def counts(growth: float) -> float:
    """How much a block counts by the factor by which the uncertainty of sag grows without it, 0..1."""
    return float(np.clip((growth - ALONE[0]) / (ALONE[1] - ALONE[0]), 0.0, 1.0))


def without_lone(found: Matched, registered: Registered, iterations: int) -> Solution | None:
    """A conductor under an uneven load solved for without the blocks that may be texture; None where there are none."""
    deciding = _deciding(found, registered)
    if not 0 < len(deciding) < len(found.offsets.t):
        return None
    kept = np.ones(len(found.offsets.t), dtype=bool)
    kept[deciding] = False
    solution = solve_loads(found.survey, found.solution.theta, registered.camera, found.offsets.some(kept), iterations)
    return solution if solution.converged and np.isfinite(solution.covariance).all() else None


def _deciding(found: Matched, registered: Registered) -> NDArray[np.intp]:
    """The blocks to do without: all that are likely to be texture, where several are, and the one that decides most.

    That one may be texture, and without it the depth at mid-span would be much less certain; there may be none. Of
    several the surest stays, whatever it is.
    """
    chance = texture_chance(found)
    likely = np.flatnonzero(chance >= TEXTURE_LIKELY)
    survey, solution = found.survey, found.solution
    free = survey.unknowns()
    known = survey.prior_information() + solution.products[:-1, :-1] / solution.inflation
    known[CAMERA, CAMERA] += registered.camera.precision
    covariance = np.zeros((SIZE, SIZE))
    covariance[np.ix_(free, free)] = solved(known[np.ix_(free, free)], np.eye(len(free)))
    shapes = load_shapes(np.array([0.5]), LOAD.stop - LOAD.start)[:, 0]
    depth = np.zeros(SIZE)
    depth[SAG], depth[LOAD] = 1 + shapes @ solution.theta[LOAD], solution.theta[SAG] * shapes
    gain, own = _leaving_out(solution, covariance)
    variance = max(float(depth @ covariance @ depth), 1e-18)
    some = np.flatnonzero(chance >= TEXTURE_CHANCE)
    growth = np.sqrt(1 + (depth @ gain[:, some]) ** 2 / own[some] / variance)
    most = np.argsort(growth)[-1:]
    deciding = some[most[growth[most] > MAY_DECIDE]]
    if len(likely) < 2:
        return deciding
    return np.setdiff1d(np.union1d(likely, deciding), [np.argmin(chance)])
