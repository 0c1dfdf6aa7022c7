"""Even load or uneven: what a solution says for and against, without solving anew.

Under an even load the residuals hold what the terms of an uneven one would take off; under both, the odds of the one
over the other are how well each explains the same offsets, less what its freedom costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import erfc, log, pi, sqrt
from typing import NamedTuple

import numpy as np

from sagnode.estimate.joint import Solution
from sagnode.estimate.steps import solved_each
from sagnode.geometry.camera import FloatArray
from sagnode.geometry.conductor import load_shapes
from sagnode.survey import CAMERA, LOAD, SWING, Survey

PIECES, STRETCHES = 20, (1, 4, 8, 12)
"""Pieces of the span, and lengths of the stretches on which a load may hang, in such pieces."""
SHARES = (0.05, 0.3)
"""Standard deviations of such a load's weight, over the wire's own: a branch or a trolley, and ice."""


class Unevenness(NamedTuple):
    """What an even solution's residuals say about an uneven load.

    Attributes:
        misfit: what the terms of the load would take off the misfit.
        log_odds: logarithm of the odds of an uneven load over the even one.
        swing: what the swing would be then, and its standard uncertainty, rad.
        surprise: how far such a misfit lies out for a bare wire, as that of a normal variable; 0 where nobody asked.
    """

    misfit: float
    log_odds: float
    swing: tuple[float, float]
    surprise: float = 0.0


@dataclass(frozen=True)
class _Marginal:
    """What an even solution's residuals say of further unknowns, all of its own following.

    Attributes:
        seen: information (K, K) about the further unknowns.
        pull: what pulls at them (K,).
        swing: the even swing as its residuals have it, and its variance, rad.
        turn: what each of them takes off the swing (K,).
    """

    seen: FloatArray
    pull: FloatArray
    swing: tuple[float, float]
    turn: FloatArray


def _marginal(solution: Solution, survey: Survey, own: FloatArray) -> _Marginal:
    """For further unknowns that move the offsets by the columns of ``own`` (M, K)."""
    free = survey.unknowns()
    others, of_own = solution.jacobian[:, free], solution.precision @ own
    between, residual = others.T @ of_own, solution.products[:-1, -1]
    known = np.diag(1 / survey.prior_sigma()[free] ** 2)
    known[CAMERA, CAMERA] += solution.camera.precision
    target = survey.prior_mean() / survey.prior_sigma() ** 2
    target[CAMERA] += solution.camera.vector
    rest = residual[free] + target[free] - known @ solution.theta[free]
    right = np.column_stack([between, np.eye(len(free))[SWING]])
    (solved,), _ = solved_each((solution.products[np.ix_(free, free)] + known)[None], right[None])
    # what the other unknowns can follow is no evidence, and they follow far: what little still pulls at them counts
    follow, of_swing = solved[:, :-1], solved[:, -1]
    seen = own.T @ of_own - between.T @ follow
    pull = of_own.T @ solution.residual - follow.T @ rest
    swing = float(solution.theta[SWING] + of_swing @ rest)
    return _Marginal(seen, pull, (swing, float(of_swing[SWING])), follow[SWING])


def unevenness(solution: Solution, survey: Survey, load_us: Sequence[float]) -> list[Unevenness]:
    """One Gauss-Newton step in the terms of an uneven load, all other unknowns following, without solving anew.

    Args:
        solution: under an even load.
        survey: of it.
        load_us: standard uncertainties of the terms that are tried, one answer each. A prior much wider than the load
            counts against it.
    """
    of = _marginal(solution, survey, solution.jacobian[:, LOAD])
    known = np.array(load_us)[:, None, None] ** -2 * np.eye(len(of.seen))
    right = np.column_stack([of.pull, of.turn, of.seen])
    solutions, spread = solved_each(of.seen + known, np.broadcast_to(right, (len(known), *right.shape)))
    explanations = []
    for u, solved, own_spread in zip(load_us, solutions, spread, strict=True):
        terms, turn, share = solved[:, 0], solved[:, 1], solved[:, 2:]
        misfit = float(of.pull @ terms)
        gained = float(own_spread) + len(terms) * log(u**2)
        swing_u = float(np.sqrt(of.swing[1] + of.turn @ turn))
        swing = float(of.swing[0] - of.turn @ terms)
        odds = 0.5 * (misfit - gained)
        explanations.append(Unevenness(misfit, odds, (swing, swing_u), _surprise(misfit, share)))
    return explanations


def _surprise(misfit: float, share: FloatArray) -> float:
    """How far out a misfit lies for a bare wire, whose offsets err as they say, as that of a normal variable.

    ``share`` (K, K) is what the residuals say of the terms, of all that is known of them.

    What a bare wire's terms take off is a sum of squares, each as large as the picture speaks of it: the sharper the
    view, the more of them there are. Its first two moments make it a χ² of fewer degrees of freedom (Satterthwaite),
    and the cube root of that is nearly normal (Wilson and Hilferty).
    """
    mean, squares = float(np.trace(share)), float(np.sum(share * share.T))
    if mean <= 0 or squares <= 0:
        return 0.0
    freedom = mean**2 / squares
    spread = 2 / (9 * freedom)
    cube_root = float(np.cbrt(max(misfit, 0.0) / mean))
    return (cube_root - (1 - spread)) / sqrt(spread)


def single_loads(solution: Solution, survey: Survey, t: FloatArray) -> list[Unevenness]:
    """What the residuals at the places ``t`` (M,) say of one weight, or of ice on one stretch, wherever it may hang.

    Ten free terms can be any load, and are believed only where the picture leaves no other way; what happens to lines
    is mostly of one place and one size, and shows when ten terms do not yet. The size is a share of the wire's own
    weight, positive, with a Gaussian prior of each of SHARES.
    """
    shapes = solution.jacobian[:, LOAD]
    per_depth = load_shapes(t, shapes.shape[1]).T
    # sag times what a deeper wire moves in the picture: the terms' columns are that times their shapes
    down = np.sum(shapes * per_depth, axis=1) / np.maximum(np.sum(per_depth**2, axis=1), 1e-12)
    of = _marginal(solution, survey, down[:, None] * _single_shapes(t))
    explanations: list[Unevenness] = []
    for u in SHARES:
        information = np.diag(of.seen) + 1 / u**2
        share, spread = of.pull / information, 1 / np.sqrt(information)
        misfit = of.pull * share
        # a load hangs down: half of the Gaussian prior is none of its, and of what is left that which is below nothing
        z = np.clip(share / spread, -30.0, None)
        above = 0.5 * np.array([erfc(-one / sqrt(2)) for one in z])
        hazard = np.exp(-0.5 * z**2) / sqrt(2 * pi) / above
        odds = 0.5 * misfit - 0.5 * np.log(information * u**2) + np.log(2 * above)
        mean = share + spread * hazard
        variance = spread**2 * np.maximum(1 - z * hazard - hazard**2, 1e-3)
        swing = of.swing[0] - of.turn * mean
        swing_u = np.sqrt(of.swing[1] + of.turn**2 * variance)
        swings = zip(swing.tolist(), swing_u.tolist(), strict=True)
        explanations += map(Unevenness, misfit.tolist(), odds.tolist(), swings)
    return explanations


def _single_shapes(t: FloatArray) -> FloatArray:
    """What one load of the wire's own weight adds to the depth below the chord, over the sag of an even one (M, K).

    A load at x bends the cable as ``G = min(s, x) (1 - max(s, x))`` (an even one as ``8 ∫ G dx = 4 s (1 - s)``), and
    what it adds to the mean load is not counted again.
    """
    places = (np.arange(PIECES) + 0.5) / PIECES
    bent = 8 * np.minimum(t[:, None], places) * (1 - np.maximum(t[:, None], places)) - (4 * t * (1 - t))[:, None]
    return np.asarray(bent @ _stretches())


@cache
def _stretches() -> FloatArray:
    """Share of each piece of the span (PIECES, K) in every stretch that may be loaded."""
    columns = []
    for length in STRETCHES:
        for first in range(0, PIECES - length + 1, max(1, length // 2)):
            column = np.zeros(PIECES)
            column[first : first + length] = 1 / length
            columns.append(column)
    return np.stack(columns, axis=1)


def log_odds(rich: Solution, rich_survey: Survey, simple: Solution, simple_survey: Survey) -> float:
    """Logarithm of the odds of one explanation of the same offsets over a simpler one."""
    return evidence(rich, rich_survey, rich.inflation) - evidence(simple, simple_survey, rich.inflation)


def evidence(solution: Solution, survey: Survey, inflation: float) -> float:
    """Logarithm of the evidence of offsets for an explanation (Laplace's approximation), up to what all of them share.

    ``inflation`` is the factor by which the offsets scatter more than they say.
    """
    if solution.log_evidence is not None:
        return solution.log_evidence
    free = survey.unknowns()
    known, mean = survey.prior_information()[np.ix_(free, free)], survey.prior_mean()[free]
    # how much of what was possible before looking is left after it: what freedom costs
    scale = np.sqrt(np.diag(known))
    _, before = np.linalg.slogdet(known / np.outer(scale, scale))
    _, after = np.linalg.slogdet(solution.covariance[np.ix_(free, free)] * np.outer(scale, scale))
    # the solution's misfit leaves out what depends on what was expected alone
    misfit = solution.misfit + float(mean @ known @ mean)
    return float(0.5 * (before + after) - 0.5 * (misfit / inflation + solution.spread))
