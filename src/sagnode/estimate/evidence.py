"""Even load or uneven: what a solution says for and against, without solving anew.

Under an even load the residuals hold what the terms of an uneven one would take off; under both, the odds of the one
over the other are how well each explains the same offsets, less what its freedom costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sagnode.estimate.joint import Solution
from sagnode.survey import CAMERA, LOAD, SWING, Survey


@dataclass(frozen=True)
class Unevenness:
    """What an even solution's residuals say about an uneven load.

    Attributes:
        misfit: what the terms of the load would take off the misfit; evenly loaded wires rarely exceed 3.
        log_odds: logarithm of the odds of an uneven load over the even one.
        swing: what the swing would be then, and its standard uncertainty, rad.
    """

    misfit: float
    log_odds: float
    swing: tuple[float, float]


def unevenness(solution: Solution, survey: Survey, load_us: Sequence[float]) -> list[Unevenness]:
    """One Gauss-Newton step in the terms of an uneven load, all other unknowns following, without solving anew.

    Args:
        solution: under an even load.
        survey: of it.
        load_us: standard uncertainties of the terms that are tried, one answer each. A prior much wider than the load
            counts against it.
    """
    free = survey.unknowns()
    white, correlated = solution.noise
    own, others = solution.jacobian[:, LOAD], solution.jacobian[:, free]
    solved = np.linalg.solve(np.diag(white) + correlated, np.column_stack([own, solution.residual, others]))
    of_own, of_residual, of_others = np.split(solved, [own.shape[1], own.shape[1] + 1], axis=1)
    known = np.diag(1 / survey.prior_sigma()[free] ** 2)
    known[CAMERA, CAMERA] += solution.camera.precision
    left = np.linalg.inv(others.T @ of_others + known)
    # what the other unknowns can follow is no evidence, and they follow far: what little still pulls at them counts
    follow = left @ (others.T @ of_own)
    target = survey.prior_mean() / survey.prior_sigma() ** 2
    target[CAMERA] += solution.camera.vector
    rest = others.T @ of_residual[:, 0] + target[free] - known @ solution.theta[free]
    seen = own.T @ of_own - (others.T @ of_own).T @ follow
    pull, turn = own.T @ of_residual[:, 0] - follow.T @ rest, follow[SWING]
    explanations = []
    for u in load_us:
        information = seen + np.eye(len(seen)) / u**2
        terms = np.linalg.solve(information, pull)
        misfit = float(pull @ terms)
        _, gained = np.linalg.slogdet(information * u**2)
        swing_u = float(np.sqrt(left[SWING, SWING] + turn @ np.linalg.solve(information, turn)))
        swing = float(solution.theta[SWING] + left[SWING] @ rest - turn @ terms)
        explanations.append(Unevenness(misfit, 0.5 * (misfit - float(gained)), (swing, swing_u)))
    return explanations


def log_odds(rich: Solution, rich_survey: Survey, simple: Solution, simple_survey: Survey) -> float:
    """Logarithm of the odds of one explanation of the same offsets over a simpler one (Laplace's approximation)."""

    def half(solution: Solution, survey: Survey) -> float:
        free = survey.unknowns()
        white, correlated = solution.noise
        _, spread = np.linalg.slogdet(np.diag(white) + correlated)
        # how much of what was possible before looking is left after it: what freedom costs
        left = np.linalg.slogdet(solution.covariance[np.ix_(free, free)] / np.outer(*2 * [survey.prior_sigma()[free]]))
        return float(0.5 * left[1] - 0.5 * (solution.misfit / rich.inflation + spread))

    return half(rich, rich_survey) - half(simple, simple_survey)
