"""The swings of a span's conductors as evidence of their loads.

One wind blows on all of them, so they swing alike. Seen along the line, ice or a weight on a part of a conductor looks
like a swing that it does not have, and to different sides for conductors on different sides of the camera: what each
picture of a wire leaves open by itself, the wires together decide.

Every conductor has two explanations, an even load and an uneven one, each with its evidence and with what it says about
the swing. The swings are spread about a common one φ̄, which has the survey's prior; loads are iced together or weighted
singly. All of it is Gaussian in the swings, and φ̄ is integrated over a grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.native import kernels

SPREAD = (np.radians(0.3), 0.1)
"""Standard deviation of a conductor's swing about the common one: this angle, and this share of the common swing."""
ICY_READINGS, ICED_THEN, WEIGHTED = 0.02, 0.9, 0.01
"""Share of readings under ice, share of the conductors that are unevenly iced then, and of those with a weight else."""
ASTRAY = 0.1
"""Chance that what one conductor says of its swing is wrong by more than it says."""
GRID = np.linspace(-4.0, 4.0, 641)
"""Common swings that are tried, in standard uncertainties of the prior."""
NONE, NEGLIGIBLE = -1e9, 25.0
"""Log-evidence where there is no explanation, and by how much less than the best another need not be reckoned with."""


class Explanation(NamedTuple):
    """What one load makes of the picture: a Gaussian likelihood of the swing.

    Attributes:
        log_evidence: logarithm of the evidence under the survey's own prior of the swing, up to a constant that the
            explanations of one conductor share.
        swing: at which the likelihood is greatest, rad.
        variance: of the likelihood, rad².
    """

    log_evidence: float
    swing: float
    variance: float


def explanation(log_evidence: float, swing: float, swing_u: float, prior_u: float) -> Explanation:
    """From a posterior swing ± swing_u under a prior 0 ± prior_u (rad), its likelihood alone."""
    (one,) = explanations(np.array([[log_evidence, swing, swing_u]]), prior_u)
    return one


def explanations(posteriors: FloatArray, prior_u: float) -> list[Explanation]:
    """The same of many (N, 3): logarithm of the evidence, swing and its standard uncertainty of each."""
    log_evidence, swing, swing_u = posteriors.T
    precision = np.maximum(1 / swing_u**2 - 1 / prior_u**2, 1e-6 / prior_u**2)
    told = np.stack([log_evidence, swing / swing_u**2 / precision, 1 / precision], axis=1)
    return [Explanation(*each) for each in told.tolist()]


def uneven_probabilities(
    explanations: Sequence[tuple[Sequence[Explanation], Sequence[Explanation]]], prior_u: float
) -> list[float]:
    """Probability of an uneven load of every conductor, from their even and uneven explanations.

    Args:
        explanations: even and uneven ones of each conductor, which are equally likely beforehand; none where there
            are none.
        prior_u: standard uncertainty of the common swing before looking, rad.
    """
    common = prior_u * GRID
    even, uneven = (
        np.array([_log_likelihood(pair[which], common, prior_u) for pair in explanations]) for which in (0, 1)
    )
    total, of_uneven = np.zeros(0), np.zeros((len(explanations), 0))
    for share, each in ((ICY_READINGS, ICED_THEN), (1 - ICY_READINGS, WEIGHTED)):
        either = np.logaddexp(uneven + np.log(each), even + np.log1p(-each))
        here = np.log(share) - 0.5 * GRID**2 + either.sum(axis=0)
        total = np.concatenate([total, here])
        of_uneven = np.concatenate([of_uneven, here - either + uneven + np.log(each)], axis=1)
    greatest = total.max()
    whole = np.exp(total - greatest).sum()
    return [float(np.exp(row - greatest).sum() / whole) for row in of_uneven]


def expected_swing(others: Sequence[Sequence[Explanation]], prior_u: float) -> tuple[float, float]:
    """Swing of a conductor, and its standard uncertainty, as the explanations of the others let it be expected, rad."""
    common = prior_u * GRID
    # one that was followed along something else says nothing of the wind, and must not drag the others there
    told = [np.logaddexp(np.log1p(-ASTRAY) + _log_likelihood(o, common, prior_u), np.log(ASTRAY)) for o in others]
    weight = -0.5 * GRID**2 + sum(told, np.zeros(len(GRID)))
    weight = np.exp(weight - weight.max())
    weight /= weight.sum()
    mean = float(weight @ common)
    return mean, float(np.sqrt(weight @ ((common - mean) ** 2 + _spread(common))))


def apart(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Standard uncertainties by which two swings, each with its own, rad, differ beyond what one wind makes them."""
    spread = float(_spread(np.array(max(abs(one[0]), abs(other[0])))))
    return abs(one[0] - other[0]) / float(np.sqrt(one[1] ** 2 + other[1] ** 2 + 2 * spread))


def _spread(common: FloatArray) -> FloatArray:
    """Variance of a conductor's swing about some common ones."""
    return np.asarray(SPREAD[0] ** 2 + (SPREAD[1] * common) ** 2)


def _log_likelihood(explained: Sequence[Explanation], common: FloatArray, prior_u: float) -> FloatArray:
    """Logarithm of the mean evidence (N,) of explanations, the swings being spread about each of some common ones."""
    if not explained:
        return np.full(len(common), NONE)
    told = np.array(explained)
    evidence, swing, variance = np.ascontiguousarray(told[told[:, 0] > told[:, 0].max() - NEGLIGIBLE].T)
    # over the mean under the prior, which the evidence is; 2π is in both
    alone = variance + prior_u**2
    level = evidence + 0.5 * (swing**2 / alone + np.log(alone)) - np.log(len(explained))
    return _summed(level, swing, variance, common, _spread(common))


def _summed(
    level: FloatArray, swing: FloatArray, variance: FloatArray, common: FloatArray, spread: FloatArray
) -> FloatArray:
    """Logarithm (N,) of the sum over explanations (K,) at some common swings (N,) with a spread (N,) about each."""
    if kernels is not None:
        result = np.empty(len(common))
        kernels.sum_explanations(level, swing, variance, common, spread, result)
        return result
    both = variance[:, None] + spread
    logs = level[:, None] - 0.5 * (swing[:, None] - common) ** 2 / both
    highest = logs.max(axis=0)
    return np.asarray(highest + np.log(np.sum(np.exp(logs - highest) / np.sqrt(both), axis=0)))
