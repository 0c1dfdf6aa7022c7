"""The last solution of what hangs evenly, when all of a frame is known: each offset for what it is worth by then.

While a wire is looked for, what is weak must weigh little: background texture looks like a wire now and then, and an
offset that may be texture is taken for as uncertain as that leaves it. When the wire is found, where a block lies says
more. Texture shows a peak anywhere within the range that was searched; the wire lies where the rest of it foretells,
as uncertain as that is. Bayes' rule puts both together. The rest is all that lies farther along the curve than errors
and texture reach: a hedge along the wire does not foretell itself.

And what neighbours share is as much as this frame shows (:mod:`sagnode.estimate.shared`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from sagnode.estimate.joint import Solution, solve, solve_on_curve
from sagnode.estimate.judge import most_sag_u
from sagnode.estimate.matched import Matched, tip_of
from sagnode.estimate.offsets import CORRELATION_LENGTH_PX, CurveObservations
from sagnode.estimate.refinement import STAGES
from sagnode.estimate.register import Registered
from sagnode.estimate.shared import shared_error
from sagnode.estimate.steps import solved_each
from sagnode.geometry.camera import FloatArray
from sagnode.match.standing import chance_of, spread_by
from sagnode.survey import SAG, SWING

STAYS = 2.0
"""Standard uncertainties of sag and swing by which the last solution may differ from the one before. Both come of the
same offsets: what moves farther hung on a few of them."""


OF_CURVE, WORTHWHILE = ("pixel noise", "correlated curve error", "texture taken for wire"), 0.15
"""What offsets add to the uncertainty of sag, and the share of its variance from which judging them anew can change it
by more than some percent."""
_SIDES: tuple[tuple[int, Literal["left", "right"]], ...] = ((-1, "left"), (1, "right"))
UNFORETOLD = 2 / np.pi
"""Variance over the square of a range at which a normal density is, in its middle, what an even one is."""


def conclude(
    found: Mapping[str, Matched], registered: Registered, shared: tuple[float, float] | None = None
) -> dict[str, Matched]:
    """Every conductor, by id, those under an even load solved for once more.

    ``shared`` is what neighbouring offsets share, px and relative to their own, where the frame itself cannot tell.
    """
    judged = {name: _judged(match, registered) for name, match in found.items() if _is_settled(match)}
    px, share = shared or shared_error((found[name].survey, solution) for name, solution in judged.items())
    result = dict(found)
    for name, solution in judged.items():
        match = found[name]
        offsets = replace(solution.curve, shared_px=px, shared_share=share)
        # the normal of a fold's tip is not across the curve
        solve_last = solve_on_curve if tip_of(match) is None else solve
        last = solve_last(match.survey, solution.theta, registered.camera, offsets, STAGES[-1].iterations)
        if _agree(match.solution, last):
            result[name] = replace(match, solution=last, offsets=last.curve)
    return result


def _is_settled(match: Matched) -> bool:
    """Whether a conductor hangs evenly, as far as is known, and what was seen of itself fixed it.

    What is too uncertain to be told is not made certain by its own offsets: of a few, one may foretell the other. What
    is uncertain for other reasons than its offsets is as good as concluded.
    """
    settled = match.solution.converged and match.solution.curve.in_order
    if match.survey.load_u or match.crowded or not settled:
        return False
    pieces = match.solution.information(match.survey, slice(SAG, SAG + 1))
    parts = {name: float(part[0, 0]) for name, part in pieces.items()}
    variance, of_curve = sum(parts.values()), sum(parts.get(name, 0.0) for name in OF_CURVE)
    return variance <= most_sag_u(match, match.sag[0]) ** 2 and of_curve > WORTHWHILE * variance


def _judged(match: Matched, registered: Registered) -> Solution:
    """The same conductor, its offsets as uncertain as where they lie leaves them."""
    offsets = judged_by_place(match)
    return solve(match.survey, match.solution.theta, registered.camera, offsets, STAGES[-1].iterations)


def judged_by_place(match: Matched) -> CurveObservations:
    """The offsets of a conductor, with the chance that each is texture as the rest of the wire leaves it."""
    observed, offsets = match.observed, match.offsets
    use = observed.usable
    half_range = observed.half_range[use]
    own = np.hypot(observed.noise[use], observed.scatter[use])
    aside, foretold = foretold_by_others(match.solution)
    # what others do not foretell is as likely anywhere within the range, texture or wire
    variance = np.minimum(foretold, UNFORETOLD * half_range**2) + own**2
    wire = np.exp(-0.5 * aside**2 / variance) / np.sqrt(2 * np.pi * variance)

    def by_place(chance: FloatArray) -> FloatArray:
        texture = chance / (2 * half_range)
        return np.asarray(texture / (texture + (1 - chance) * wire))

    # what made it weigh less, and what it may be for all that its neighbours lead the background
    weighed = by_place(chance_of(np.sqrt(np.maximum(offsets.sigma**2 - own**2, 0.0)), half_range))
    at_most = by_place(chance_of(observed.texture[use], half_range))
    return replace(
        offsets,
        sigma=np.hypot(own, spread_by(weighed, half_range)),
        texture=spread_by(np.maximum(at_most - weighed, 0.0), half_range),
    )


def foretold_by_others(solution: Solution) -> tuple[FloatArray, FloatArray]:
    """How far each offset (M,) lies from where others foretell it, px, and the variance of that without its own, px².

    The variance is infinite where others foretell nothing. Others are those farther along the curve than neighbours
    share their error. With C the covariance of the offsets, Σ the posterior's, and ``Q = C⁻¹ - C⁻¹JΣJᵀC⁻¹`` the inverse
    of what offsets vary by before looking, the residuals r of a group N about what all others foretell are
    ``(Q_NN)⁻¹ (C⁻¹r)_N`` with the covariance ``(Q_NN)⁻¹``.
    """
    white, arc, count = solution.white, solution.curve.arc, len(solution.white)
    inverse = solution.precision / solution.inflation
    weighed = inverse @ solution.jacobian
    precision = inverse - weighed @ solution.covariance @ weighed.T
    pull = inverse @ solution.residual
    first, beyond = (np.searchsorted(arc, arc + side * CORRELATION_LENGTH_PX, which) for side, which in _SIDES)
    group = first[:, None] + np.arange(np.max(beyond - first))
    member = group < beyond[:, None]
    group = np.minimum(group, count - 1)
    # groups of different sizes are filled up with what has nothing to do with anything
    of_group = precision[group[:, :, None], group[:, None]] * (member[:, :, None] & member[:, None])
    of_group += np.eye(group.shape[1]) * ~member[:, :, None]
    covariance, _ = solved_each(of_group, np.broadcast_to(np.eye(group.shape[1]), of_group.shape))
    every = np.arange(count)
    own = covariance[every, every - first]
    aside, variance = np.sum(own * np.where(member, pull[group], 0.0), axis=1), own[every, every - first]
    # rounding makes a group's precision anything where the others say nothing of it
    told = np.isfinite(variance)
    variance = np.where(told, variance, np.inf)
    return np.where(told, aside, 0.0), np.maximum(variance - white * solution.inflation, 0.0)


def _agree(before: Solution, last: Solution) -> bool:
    apart = [abs(last.theta[k] - before.theta[k]) <= STAYS * np.sqrt(before.covariance[k, k]) for k in (SAG, SWING)]
    return last.converged and bool(np.isfinite(last.covariance).all()) and all(apart)
