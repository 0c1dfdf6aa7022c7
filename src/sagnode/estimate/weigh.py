"""The offsets of a wire under every kind of uneven load, each weighed by its evidence, and what all of them leave.

What a Gaussian holds of all loads at once is wide: a weight may hang anywhere. What is seen of a wire leaves few of
the places, and under each of those it foretells the rest well. Seen along the line, swings that are degrees apart go
with loads that are far apart, and the wire slides along its own picture from one to the other: every kind is asked at
several swings, and every block is compared with the place of the curve that it lies nearest to.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.evidence import evidence
from sagnode.estimate.joint import Solution, solve
from sagnode.estimate.load_kinds import Kind, kinds, mixed
from sagnode.estimate.offsets import CurveObservations, slid
from sagnode.estimate.steps import solved_each
from sagnode.geometry.camera import FloatArray
from sagnode.survey import CAMERA, LOAD, SAG, SWING, Survey

ASIDE = (1.0, 2.0, 3.0)
"""Swings that are asked about the one that all loads together say, in standard uncertainties of it."""
HELD = 0.3
"""How firmly a solution is held at such a swing, in the same."""
LIKELY, MOST = 12.0, 16
"""Kinds whose evidence, by one linear step, is at most so much below the best (logarithm), are solved for; so many at
most."""
BELIEVED = 0.4
"""Share of what the offsets say for one kind of load over another that is believed."""
NEGLIGIBLE = 1e-3
"""Weight up to which a kind of load need not be told."""
ROUNDS = 3
"""Solutions of one kind, each with the blocks at their places on the curve before."""
REST = slice(0, LOAD.start)
"""All unknowns but the load."""


def solve_loads(
    survey: Survey, start: FloatArray, camera: CameraKnowledge, curve: CurveObservations, iterations: int
) -> Solution:
    """Maximum a posteriori θ under all kinds of load by their weights, and the covariance over all of them about it."""
    broad = settled(survey, start, camera, curve, iterations)
    if broad is None:
        return solve(survey, start, camera, curve, iterations)
    found = []
    for kind, theta in _likely(survey, broad, camera, curve, iterations):
        own = replace(survey, load_prior=kind.prior)
        one = settled(own, theta, camera, curve, iterations)
        if one is not None:
            found.append((kind, own, one))
    if not found:
        return broad
    inflation = min(one.inflation for _, _, one in found)
    prior = np.log([kind.probability for kind, _, _ in found])
    log = prior + np.array([evidence(one, own, inflation) for _, own, one in found])
    log = np.where(np.isfinite(log), log, -np.inf)
    if not np.isfinite(log).any():
        return broad
    together = float(np.logaddexp.reduce(log))
    # what offsets share is not known so well that the odds of one place of a load over another could be relied upon
    tempered = prior + BELIEVED * (log - prior)
    weight = np.exp(tempered - np.logaddexp.reduce(tempered))
    thetas = np.array([one.theta for _, _, one in found])
    theta = weight @ thetas
    apart = thetas - theta
    covariance = np.einsum("h,hij->ij", weight, np.array([one.covariance for _, _, one in found]))
    covariance += (weight * apart.T) @ apart
    order = np.argsort(-log, kind="stable")
    best = found[order[0]][2]
    loads = tuple((float(weight[k]), found[k][1], found[k][2]) for k in order if weight[k] > NEGLIGIBLE)
    # the mean over swings that are far apart need not lie on the wire; what is likeliest under all those loads does
    parts = [(float(w), kind.prior) for w, (kind, _, _) in zip(weight, found, strict=True)]
    middle = replace(survey, load_prior=mixed(parts))
    on_wire = settled(middle, theta, camera, curve, iterations) or best
    covariance += np.outer(on_wire.theta - theta, on_wire.theta - theta)
    return replace(on_wire, covariance=covariance, inflation=inflation, log_evidence=together, loads=loads)


def settled(
    survey: Survey, start: FloatArray, camera: CameraKnowledge, curve: CurveObservations, iterations: int
) -> Solution | None:
    """A solution whose blocks lie at their places on its own curve; None where none is found."""
    theta, one = start, None
    for _ in range(ROUNDS):
        one = solve(survey, theta, camera, slid(survey, theta, curve), iterations)
        if not np.isfinite(one.covariance).all() or not np.isfinite(one.theta).all():
            return None
        moved = float(np.max(np.abs(one.theta - theta)[SWING]) / np.sqrt(max(one.covariance[SWING, SWING], 1e-18)))
        theta = one.theta
        if moved < 0.1:
            break
    return one if one is not None and one.converged else None


def stands(
    survey: Survey, broad: Solution, camera: CameraKnowledge, curve: CurveObservations, iterations: int
) -> list[Solution]:
    """Solutions held at swings about that of a solution, which is the first of them."""
    swing, swing_u = broad.theta[SWING], float(np.sqrt(broad.covariance[SWING, SWING]))
    found = [broad]
    for side in (-1, 1):
        last = broad
        for z in ASIDE:
            pinned = replace(survey, swing_mean=float(swing + side * z * swing_u), swing_u=HELD * swing_u)
            held = settled(pinned, last.theta, camera, curve, iterations)
            if held is None:
                break
            found.append(held)
            last = held
    return found


def _likely(
    survey: Survey, broad: Solution, camera: CameraKnowledge, curve: CurveObservations, iterations: int
) -> list[tuple[Kind, FloatArray]]:
    """Kinds of load that one linear step from some swing does not rule out, the likeliest first, with θ (28,) there."""
    found = [linear(survey, one) for one in stands(survey, broad, camera, curve, iterations)]
    logs = np.array([logs for logs, _, _ in found])
    where = np.argmax(logs, axis=0)
    best = logs[where, np.arange(logs.shape[1])]
    order = [int(k) for k in np.argsort(best)[::-1][:MOST] if best[k] > best.max() - LIKELY]
    return [(kinds()[k], found[where[k]][1][k]) for k in order]


@cache
def _priors() -> tuple[FloatArray, FloatArray, FloatArray]:
    """What is known of the terms of every kind of load before looking.

    Returns:
        Mean (K, 10), inverse covariance (K, 10, 10), and the logarithm of a kind's probability with half of that of the
        determinant (K,).
    """
    information = np.array([kind.prior.information for kind in kinds()])
    level = np.log([kind.probability for kind in kinds()]) + 0.5 * np.linalg.slogdet(information)[1]
    return np.array([kind.prior.mean for kind in kinds()]), information, level


def linear(survey: Survey, stand: Solution) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Every kind of uneven load by one linear step from a solution.

    Kinds differ in what they expect of the load alone: all other unknowns follow it, and are eliminated once.

    Returns:
        Logarithm of the evidence of each (K,), θ under it (K, 28), and the covariance of that with its sag (K, 28).
    """
    mean, information, level = _priors()
    before, theta = survey.prior_information()[REST, REST], stand.theta
    apart = (survey.prior_mean() - theta)[REST]
    both, pull = stand.products[:-1, :-1] / stand.inflation, stand.products[:-1, -1] / stand.inflation
    both[REST, REST] += before
    both[CAMERA, CAMERA] += stand.camera.precision
    of_camera = stand.camera.precision @ theta[CAMERA]
    pull[REST] += before @ apart
    pull[CAMERA] += stand.camera.vector - of_camera
    # the others by themselves, and how far they follow the load
    between = both[REST, LOAD]
    right = np.column_stack([between, pull[REST], np.eye(LOAD.start)[SAG]])
    eliminated, others = solved_each(both[None, REST, REST], right[None])
    follow, moved, with_sag = eliminated[0, :, : LOAD.stop - LOAD.start], *eliminated[0, :, -2:].T
    expected = mean - theta[LOAD]
    toward = np.einsum("kij,kj->ki", information, expected)
    vector = toward + pull[LOAD] - between.T @ moved
    asked = np.stack([vector, np.broadcast_to(follow[SAG], vector.shape)], axis=2)
    left, loads = solved_each(information + (both[LOAD, LOAD] - between.T @ follow), asked)
    step, by_sag = left[..., 0], left[..., 1]
    misfit = float(stand.products[-1, -1] / stand.inflation + apart @ before @ apart - pull[REST] @ moved)
    misfit += float(theta[CAMERA] @ of_camera - 2 * stand.camera.vector @ theta[CAMERA])
    of_load = np.sum(expected * toward, axis=1) - np.sum(vector * step, axis=1)
    logs = level - 0.5 * (others + loads + misfit + of_load + stand.spread)
    thetas = theta + np.concatenate([moved - step @ follow.T, step], axis=1)
    covariance = np.concatenate([with_sag + by_sag @ follow.T, -by_sag], axis=1)
    return np.where(np.isfinite(logs), logs, -np.inf), thetas, covariance
