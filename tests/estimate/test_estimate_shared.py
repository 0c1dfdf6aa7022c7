"""What neighbouring offsets share is found from their residuals, and is what is usual where those say nothing."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from both_ways import in_numpy
from solving import hanging

from sagnode.estimate.camera import NOTHING_KNOWN
from sagnode.estimate.joint import solve
from sagnode.estimate.offsets import CORRELATED_PX, CORRELATED_SHARE, correlated_error
from sagnode.estimate.shared import GRID, LEVELS_PX, SHARES, evidence_of_sharing, shared_error
from sagnode.survey import SAG

WAYS = {"as installed": lambda call: call(), "in NumPy": in_numpy}


def frame(seed, *asked, conductors=3, **words):
    rng = np.random.default_rng(seed)
    drawn = [hanging(rng, *asked, **words) for _ in range(conductors)]
    return [(survey, solve(survey, theta, NOTHING_KNOWN, curve)) for survey, theta, curve in drawn]


@pytest.mark.parametrize("shared_px", [0.03, 0.06])
def test_what_neighbours_share_is_found(shared_px):
    found = [shared_error(frame(seed, shared_px))[0] for seed in range(8)]
    assert np.median(found) == pytest.approx(shared_px, rel=0.3)
    assert all(0.5 < one / shared_px < 2 for one in found)


def test_less_than_lenses_may_leave_unseen_is_not_believed():
    found = shared_error(frame(1, 0.001))[0]
    assert LEVELS_PX[0] <= found < 1.3 * LEVELS_PX[0]


def test_what_grows_with_an_offsets_own_uncertainty_is_found_beside_it():
    mixed = np.where(np.arange(70) % 14 < 7, 0.02, 0.2)
    little, much = (
        np.median([shared_error(frame(seed, 0.01, share, mixed))[1] for seed in range(6)]) for share in (0.2, 1.0)
    )
    assert little < 0.4
    assert much > 0.55


def test_where_nothing_is_seen_it_is_what_is_usual():
    px, share = shared_error([])
    assert 0.7 < px / CORRELATED_PX < 1.6
    assert 0.7 < share / CORRELATED_SHARE < 1.3
    # offsets that are by far less certain than what they could share say nothing of it
    hardly = shared_error(frame(2, 0.03, sigma=5.0, conductors=1, count=6))[0]
    assert hardly == pytest.approx(px, rel=0.2)


def test_an_estimate_that_did_not_settle_has_no_say():
    survey, solution = frame(3, 0.1)[0]
    assert shared_error([(survey, replace(solution, converged=False))]) == shared_error([])


def lit(solution, seed=3):
    """The same solution, light from one side having moved its offsets."""
    shading = np.random.default_rng(seed).uniform(0, 0.1, (len(solution.white), 1)) * solution.curve.normal
    return replace(solution, curve=replace(solution.curve, shading=shading))


@pytest.mark.parametrize("changed", [lambda solution: solution, lit], ids=["even light", "light from one side"])
def test_the_evidence_is_that_of_the_offsets_covariance(changed):
    """Against the plain formula, in which covariances are matrices and the prior is one more observation."""
    survey, solution = frame(4, 0.03, conductors=1, count=30)[0]
    solution = changed(solution)
    free, curve = survey.unknowns(), solution.curve
    own = solution.jacobian[:, free]
    prior = np.diag(survey.prior_sigma()[free] ** 2)
    about = solution.residual + own @ (solution.theta - survey.prior_mean())[free]
    expected = []
    for px, share in GRID:
        noise = correlated_error(replace(curve, shared_px=px, shared_share=share)) + np.diag(solution.white)
        total = noise + own @ prior @ own.T
        expected.append(-0.5 * (np.linalg.slogdet(total)[1] + about @ np.linalg.solve(total, about)))
    found = evidence_of_sharing(survey, solution)
    np.testing.assert_allclose(found - found[0], np.array(expected) - expected[0], atol=1e-4)
    assert len(found) == len(LEVELS_PX) * len(SHARES)


def weighing(solution):
    return solution.precision, solution.spread


@pytest.mark.parametrize("way", WAYS)
def test_a_solution_knows_the_inverse_of_its_offsets_covariance(way):
    """Whether the offsets share errors with their neighbours alone or, as under an uneven load, all along the wire."""
    _, solution = frame(5, 0.03, conductors=1, count=40)[0]
    solution = lit(solution)
    together = np.diag(solution.white) + correlated_error(solution.curve)
    expected, spread = np.linalg.inv(together), np.linalg.slogdet(together)[1]
    for one in (solution, replace(solution, shared=correlated_error(solution.curve))):
        inverse, own_spread = WAYS[way](partial(weighing, replace(one)))
        np.testing.assert_allclose(inverse, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        assert own_spread == pytest.approx(spread, rel=1e-12)


def test_what_is_found_makes_the_uncertainty_what_the_errors_are():
    """Sag of many conductors under either shared error, each stated as uncertain as its own frame shows."""
    for shared_px in (0.02, 0.06):
        z, u = [], []
        for seed in range(40):
            rng = np.random.default_rng(100 + seed)
            drawn = [hanging(rng, shared_px) for _ in range(2)]
            solved = [solve(survey, theta, NOTHING_KNOWN, curve) for survey, theta, curve in drawn]
            px, share = shared_error([(survey, one) for (survey, _, _), one in zip(drawn, solved, strict=True)])
            for survey, theta, curve in drawn:
                one = solve(survey, theta, NOTHING_KNOWN, replace(curve, shared_px=px, shared_share=share))
                # what the prior holds was drawn exactly at its mean, and so is no part of the error
                pieces = one.information(survey)
                own = sum(pieces[name][SAG, SAG] for name in ("pixel noise", "correlated curve error"))
                z.append((one.theta[SAG] - theta[SAG]) / np.sqrt(own))
                u.append(np.sqrt(own))
        assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3, shared_px


def test_what_a_lens_leaves_so_smoothly_that_no_residual_shows_it_is_stated():
    z, seen = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        survey, theta, curve = hanging(rng, 0.001)
        alike = np.exp(-0.5 * ((curve.arc[:, None] - curve.arc) / 150.0) ** 2)
        left = 0.04 * np.linalg.cholesky(alike + 1e-8 * np.eye(len(alike))) @ rng.standard_normal(len(alike))
        curve = replace(curve, measured=curve.measured + left[:, None] * curve.normal)
        px, share = shared_error([(survey, solve(survey, theta, NOTHING_KNOWN, curve))])
        one = solve(survey, theta, NOTHING_KNOWN, replace(curve, shared_px=px, shared_share=share))
        z.append((one.theta[SAG] - theta[SAG]) / np.sqrt(one.covariance[SAG, SAG]))
        seen.append(px)
    # neighbours show less than there is
    assert np.median(seen) < 0.025
    assert np.sqrt(np.mean(np.square(z))) < 1.3
