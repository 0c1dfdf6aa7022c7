"""The offsets of a wire under every kind of uneven load, each weighed by its evidence, and what all of them leave.

What a Gaussian holds of all loads at once is wide: a weight may hang anywhere. What is seen of a wire leaves few of
the places, and under each of those it foretells the rest well. Seen along the line, swings that are degrees apart go
with loads that are far apart, and the wire slides along its own picture from one to the other: every kind is asked at
several swings, and every block is compared with the place of the curve that it lies nearest to.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.evidence import evidence
from sagnode.estimate.joint import Solution, solve
from sagnode.estimate.load_kinds import Kind, kinds, mixed
from sagnode.estimate.offsets import CurveObservations, slid
from sagnode.estimate.steps import solved
from sagnode.geometry.camera import FloatArray
from sagnode.survey import LOAD, SWING, Survey

ASIDE = (1.0, 2.0, 3.0)
"""Swings that are asked about the one that all loads together say, in standard uncertainties of it."""
HELD = 0.3
"""How firmly a solution is held at such a swing, in the same."""
LIKELY, MOST = 12.0, 16
"""Kinds whose evidence, by one linear step, is at most so much below the best (logarithm), are solved for; so many at
most."""
BELIEVED = 0.4
"""Share of what the offsets say for one kind of load over another that is believed."""
ROUNDS = 3
"""Solutions of one kind, each with the blocks at their places on the curve before."""


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
    _, best_survey, best = found[int(np.argmax(log))]
    # the mean over swings that are far apart need not lie on the wire; what is likeliest under all those loads does
    parts = [(float(w), kind.prior) for w, (kind, _, _) in zip(weight, found, strict=True)]
    middle = replace(survey, load_prior=mixed(parts))
    on_wire = settled(middle, theta, camera, curve, iterations) or best
    covariance += np.outer(on_wire.theta - theta, on_wire.theta - theta)
    return replace(
        on_wire, covariance=covariance, inflation=inflation, log_evidence=together, likeliest=(best_survey, best)
    )


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


def linear(survey: Survey, stand: Solution) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Logarithm of the evidence (K,) of every kind, its θ (K, 28) and covariance (K, 28, 28), by one linear step."""
    free = survey.unknowns()
    white, correlated = stand.noise
    own = stand.jacobian[:, free]
    weighed = solved(np.diag(white) + correlated, np.column_stack([own, stand.residual]))
    gain = weighed.T @ own / stand.inflation
    left_over = float(stand.residual @ weighed[:, -1]) / stand.inflation
    _, spread = np.linalg.slogdet(np.diag(white) + correlated)
    known, mean, theta = survey.prior_information()[np.ix_(free, free)], survey.prior_mean()[free], stand.theta[free]
    size = len(stand.camera.vector)
    camera, pull = np.zeros_like(known), np.zeros(len(free))
    camera[:size, :size], pull[:size] = stand.camera.precision, stand.camera.vector
    of_camera = float(theta @ camera @ theta - 2 * pull @ theta)
    load = np.searchsorted(free, np.arange(LOAD.start, LOAD.stop))
    count = len(kinds())
    information, expected = np.tile(known, (count, 1, 1)), np.tile(mean, (count, 1))
    information[:, load[:, None], load] = [kind.prior.information for kind in kinds()]
    expected[:, load] = [kind.prior.mean for kind in kinds()]
    total = information + camera + gain[:-1]
    apart = expected - theta
    toward = np.einsum("kij,kj->ki", information, apart)
    vector = toward + pull - camera @ theta + gain[-1]
    scale = 1 / np.sqrt(np.diagonal(total, axis1=1, axis2=2))
    scaled = total * scale[:, :, None] * scale[:, None, :]
    inverse = solved(scaled, np.broadcast_to(np.eye(len(free)), scaled.shape)) * scale[:, :, None] * scale[:, None, :]
    step = np.einsum("kij,kj->ki", inverse, vector)
    after = np.linalg.slogdet(scaled)[1] - 2 * np.log(scale).sum(axis=1)
    before = np.linalg.slogdet(information[:, load[:, None], load])[1]
    misfit = left_over + of_camera + np.sum(apart * toward, axis=1) - np.sum(vector * step, axis=1)
    logs = np.log([kind.probability for kind in kinds()]) + 0.5 * (before - after - misfit - spread)
    logs = np.where(np.isfinite(logs), logs, -np.inf)
    thetas = np.tile(stand.theta, (count, 1))
    thetas[:, free] += step
    covariance = np.zeros((count, len(stand.theta), len(stand.theta)))
    covariance[:, free[:, None], free] = inverse
    return logs, thetas, covariance
