"""What uneven loads there are: a weight at one place, ice on one stretch, and as Gaussians what their terms can be.

Of a load that is a share r on a stretch of a length l at a place x all terms follow r, and so do what it does not do:
nothing heavy hangs at the attachments themselves, and no load hangs upwards. Ten terms that are independent of each
other can be any load, and foretell next to nothing of a stretch that is not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from sagnode.estimate.offsets import FINEST_LOAD
from sagnode.geometry.camera import FloatArray
from sagnode.geometry.single_load import single_load_terms
from sagnode.survey import LOAD, LoadPrior

LOAD_U = 0.45
"""Standard uncertainty of each term of a load of which nothing is known."""
TERMS = LOAD.stop - LOAD.start
"""Terms that are solved for."""
POINT = 0.01
"""Length of the stretch that a weight hangs on, as a share of the span."""
WEIGHT, ICE = (0.08, 0.06), (0.25, 0.18)
"""Mean and standard deviation of the share that a weight, or ice, has of all that hangs from a conductor."""
MARGIN = 0.04
"""No weight is nearer to an attachment, as a share of the span."""
ICE_LENGTHS = (0.1, 0.7)
"""Least and greatest length of ice on a part of the span."""
PLACES, LENGTHS, ICE_STEP = 16, 4, 0.1
"""Places of a weight and lengths of ice that are told apart, and by how much such a stretch is moved."""
LEFT_OVER = 0.03
"""Standard deviation of each term that one even load on one stretch leaves over."""
OF_ANY = 0.05
"""Share of uneven loads that are no single one."""


@dataclass(frozen=True)
class Kind:
    """A load with its probability among uneven ones."""

    probability: float
    prior: LoadPrior


@cache
def any_single() -> LoadPrior:
    """One load, wherever and whatever it may be."""
    return _matched([(0.5, *_weights(MARGIN, 1 - MARGIN)), (0.5, *_ices(ICE_LENGTHS, (0.0, 1.0)))])


@cache
def kinds() -> tuple[Kind, ...]:
    """Single loads by their place and length, and any load; their probabilities add up to 1."""
    single = 1 - OF_ANY
    edges = np.linspace(MARGIN, 1 - MARGIN, PLACES + 1)
    found = [Kind(0.5 * single / PLACES, _matched([(1.0, *_weights(low, high))])) for low, high in pairwise(edges)]
    bounds = np.linspace(*ICE_LENGTHS, LENGTHS + 1)
    for shortest, longest in pairwise(bounds):
        count = int(np.ceil((1 - shortest) / ICE_STEP))
        steps = np.linspace(0.0, 1.0, count + 1)
        found += [
            Kind(0.5 * single / LENGTHS / count, _matched([(1.0, *_ices((shortest, longest), (low, high)))]))
            for low, high in pairwise(steps)
        ]
    free = LoadPrior(np.zeros(TERMS), LOAD_U**2 * np.eye(TERMS), LOAD_U**2 * np.eye(FINEST_LOAD - TERMS))
    return (*found, Kind(OF_ANY, free))


def mixed(parts: Sequence[tuple[float, LoadPrior]]) -> LoadPrior:
    """Mean and covariance over some kinds of loads by their weights, which add up to 1."""
    weight = np.array([w for w, _ in parts])
    means = np.array([prior.mean for _, prior in parts])
    mean = weight @ means
    within = np.einsum("h,hij->ij", weight, np.array([prior.covariance for _, prior in parts]))
    finer = np.einsum("h,hij->ij", weight, np.array([prior.finer for _, prior in parts]))
    return LoadPrior(mean, within + (weight * (means - mean).T) @ (means - mean), finer)


def _weights(low: float, high: float) -> tuple[FloatArray, FloatArray]:
    places = low + (high - low) * (np.arange(200) + 0.5) / 200
    return _moments(single_load_terms(1.0, places, POINT, FINEST_LOAD), *WEIGHT)


def _ices(lengths: tuple[float, float], starts: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Of ice that begins between two shares of the way that it can be moved along the span."""
    u = (np.arange(40) + 0.5) / 40
    length = lengths[0] + (lengths[1] - lengths[0]) * u[:, None]
    place = 0.5 * length + (1 - length) * (starts[0] + (starts[1] - starts[0]) * u)
    return _moments(single_load_terms(1.0, place, length, FINEST_LOAD).reshape(-1, FINEST_LOAD), *ICE)


def _moments(terms: FloatArray, share: float, share_u: float) -> tuple[FloatArray, FloatArray]:
    """Mean (F,) and second moments (F, F) over terms (N, F) of a whole share, F being FINEST_LOAD."""
    return share * terms.mean(axis=0), (share**2 + share_u**2) * terms.T @ terms / len(terms)


def _matched(parts: list[tuple[float, FloatArray, FloatArray]]) -> LoadPrior:
    mean = sum((p * m for p, m, _ in parts), np.zeros(FINEST_LOAD))
    second = sum((p * s for p, _, s in parts), np.zeros((FINEST_LOAD, FINEST_LOAD)))
    first = mean[:TERMS]
    covariance = second[:TERMS, :TERMS] - np.outer(first, first) + LEFT_OVER**2 * np.eye(TERMS)
    return LoadPrior(first, covariance, second[TERMS:, TERMS:] + LEFT_OVER**2 * np.eye(FINEST_LOAD - TERMS))
