"""The joint estimate where its questions have no answer: it says so, and hands on nothing that is no number."""

from dataclasses import replace

import numpy as np
import pytest
from both_ways import in_numpy
from solving import question

from sagnode.estimate.joint import solve
from sagnode.survey import SIZE

WAYS = {"as installed": lambda call: call(), "in NumPy": in_numpy}


def refused(survey, start, found):
    """No step was taken, the estimate says so, and knows what was known before."""
    assert not found.converged
    assert found.misfit == np.inf
    np.testing.assert_array_equal(found.theta, start)
    free = survey.unknowns()
    known = np.diag(1 / survey.prior_sigma() ** 2)
    known[:10, :10] += found.camera.precision
    prior = np.linalg.inv(known[np.ix_(free, free)])
    sigma = np.sqrt(np.diag(prior))
    np.testing.assert_allclose(
        found.covariance[np.ix_(free, free)] / np.outer(sigma, sigma), prior / np.outer(sigma, sigma), atol=1e-6
    )


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("part", ["t", "arc", "normal", "measured", "sigma"])
def test_what_is_no_number_ends_no_estimate(part, value, way):
    survey, start, camera, curve = question(2, count=12)
    odd = np.array(getattr(curve, part))
    odd[-1] = value
    with np.errstate(all="ignore"):
        found = WAYS[way](lambda: solve(survey, start, camera, replace(curve, **{part: odd})))
    assert np.isfinite(found.theta).all()
    assert np.isfinite(found.covariance).all()
    assert found.theta.shape == (SIZE,)
    # an offset as far away as can be, along the curve, is one that shares nothing with the others
    if part != "arc" and not (part == "measured" and np.isfinite(value)):
        refused(survey, start, found)


@pytest.mark.parametrize("way", WAYS)
def test_offsets_that_contradict_each_other_without_any_uncertainty_are_refused(way):
    survey, start, camera, curve = question(2, count=12)
    same = replace(curve, arc=np.zeros(12), sigma=np.zeros(12))
    with np.errstate(all="ignore"):
        refused(survey, start, WAYS[way](lambda: solve(survey, start, camera, same)))


@pytest.mark.parametrize("way", WAYS)
def test_a_curve_behind_the_camera_is_refused(way):
    survey, start, camera, curve = question(2, count=12)
    start[3:6] += 1000 * survey.pose.rotation[2]
    with np.errstate(all="ignore"):
        refused(survey, start, WAYS[way](lambda: solve(survey, start, camera, curve)))


@pytest.mark.parametrize("way", WAYS)
def test_a_step_that_leads_behind_the_camera_is_not_taken(way):
    """The camera may be anywhere, and stands half a metre before the conductor's nearest offset."""
    survey, start, camera, curve = question(2, "perfect", count=12)
    survey = replace(survey, position_u=1e3)
    start[9] = 0.0
    _, pose = survey.camera(start)
    depth = (survey.shape(start).points(curve.t) - pose.position) @ pose.rotation[2]
    start[3:6] += (depth.min() - 0.5) * pose.rotation[2]
    with np.errstate(all="ignore"):
        found = WAYS[way](lambda: solve(survey, start, camera, curve))
    refused(survey, start, found)
    # where it stays, every offset is seen
    assert np.isfinite(found.residual).all()
