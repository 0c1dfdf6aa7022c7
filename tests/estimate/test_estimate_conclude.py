"""The last solution: offsets that lie where the rest of the wire foretells are the wire's, however weak they look."""

from dataclasses import replace

import numpy as np
import pytest
from solving import hanging

from sagnode.estimate.camera import NOTHING_KNOWN
from sagnode.estimate.conclude import conclude, foretold_by_others, judged_by_place
from sagnode.estimate.joint import solve
from sagnode.estimate.matched import Matched
from sagnode.estimate.offsets import CORRELATION_LENGTH_PX
from sagnode.estimate.register import Registered
from sagnode.match.refine import Observed
from sagnode.match.standing import spread_by
from sagnode.survey import SAG

RANGE_PX = 3.0
CLEAR_THEN_WEAK = np.where(np.arange(70) < 45, 1e-5, 0.05)
"""Chances of texture along a wire that is clear near the camera."""


def matched(seed, chance, moved=None, count=70):
    """A conductor whose offsets may be texture's by some chance each; ``moved`` ones are, and lie elsewhere."""
    rng = np.random.default_rng(seed)
    survey, theta, curve = hanging(rng, 0.01, sigma=0.05, count=count)
    aside = np.zeros(count) if moved is None else moved
    doubt = spread_by(np.broadcast_to(chance, count), np.full(count, RANGE_PX))
    noise = curve.sigma
    offsets = replace(
        curve,
        measured=curve.measured + aside[:, None] * curve.normal,
        sigma=np.hypot(noise, doubt),
        texture=spread_by(np.minimum(2 * np.broadcast_to(chance, count), 0.5), np.full(count, RANGE_PX)),
    )
    solution = solve(survey, theta, NOTHING_KNOWN, offsets, 20)
    assert solution.converged
    observed = Observed(
        track=None,
        t=curve.t,
        arc=curve.arc,
        pixel=curve.measured,
        normal=curve.normal,
        offset=np.zeros(count),
        sigma=offsets.sigma,
        noise=noise,
        half_range=np.full(count, RANGE_PX),
        texture=offsets.texture,
        scatter=np.zeros(count),
        rank=np.ones(count),
        usable=np.ones(count, dtype=bool),
        masked=np.zeros(count, dtype=bool),
    )
    return theta, Matched(survey, solution, None, None, observed, offsets, 1.0)


def test_others_foretell_what_conditional_normals_say():
    _, match = matched(1, 0.01, count=40)
    survey, solution = match.survey, match.solution
    free = survey.unknowns()
    own = solution.jacobian[:, free]
    white, correlated = solution.noise
    noise = (np.diag(white) + correlated) * solution.inflation
    total = noise + own @ np.diag(survey.prior_sigma()[free] ** 2) @ own.T
    about = solution.residual + own @ (solution.theta - survey.prior_mean())[free]
    aside, variance = foretold_by_others(solution)
    arc = solution.curve.arc
    for n in (0, 7, 20, 39):
        far = np.abs(arc - arc[n]) > CORRELATION_LENGTH_PX
        gain = np.linalg.solve(total[np.ix_(far, far)], total[far, n])
        assert aside[n] == pytest.approx(about[n] - gain @ about[far], abs=2e-4)
        expected = total[n, n] - gain @ total[far, n] - white[n] * solution.inflation
        assert variance[n] == pytest.approx(expected, rel=2e-2, abs=1e-6)


def test_offsets_where_the_rest_foretells_them_are_hardly_texture():
    _, match = matched(2, CLEAR_THEN_WEAK)
    judged, own = judged_by_place(match), match.observed.noise
    assert (judged.sigma >= own).all()
    added = [
        np.sqrt(np.maximum(sigma[45:60] ** 2 - own[45:60] ** 2, 0)) for sigma in (judged.sigma, match.offsets.sigma)
    ]
    assert np.median(added[0]) < 0.5 * np.median(added[1])
    assert (judged.texture < match.offsets.texture).all()


def test_an_offset_that_lies_elsewhere_is_texture():
    moved = np.zeros(70)
    moved[48] = 1.0
    _, match = matched(3, CLEAR_THEN_WEAK, moved)
    judged = judged_by_place(match)
    assert judged.sigma[48] > match.offsets.sigma[48]
    assert (judged.sigma[45:48] < match.offsets.sigma[45:48]).all()


def test_what_lies_together_does_not_foretell_itself():
    """The wire's far third, where a hedge runs beside it: alike, and all off by the same."""
    moved = np.where(np.arange(70) > 64, 0.8, 0.0)
    chance = np.where(np.arange(70) > 64, 0.05, 0.0)
    _, match = matched(4, chance, moved)
    judged = judged_by_place(match)
    assert np.mean(judged.sigma[65:]) > 0.5 * np.mean(match.offsets.sigma[65:])


def test_what_nothing_else_foretells_keeps_its_chance():
    _, match = matched(5, 0.05, count=4)
    near = replace(match.offsets, arc=np.linspace(0.0, 30.0, 4))
    solution = solve(match.survey, match.solution.theta, NOTHING_KNOWN, near, 20)
    vague = replace(match.survey, attachment_u=10.0, swing_u=1.0, orientation_u=0.1, position_u=5.0)
    judged = judged_by_place(replace(match, survey=vague, solution=solution, offsets=near))
    assert np.isfinite(judged.sigma).all()
    assert (judged.sigma <= 1.5 * np.hypot(near.sigma, RANGE_PX * np.sqrt(0.5 / 3))).all()


def test_the_estimate_is_surer_and_as_right_as_it_says():
    z, gain = [], []
    for seed in range(30):
        moved = np.zeros(70)
        moved[45 + np.random.default_rng(seed).choice(25, 2, replace=False)] = (1.5, -0.9)
        theta, match = matched(seed, CLEAR_THEN_WEAK, moved)
        registered = Registered(theta, NOTHING_KNOWN, None, None, None, None)
        last = conclude({"L1": match}, registered)["L1"]
        before, after = (
            np.sqrt(sum(part[SAG, SAG] for part in one.solution.information(one.survey).values()))
            for one in (match, last)
        )
        z.append((last.sag[0] - theta[SAG]) / after)
        gain.append(after / before)
    assert np.median(gain) < 0.9
    assert np.sqrt(np.mean(np.square(z))) < 1.3


def test_what_is_uneven_crowded_or_unknown_stays_as_it_is():
    _, match = matched(6, 0.05)
    registered = Registered(match.solution.theta, NOTHING_KNOWN, None, None, None, None)
    others = {
        "uneven": replace(match, survey=replace(match.survey, load_u=0.3)),
        "crowded": replace(match, crowded=True),
        "too uncertain": replace(match, solution=replace(match.solution, covariance=1e4 * match.solution.covariance)),
        "unsettled": replace(match, solution=replace(match.solution, converged=False)),
    }
    found = conclude(others, registered)
    assert all(found[name] is others[name] for name in others)


def test_what_moves_far_from_where_it_was_found_is_not_followed():
    _, match = matched(7, 0.05)
    theta = match.solution.theta.copy()
    theta[SAG] += 6 * match.sag[1]
    strayed = replace(match, solution=replace(match.solution, theta=theta))
    registered = Registered(theta, NOTHING_KNOWN, None, None, None, None)
    assert conclude({"L1": strayed}, registered)["L1"] is strayed
