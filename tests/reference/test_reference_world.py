import numpy as np
import pytest

from sagnode.geometry.camera import Intrinsics, Pose, project, rotation_from_angles
from sagnode.reference.world import (
    distance_to_ground,
    fictive_line_height,
    frontal_offset,
    midspan_depth,
    pixel_to_world,
    sag_from_height,
)

PAPER_K = Intrinsics(960, 540, 691.634, 686.796, 468.717, 270.928)
"""The intrinsic matrix of section 3.3.3."""


def test_pixel_to_world_undoes_the_projection():
    pose = Pose(rotation_from_angles(37, -8, 2), np.array([1.0, -2, 3]))
    point = np.array([40.0, 55.0, 6.0])
    pixel, depth = project(PAPER_K, pose, point)
    assert pixel_to_world(PAPER_K, pose, pixel, float(depth)) == pytest.approx(point)


def test_frontal_shorthand_is_the_general_equation_for_a_level_camera():
    pose = Pose(rotation_from_angles(0, 0, 0), np.array([0.0, 0.0, 0.9]))
    pixel = np.array([512.0, 180.0])
    x, y = frontal_offset(PAPER_K, pixel, 2.5)
    assert pixel_to_world(PAPER_K, pose, pixel, 2.5) == pytest.approx([x, 2.5, 0.9 - y])


def test_a_pixel_at_the_laboratorys_distance_is_3_6_mm():
    a, b = (frontal_offset(PAPER_K, np.array([468.717, v]), 2.5)[1] for v in (100.0, 101.0))
    assert b - a == pytest.approx(0.00364, abs=1e-5)


def test_sixty_six_pixels_are_not_0_59_m_in_the_field_with_the_laboratorys_lens():
    """Section 4.6.2 pairs 66 px with 0.59 m at 136.85 m, which needs a focal length of some 15 300 px."""
    metres = 66 * 136.85 / PAPER_K.fy
    assert metres > 13
    assert pytest.approx(15_300, rel=0.01) == 66 * 136.85 / 0.59


def test_sag_and_clearance_are_the_papers_differences():
    assert sag_from_height(16.0, 7.58) == pytest.approx(8.42)
    assert distance_to_ground(14.81, 8.42) == pytest.approx(6.39)


@pytest.mark.parametrize("east", [-50.0, 0.0, 60.0])
def test_fictive_line_finds_the_height_of_the_curve_at_midspan(east):
    near, far = np.array([-30.0, 80, 20]), np.array([40.0, 90, 24])
    pose = Pose(rotation_from_angles(-east / 2, 3, 1), np.array([east, 0.0, 2.0]))
    s = np.linspace(0, 1, 5001)[:, None]
    space = near + s * (far - near) - 4 * 6.0 * s * (1 - s) * np.array([0, 0, 1.0])
    curve, _ = project(PAPER_K, pose, space)
    middle = 0.5 * (near + far)
    found = fictive_line_height(PAPER_K, pose, middle - [0, 0, 5.0], curve)
    assert found is not None
    pixel, height = found
    assert height == pytest.approx(middle[2] - 6.0, abs=1e-3)
    assert pixel == pytest.approx(project(PAPER_K, pose, middle - [0, 0, 6.0])[0], abs=0.05)


def test_fictive_line_beside_the_curve_cuts_nothing():
    pose = Pose(rotation_from_angles(0, 0, 0), np.zeros(3))
    curve = np.array([[500.0, 100.0], [600.0, 120.0], [700.0, 100.0]])
    assert fictive_line_height(PAPER_K, pose, np.array([0.0, 50.0, 5.0]), curve) is None


def test_midspan_depth_of_the_laboratory_is_its_measured_distance():
    pose = Pose(rotation_from_angles(0, 0, 0), np.array([1.35, 0.0, 0.9]))
    assert midspan_depth(pose, np.array([0, 2.5, 1.6]), np.array([2.7, 2.5, 1.6]), 0.3) == pytest.approx(2.5)
