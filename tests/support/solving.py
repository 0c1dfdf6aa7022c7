"""Lenses of every kind, and questions for the joint estimate."""

from dataclasses import replace

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
    if seed % 4 >= 2:
        curve = replace(curve, shading=rng.uniform(0, 0.4, (count, 1)) * normal)
    rows = rng.normal(0, 1, (6, 10)) / survey.prior_sigma()[:10]
    start = theta.copy()
    start[SAG] *= rng.uniform(0.9, 1.1)
    start[SWING] += rng.normal(0, 0.1)
    return survey, start, CameraKnowledge(rows.T @ rows, 0.1 * rows.T @ rng.normal(0, 1, 6)), curve


def hanging(rng, shared_px, share=0.0, sigma=0.006, count=70):
    """An even conductor seen along the line: survey, truth, and offsets about it whose neighbours share an error.

    ``sigma`` is of the offsets by themselves; to it ``shared_px``, and ``share`` of it, are added that fall off along
    the curve by e in 60 px.
    """
    near, far = np.array([0.0, 0.0, 20.0]), np.array([0.0, 250.0, 22.0])
    pose = Pose(rotation_from_angles(0.0, -4.0, 0.0), np.array([2.0, -3.0, 16.0]))
    survey = Survey(
        LENSES["perfect"],
        pose,
        near,
        far,
        orientation_u=1e-4,
        position_u=0.01,
        focal_u_rel=5e-4,
        principal_point_u=0.5,
        distortion_u=1e-4,
        attachment_u=0.02,
        sag_range=(4.0, 9.0),
        swing_u=0.1,
    )
    theta = survey.prior_mean()
    theta[SAG], theta[SWING] = rng.uniform(5, 8), rng.normal(0, 0.05)
    t = np.linspace(0.04, 0.9, 4001)
    pixels = project(*survey.camera(theta), survey.shape(theta).points(t))[0]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    arc = np.linspace(0.0, along[-1], count)
    t = np.interp(arc, along, t)
    here = project(*survey.camera(theta), survey.shape(theta).points(t))[0]
    ahead = project(*survey.camera(theta), survey.shape(theta).points(t + 1e-5))[0] - here
    normal = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.hypot(*ahead.T)[:, None]
    spread = np.hypot(shared_px, share * sigma) * np.ones(count)
    apart = np.abs(arc[:, None] - arc)
    root = np.linalg.cholesky(spread[:, None] * spread * np.exp(-apart / 60.0) + 1e-14 * np.eye(count))
    error = sigma * rng.standard_normal(count) + root @ rng.standard_normal(count)
    curve = CurveObservations(t, arc, normal, here + error[:, None] * normal, np.full(count, 1.0) * sigma)
    return survey, theta, curve
