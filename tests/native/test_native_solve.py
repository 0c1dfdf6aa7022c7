"""The compiled joint estimate against the one in NumPy, which says what it means."""

from dataclasses import replace

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st
from solving import LENSES, question

from sagnode.estimate.camera import LandmarkObservations, solve_camera
from sagnode.estimate.joint import curve_uncertainty, solve
from sagnode.estimate.offsets import CurveObservations, curve_terms, words
from sagnode.geometry.camera import project
from sagnode.native import kernels
from sagnode.survey import SAG

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_residuals_and_derivatives_are_those_of_numpy(lens, seed):
    survey, theta, _, curve = question(seed, lens)
    residual, jacobian = curve_terms(survey, theta, curve)
    expected, expected_jacobian = in_numpy(lambda: curve_terms(survey, theta, curve))
    np.testing.assert_allclose(residual, expected, rtol=1e-9, atol=1e-8)
    # differences over 1e-6 keep ten digits, fewer where the swing hardly moves the curve across
    size = np.abs(expected_jacobian).max(axis=0) + 1e-12
    np.testing.assert_allclose(jacobian / size, expected_jacobian / size, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_the_estimate_is_that_of_numpy(lens, seed, iterations):
    asked = question(seed, lens)
    found, expected = solve(*asked, iterations), in_numpy(lambda: solve(*asked, iterations))
    free = asked[0].unknowns()
    sigma = np.sqrt(np.diag(expected.covariance)[free])
    assert found.converged == expected.converged
    np.testing.assert_allclose(found.theta[free] / sigma, expected.theta[free] / sigma, rtol=1e-9, atol=1e-6)
    size = np.outer(sigma, sigma)
    np.testing.assert_allclose(
        found.covariance[np.ix_(free, free)] / size, expected.covariance[np.ix_(free, free)] / size, atol=1e-6
    )
    assert not np.delete(found.covariance, free, axis=0).any()
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    for name in ("residual", "weight", "white", "inflation", "misfit"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-6)
    for mine, theirs in zip(found.noise, expected.noise, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.integers(1, 10))
def test_the_camera_is_that_of_numpy(lens, seed, count, iterations):
    survey, theta, _, _ = question(seed, lens)
    rng = np.random.default_rng(seed)
    intrinsics, pose = survey.camera(theta)
    positions = pose.position + 20 * rng.normal([0, 0, 4], 1, (count, 3)) @ pose.rotation
    pixels = project(intrinsics, pose, positions)[0] + rng.normal(0, 1, (count, 2)) * rng.choice([0.3, 30], (count, 1))
    seen = LandmarkObservations(positions, rng.uniform(0, 0.1, count), pixels, rng.uniform(0.1, 1, count))
    found, expected = solve_camera(survey, seen, iterations), in_numpy(lambda: solve_camera(survey, seen, iterations))
    sigma = survey.prior_sigma()
    np.testing.assert_allclose(found.theta / sigma, expected.theta / sigma, rtol=1e-9, atol=1e-6)
    size = 1 / sigma[:10]
    scaled = [each.knowledge.precision / np.outer(size, size) for each in (found, expected)]
    np.testing.assert_allclose(scaled[0], scaled[1], rtol=1e-6, atol=1e-6 * np.abs(scaled[1]).max(initial=0.0))
    scaled = [each.knowledge.vector / size for each in (found, expected)]
    np.testing.assert_allclose(scaled[0], scaled[1], rtol=1e-6, atol=1e-6 * np.abs(scaled[1]).max(initial=0.0))
    for name in ("residual", "weight", "z"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("place", "other", "words"),
    [(3, np.zeros(3), "theta"), (6, np.zeros(3), "positions"), (9, np.zeros(3), "settings"), (10, 0, "iterations")],
)
def test_landmarks_that_do_not_fit_are_refused(place, other, words):
    survey, theta, _, _ = question(1)
    asked = [*survey.packed, theta, np.ones(10), np.ones((2, 3)), np.ones(2), np.zeros((2, 2)), np.ones(2)]
    asked += [np.ones(2), 3, np.zeros((10, 10)), np.zeros(10), np.zeros((2, 2)), np.zeros(2)]
    kernels.solve_camera(*asked)
    asked[place] = other
    with pytest.raises(ValueError, match=words):
        kernels.solve_camera(*asked)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31).map(lambda k: 2 * k), st.floats(0.003, 0.3), st.floats(0.0, 2.0))
