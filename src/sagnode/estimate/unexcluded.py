"""Single loads that a picture does not exclude, though nothing in it asks for one.

In a strong wind one wire may swing a degree less than the others, or hang under a weight: seen along the line both make
the same picture. A weight is rare, and the even load is told. But the few readings that hang under one must not be told
wrong by many of their uncertainties, where the view could not have told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sagnode.estimate.joint import Solution
from sagnode.estimate.load_kinds import LOAD_U, any_single
from sagnode.estimate.weigh import linear
from sagnode.geometry.camera import FloatArray
from sagnode.survey import SAG, Survey

EXCLUDED, OPEN = 0.004, 0.008
"""Probability of an uneven load up to which a view has excluded one as far as views do, and from which it has not: of a
weight it is 0.01 before looking, and most views leave less than half of that."""
IN_FIVE = 0.5
"""Share of what such a load would typically move the numbers that counts as standard uncertainty: a load that moves
them two and a half times as far is then off by no more than five."""
MOST = 8
"""Kinds of load that are reckoned with, the likeliest."""


@dataclass(frozen=True)
class Loads:
    """What an estimate would be under single loads.

    Attributes:
        theta: under each (K, 28), to both sides of what its own weight leaves open.
        probability: of each among them (K,), 1 together.
        share: of what they typically move a quantity by that counts as its standard uncertainty.
    """

    theta: FloatArray
    probability: FloatArray
    share: float

    def variance(self, here: float, there: FloatArray) -> float:
        """What counts of a quantity that is ``here`` without a load and ``there`` (K,) under each."""
        return self.share**2 * float(self.probability @ (there - here) ** 2)


def unexcluded(solution: Solution, survey: Survey, chance: float, swing: tuple[float, float]) -> Loads | None:
    """Single loads that explain an even solution's offsets as well, by one linear step.

    Args:
        solution: under an even load.
        survey: of it.
        chance: probability of an uneven load.
        swing: that the other conductors let expect, and its standard uncertainty, rad.
    """
    share = float(np.clip((chance - EXCLUDED) / (OPEN - EXCLUDED), 0.0, 1.0))
    if not share or not solution.converged:
        return None
    expected, expected_u = swing
    # what the others let expect takes the place of the survey's prior of the swing
    own = replace(survey, load_u=LOAD_U, load_prior=any_single(), swing_mean=expected, swing_u=expected_u)
    log, theta, covariance = linear(own, solution)
    weight = np.exp(log - log.max())
    kept = np.argsort(log)[::-1][:MOST]
    weight, theta, covariance = weight[kept], theta[kept], covariance[kept]
    # how heavy such a load is, is open too: to both sides as far as it makes the sag less sure than an even load does
    variance = covariance[:, SAG]
    open_u = np.sqrt(np.maximum(variance - solution.covariance[SAG, SAG], 0.0))
    aside = covariance * (open_u / variance)[:, None]
    both = np.concatenate([theta - aside, theta + aside])
    return Loads(both, np.tile(weight / (2 * weight.sum()), 2), IN_FIVE * share)
