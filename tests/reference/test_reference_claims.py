"""The paper's printed claims about geometry, computed; docs/paper.md tells of them in words."""

import numpy as np
import pytest

from sagnode.geometry.camera import Intrinsics, Pose, rotation_from_angles
from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import Shape, quantities
from sagnode.reference.library import Scene, bezier_library

LEVEL = GroundProfile(np.array([0.0, 300.0]), np.zeros(2), np.empty((0, 3)), 0.0)


def test_the_fields_height_difference_moves_the_lowest_point_by_3_3_m_and_its_height_by_5_mm():
    """Section 4.6.2 says 1.0 to 1.5 m and 0.15 to 0.20 m."""
    found = quantities(Shape(np.array([0.0, 0.0, 14.81]), np.array([0.0, 269.7, 15.64]), 8.42), LEVEL)
    assert 269.7 / 2 - found["lowest_along"] == pytest.approx(0.83 * 269.7 / (8 * 8.42), abs=0.05)
    midspan_height = 0.5 * (14.81 + 15.64) - found["midspan_sag"]
    assert midspan_height - found["lowest_height"] == pytest.approx(0.83**2 / (16 * 8.42), abs=0.0005)


def off_the_curve(scene: Scene) -> float:
    """Largest distance, px, between a conductor's picture and the plain quadratic closest to it."""
    curve = scene.visible(scene.near, scene.far, float(scene.sags[0]))
    template = next(bezier_library(scene))
    places = np.linspace(0, len(template.points) - 1, 20_001)
    dense = np.stack(
        [np.interp(places, np.arange(len(template.points)), column) for column in template.points.T], axis=1
    )
    gap = np.hypot(*(curve[::20, None] - dense[None]).transpose(2, 0, 1))
    return float(gap.min(axis=1).max())


def test_a_plain_quadratic_is_enough_in_the_frontal_laboratory():
    camera = Intrinsics(960, 540, 691.634, 686.796, 468.717, 270.928)
    pose = Pose(rotation_from_angles(0, 0, 0), np.array([1.35, 0.0, 0.9]))
    ends = np.array([0.0, 2.5, 1.6]), np.array([2.7, 2.5, 1.6])
    assert off_the_curve(Scene(camera, pose, *ends, np.array([0.2]))) < 0.1


def test_a_plain_quadratic_cannot_follow_the_perspective_of_a_view_along_the_line():
    """Section 5.2: "removal of perspective transformations"; from the tower it costs several pixels."""
    camera = Intrinsics(1456, 1088, 2050.0, 2050.0, 727.5, 543.5)
    pose = Pose(rotation_from_angles(0.6, 1.6, 0), np.array([0.6, 0.85, 12.2]))
    ends = np.array([-4.02, 0.0, 17.21]), np.array([-3.97, 269.7, 18.04])
    assert 5 < off_the_curve(Scene(camera, pose, *ends, np.array([8.4]))) < 25