def test_whatever_neighbours_share_the_estimate_is_that_of_numpy(seed, px, share):
    survey, start, camera, usual = question(seed)
    curve = replace(usual, shared_px=px, shared_share=share)
    found, expected = solve(survey, start, camera, curve), in_numpy(lambda: solve(survey, start, camera, curve))
    sigma = survey.prior_sigma()
    np.testing.assert_allclose(found.theta / sigma, expected.theta / sigma, rtol=1e-8, atol=1e-6)
    size = np.outer(sigma, sigma)
    np.testing.assert_allclose(found.covariance / size, expected.covariance / size, atol=1e-6)


def test_what_neighbours_share_is_asked_for():
    survey, start, camera, curve = question(6, count=40)
    curve = replace(curve, sigma=0.01 * curve.sigma)
    u = [solve(survey, start, camera, replace(curve, shared_px=px)).covariance[SAG, SAG] for px in (0.003, 0.03, 0.3)]
    assert u[0] < 0.9 * u[1] < 0.8 * u[2]


def test_offsets_out_of_order_are_solved_all_the_same():
    survey, start, camera, curve = question(1, count=30)
    order = np.random.default_rng(1).permutation(30)
    parts = {name: getattr(curve, name)[order] for name in ("t", "arc", "normal", "measured", "sigma")}
    found, expected = (solve(survey, start, camera, each) for each in (CurveObservations(**parts), curve))
    np.testing.assert_allclose(found.theta, expected.theta, atol=1e-7)


def test_the_uncertainty_of_the_curve_is_that_of_numpy():
    survey, start, camera, curve = question(3, count=40)
    solution = solve(survey, start, camera, curve)
    asked = (survey, solution.theta, solution.covariance, curve)
    expected = in_numpy(lambda: curve_uncertainty(*asked))
    np.testing.assert_allclose(curve_uncertainty(*asked), expected, rtol=1e-7)


@pytest.mark.parametrize(
    ("place", "other", "error", "message"),
    [
        (0, np.zeros(3), ValueError, "lens"),
        (5, np.zeros(27), ValueError, "theta"),
        (7, np.zeros((3, 2)), ValueError, "normal"),
        (9, 20, ValueError, "free"),
        (10, np.arange(12.0)[::-1].copy(), ValueError, "rise"),
        (11, np.zeros(5), ValueError, "length"),
        (12, np.zeros((12, 3)), ValueError, "shading"),
        (12, np.zeros((11, 2)), ValueError, "shading"),
        (13, np.eye(27), ValueError, "known"),
        (15, np.zeros(3), ValueError, "longest"),
        (16, np.zeros(3), ValueError, "settings"),
        (17, 0, ValueError, "iterations"),
        (18, np.zeros((28, 28), dtype=np.float32), TypeError, "covariance"),
        (22, np.zeros((12, 18)), ValueError, "jacobian"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(place, other, error, message):
    survey, start, _, curve = question(4, count=12)
    asked = [*words(survey, start, curve), 18, curve.arc, curve.sigma, np.zeros((12, 2)), np.eye(28), np.zeros(28)]
    asked += [np.ones(18), np.ones(11), 5, np.zeros((28, 28)), *np.zeros((3, 12)), np.zeros((12, 28))]
    kernels.solve(*asked)
    asked[place] = other
    with pytest.raises(error, match=message):
        kernels.solve(*asked)
