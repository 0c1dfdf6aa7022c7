"""A view from the side hardly sees swing, and sag follows it: along a curve, at a rate that changes on the way."""

from dataclasses import replace

import numpy as np
import pytest
from both_ways import in_numpy

from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.joint import solve
from sagnode.estimate.offsets import CurveObservations, curve_terms
from sagnode.geometry.camera import Intrinsics, Pose, project, rotation_from_angles
from sagnode.survey import SAG, SWING, Survey

WAYS = {"as installed": lambda call: call(), "in NumPy": in_numpy}
TRUE_SAG, TRUE_SWING = 7.1, np.radians(25.0)


def from_the_side() -> tuple[Survey, np.ndarray, CameraKnowledge, CurveObservations]:
    """A span of 270 m from 80 m to its side and 2.5 m up; the search has begun at no swing."""
    pose = Pose(rotation_from_angles(-90.0, 5.0, 0.0), np.array([80.0, 135.0, 2.5]))
    survey = Survey(
        Intrinsics(1456, 1088, 800.0, 800.0, 727.5, 543.5),
        pose,
        np.array([0.0, 0.0, 19.5]),
        np.array([0.0, 270.0, 19.5]),
        orientation_u=1e-3,
        position_u=0.05,
        focal_u_rel=1e-3,
        principal_point_u=1.0,
        distortion_u=0.0,
        attachment_u=0.05,
        sag_range=(4.0, 12.0),
        swing_u=np.radians(10.0),
    )
    theta = survey.prior_mean()
    theta[SAG], theta[SWING] = TRUE_SAG, TRUE_SWING
    t = np.linspace(0.25, 0.75, 60)
    pixels, _ = project(*survey.camera(theta), survey.shape(theta).points(t))
    along = np.gradient(pixels, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    curve = CurveObservations(t, arc, normal, pixels, np.full(60, 0.1))
    start = theta.copy()
    start[SAG], start[SWING] = 6.3, 0.0
    return survey, start, CameraKnowledge(np.zeros((10, 10)), np.zeros(10)), curve


@pytest.mark.parametrize("way", WAYS)
def test_the_covariance_is_that_of_where_the_estimate_ended(way: str) -> None:
    """Many short steps lead far: derivatives of where they began know sag too well, and pull it aside."""
    survey, start, camera, curve = from_the_side()
    found = WAYS[way](lambda: solve(survey, start, camera, curve, 30))
    assert found.converged
    there = curve_terms(survey, found.theta, curve)[1]
    for unknown in (SAG, SWING):
        np.testing.assert_allclose(found.jacobian[:, unknown], there[:, unknown], rtol=0.02, atol=0.02)


def test_sag_follows_swing_as_what_is_seen_across_the_line_of_sight_stays() -> None:
    """The law by which uncertainties are propagated along the open swing, against estimates with the swing held."""
    survey, start, camera, curve = from_the_side()
    found = solve(survey, start, camera, curve, 30)
    sag, swing = found.theta[SAG], found.theta[SWING]
    aside = np.arctan2(found.covariance[SAG, SWING], found.covariance[SWING, SWING] * sag)
    for turned in np.radians([-12.0, -6.0, 6.0, 12.0]):
        held = replace(survey, swing_mean=swing + turned, swing_u=1e-5)
        begun = found.theta.copy()
        begun[SWING] = swing + turned
        there = solve(held, begun, camera, curve, 30)
        assert there.theta[SAG] == pytest.approx(sag * np.cos(aside) / np.cos(aside + turned), rel=0.003)
