"""The camera model against OpenCV's own projection, and its derivatives against differences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from sagnode.geometry.camera import (
    Intrinsics,
    Pose,
    distort,
    inside,
    project,
    projection_derivatives,
    rotation_from_angles,
    rotation_from_vector,
    turned,
    undistort,
)

PLAIN = Intrinsics(1456, 1088, 1739.0, 1741.0, 727.5, 543.5, (-0.08, 0.02, 0.0004, -0.0003, 0.001))
RATIONAL = Intrinsics(1456, 1088, 1739.0, 1741.0, 727.5, 543.5, (0.3, 0.1, 0.0004, -0.0003, 0.02, 0.4, 0.12, 0.03))
FISHEYE = Intrinsics(1456, 1088, 700.0, 705.0, 727.5, 543.5, (0.02, -0.01, 0.003, -0.001), "fisheye")
POSE = Pose(rotation_from_angles(12.0, -3.0, 4.0), np.array([1.0, -2.0, 15.0]))


def points_ahead(count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    camera = np.column_stack([rng.uniform(-0.35, 0.35, count), rng.uniform(-0.25, 0.25, count), np.ones(count)])
    camera *= rng.uniform(5, 300, count)[:, None]
    return camera @ POSE.rotation + POSE.position


@pytest.mark.parametrize("intrinsics", [PLAIN, RATIONAL])
def test_projection_equals_opencv(intrinsics: Intrinsics) -> None:
    points = points_ahead(200)
    rvec, _ = cv2.Rodrigues(POSE.rotation)
    expected, _ = cv2.projectPoints(
        points, rvec, -POSE.rotation @ POSE.position, intrinsics.matrix, np.array(intrinsics.distortion)
    )
    np.testing.assert_allclose(project(intrinsics, POSE, points)[0], expected.reshape(-1, 2), atol=1e-8)


def test_fisheye_projection_equals_opencv() -> None:
    points = points_ahead(50)
    rvec, _ = cv2.Rodrigues(POSE.rotation)
    expected, _ = cv2.fisheye.projectPoints(
        points.reshape(-1, 1, 3),
        rvec,
        -POSE.rotation @ POSE.position,
        FISHEYE.matrix,
        np.array(FISHEYE.distortion),
    )
    np.testing.assert_allclose(project(FISHEYE, POSE, points)[0], expected.reshape(-1, 2), atol=1e-8)


@pytest.mark.parametrize("intrinsics", [PLAIN, RATIONAL, FISHEYE])
def test_undistort_inverts_distortion(intrinsics: Intrinsics) -> None:
    points = points_ahead(50)
    pixels, _ = project(intrinsics, POSE, points)
    x, y = undistort(intrinsics, pixels[:, 0], pixels[:, 1])
    camera = (points - POSE.position) @ POSE.rotation.T
    np.testing.assert_allclose(np.stack([x, y]), (camera[:, :2] / camera[:, 2:]).T, atol=1e-9)


def test_a_wide_fisheye_is_inverted_to_its_edge() -> None:
    wide = Intrinsics(640, 480, 300.0, 300.0, 319.5, 239.5, (0.05, -0.01, 0.002, 0.0), "fisheye")
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 639, 15), np.linspace(0, 479, 11)))
    x, y = distort(wide, *undistort(wide, u, v))
    np.testing.assert_allclose([x * 300.0 + 319.5, y * 300.0 + 239.5], [u, v], atol=1e-6)


def test_points_behind_and_far_outside_the_lens_are_not_projected() -> None:
    forward = POSE.rotation[2]
    behind = POSE.position - 10 * forward
    aside = POSE.position + 10 * forward + 60 * POSE.rotation[0]
    pixels, depth = project(PLAIN, POSE, np.stack([behind, aside, POSE.position + 10 * forward]))
    assert np.isnan(pixels[:2]).all()
    assert depth[0] < 0
    np.testing.assert_allclose(pixels[2], [PLAIN.cx, PLAIN.cy], atol=1e-9)
    assert inside(PLAIN, pixels).tolist() == [False, False, True]


def test_a_perfect_lens_that_is_given_a_trace_of_distortion_folds_nothing_back_into_the_frame() -> None:
    perfect = Intrinsics(1456, 1088, 1739.0, 1739.0, 727.5, 543.5)
    beside = np.array([[2.0, 0.1, 0.002], [30.0, 5.0, 1.0]]) @ POSE.rotation + POSE.position
    assert np.isfinite(project(perfect, POSE, beside)[0]).all()
    # as the joint estimate does: a correction of k1
    estimated = replace(perfect, distortion=(-1e-6, 0.0, 0.0, 0.0))
    assert np.isnan(project(estimated, POSE, beside)[0]).all()
    pixels, _ = project(estimated, POSE, points_ahead(200))
    assert pixels == pytest.approx(project(perfect, POSE, points_ahead(200))[0], abs=1e-3)


@pytest.mark.parametrize(
    ("angles", "forward"),
    [((0, 0, 0), (0, 1, 0)), ((90, 0, 0), (1, 0, 0)), ((0, -90 + 1e-9, 0), (0, 0, -1)), ((180, 0, 0), (0, -1, 0))],
)
def test_angles_are_a_compass_and_an_elevation(
    angles: tuple[float, float, float], forward: tuple[float, float, float]
) -> None:
    rotation = rotation_from_angles(*angles)
    np.testing.assert_allclose(rotation[2], forward, atol=1e-7)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_roll_clockwise_turns_the_picture_anticlockwise() -> None:
    level, rolled = (Pose(rotation_from_angles(0, 0, roll), np.zeros(3)) for roll in (0.0, 10.0))
    right = np.array([5.0, 100.0, 0.0])
    before, after = (project(PLAIN.without_distortion(), pose, right)[0] for pose in (level, rolled))
    # what was level with the axis on the right comes to lie higher: v gets smaller
    assert after[1] < before[1]


def test_rodrigues_equals_opencv() -> None:
    for vector in (np.array([0.3, -0.2, 0.5]), np.array([1e-9, 0, 2e-9])):
        np.testing.assert_allclose(rotation_from_vector(vector), cv2.Rodrigues(vector)[0], atol=1e-12)


@pytest.mark.parametrize("intrinsics", [PLAIN, RATIONAL, PLAIN.without_distortion()])
def test_derivatives_equal_differences(intrinsics: Intrinsics) -> None:
    points = points_ahead(20)
    by_point, by_camera = projection_derivatives(intrinsics, POSE, points)

    def moved(k: int, step: float) -> np.ndarray:
        change = np.zeros(6)
        change[k] = step
        return project(intrinsics, turned(POSE, change[:3], change[3:]), points)[0]

    for k in range(6):
        step = 1e-5
        difference = (moved(k, step) - moved(k, -step)) / (2 * step)
        np.testing.assert_allclose(by_camera[:, :, k], difference, rtol=1e-3, atol=0.05)
    shift = np.array([0.0, 0.0, 1e-4])
    up = (project(intrinsics, POSE, points + shift)[0] - project(intrinsics, POSE, points - shift)[0]) / 2e-4
    np.testing.assert_allclose(by_point[:, :, 2], up, rtol=1e-3, atol=1e-2)
