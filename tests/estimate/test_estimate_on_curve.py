"""An estimate belongs to the wire, not to the curve about which the wire was measured."""

import numpy as np
import pytest

from sagnode.estimate.camera import NOTHING_KNOWN
from sagnode.estimate.joint import solve, solve_on_curve
from sagnode.estimate.offsets import CurveObservations
from sagnode.geometry.camera import Intrinsics, Pose, project, rotation_from_angles
from sagnode.survey import SAG, SWING, Survey

LENS = Intrinsics(1456, 1088, 2050.0, 2050.0, 728.0, 544.0)
SEEN = np.linspace(0.08, 0.24, 26)
"""The near quarter of a span, seen along the line: it leaves one combination of sag and swing open."""
ABOUT = ((-0.8, 0.05), (-0.4, -0.03), (0.5, 0.0))
"""Sag, m, and swing, rad, of the curves that the wire is measured about, beside its own."""


def survey_of_a_span() -> Survey:
    pose = Pose(rotation_from_angles(0.0, -2.0, 0.0), np.array([0.0, 0.0, 18.0]))
    return Survey(
        LENS,
        pose,
        np.array([4.0, 1.0, 26.0]),
        np.array([4.0, 270.0, 26.0]),
        orientation_u=1e-4,
        position_u=0.02,
        focal_u_rel=1e-3,
        principal_point_u=0.5,
        distortion_u=1e-3,
        attachment_u=0.03,
        sag_range=(5.0, 12.0),
        swing_u=0.08,
    )


def pixels(survey: Survey, theta: np.ndarray, t: np.ndarray) -> np.ndarray:
    return project(*survey.camera(theta), survey.shape(theta).points(t))[0]


def measured_about(survey: Survey, theta: np.ndarray, true: np.ndarray, noise: np.ndarray) -> CurveObservations:
    """Where the true wire crosses the normals of the curve at ``theta``, with noise along them."""
    here = pixels(survey, theta, SEEN)
    along = pixels(survey, theta, SEEN + 1e-4) - here
    along /= np.hypot(*along.T)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    wire = pixels(survey, true, np.linspace(0.065, 0.6, 40001))
    aside = (wire - here[:, None]) @ normal[:, :, None]
    ahead = np.abs((wire - here[:, None]) @ along[:, :, None])
    crossing = np.argmin(ahead + 1e-3 * np.abs(aside), axis=1)[:, 0]
    offset = aside[np.arange(len(SEEN)), crossing, 0] + noise
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(here, axis=0).T))])
    own = (SEEN, arc, normal, here + offset[:, None] * normal, np.linspace(0.02, 0.05, len(SEEN)))
    return CurveObservations(*own, shared_px=0.01, shared_share=0.0)


def answers(ask, seed: int) -> list[tuple[float, float]]:
    """Error of sag and its uncertainty, m, by what ``ask`` makes of one wire that is measured about several curves."""
    rng = np.random.default_rng(seed)
    survey = survey_of_a_span()
    true = survey.prior_mean()
    true[:16] += rng.normal(0, 1, 16) * survey.prior_sigma()[:16]
    true[SAG], true[SWING] = 8.0, rng.normal(0, 0.08)
    noise = np.linspace(0.02, 0.05, len(SEEN)) * rng.normal(0, 1, len(SEEN))
    found = []
    for sag, swing in ABOUT:
        start = survey.prior_mean()
        start[SAG], start[SWING] = true[SAG] + sag, true[SWING] + swing
        one = ask(survey, start, NOTHING_KNOWN, measured_about(survey, start, true, noise), 24)
        assert one.converged
        found.append((one.theta[SAG] - true[SAG], np.sqrt(one.covariance[SAG, SAG])))
    return found


@pytest.mark.parametrize("seed", range(6))
def test_the_answer_does_not_depend_on_the_curve_that_it_was_measured_about(seed):
    errors, uncertainties = np.transpose(answers(solve_on_curve, seed))
    assert np.ptp(errors) < 0.3 * uncertainties.min()
    assert np.abs(errors / uncertainties).max() < 3


def test_offsets_that_keep_their_places_say_something_else_about_every_curve():
    apart = [np.ptp(errors) / u.min() for errors, u in (np.transpose(answers(solve, seed)) for seed in range(6))]
    assert np.median(apart) > 0.8
