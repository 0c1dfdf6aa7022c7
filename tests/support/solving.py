"""Lenses of every kind, and questions for the joint estimate."""

import numpy as np

from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.offsets import CurveObservations
from sagnode.geometry.camera import Intrinsics, Pose, project, rotation_from_angles
from sagnode.survey import SAG, SWING, Survey

LENSES = {
    "perfect": Intrinsics(1456, 1088, 1200.0, 1210.0, 730.0, 540.0),
    "pinhole": Intrinsics(1456, 1088, 1200.0, 1210.0, 730.0, 540.0, (-0.12, 0.05, 1e-4, -2e-4, 0.01)),
    "rational": Intrinsics(1456, 1088, 900.0, 905.0, 730.0, 540.0, (0.3, 0.05, 1e-4, -2e-4, 0.01, 0.4, 0.1, 0.02)),
    "fisheye": Intrinsics(1456, 1088, 500.0, 502.0, 730.0, 540.0, (0.02, -0.01, 0.003, -0.001), "fisheye"),
}


def question(seed, lens="pinhole", count=None):
    """A survey, a start, what landmarks say, and offsets about a curve that is nearly right, some of them wild."""
    rng = np.random.default_rng(seed)
    near, far = np.array([rng.uniform(-5, 5), 12.0, 30.0]), np.array([0.0, rng.uniform(60, 400), rng.uniform(20, 40)])
    place = np.array([rng.uniform(-8, 8), -5.0, rng.uniform(5, 32)])
    pose = Pose(rotation_from_angles(rng.uniform(-8, 8), rng.uniform(-3, 3), rng.normal(0, 3)), place)
    length = far[1] - near[1]
    survey = Survey(
        LENSES[lens],
        pose,
        near,
        far,
        orientation_u=0.003,
        position_u=0.02,
        focal_u_rel=0.002,
        principal_point_u=2.0,
        distortion_u=0.002,
        attachment_u=0.05,
        sag_range=(0.01 * length, 0.06 * length),
        swing_u=0.2,
        load_u=0.3 if seed % 2 else 0.0,
    )
    theta = survey.prior_mean()
    theta[:18] += rng.normal(0, 0.3, 18) * np.minimum(survey.prior_sigma()[:18], 0.05 * length)
    count = rng.integers(5, 80) if count is None else count
    t = np.sort(rng.uniform(0.05, 0.95, count))
    intrinsics, pose = survey.camera(theta)
    pixels, _ = project(intrinsics, pose, survey.shape(theta).points(t))
    angle = rng.uniform(0, 2 * np.pi, count)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    offset = np.where(rng.random(count) < 0.9, rng.normal(0, 0.4, count), rng.normal(0, 9, count))
    arc = np.cumsum(rng.exponential(15.0, count) * (rng.random(count) < 0.9))
    curve = CurveObservations(t, arc, normal, pixels + offset[:, None] * normal, rng.uniform(0.02, 1, count))
    rows = rng.normal(0, 1, (6, 10)) / survey.prior_sigma()[:10]
    start = theta.copy()
    start[SAG] *= rng.uniform(0.9, 1.1)
    start[SWING] += rng.normal(0, 0.1)
    return survey, start, CameraKnowledge(rows.T @ rows, 0.1 * rows.T @ rng.normal(0, 1, 6)), curve
