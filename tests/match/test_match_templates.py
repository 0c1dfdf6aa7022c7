"""Templates: the rational Bézier against the projected parabola, and the coarse search on rendered frames."""

import numpy as np
import pytest

from presets import simple_scene
from sagnode.geometry.camera import Intrinsics, Pose, project, rotation_from_angles
from sagnode.geometry.conductor import control_points
from sagnode.match.library import draw_library
from sagnode.match.search import search
from sagnode.match.templates import View, even_parameters
from sagnode.scene.render import render

LENS = Intrinsics(1456, 1088, 1739.0, 1739.0, 727.5, 543.5)


def tower_view(y: float) -> View:
    pose = Pose(rotation_from_angles(0.0, -1.0, 0.0), np.array([0.3, y, 14.5]))
    return View(LENS, pose, np.array([-3.5, 0.0, 20.0]), np.array([-3.5, 269.7, 20.8]), 0.0218)


@pytest.mark.parametrize("y", [-30.0, 2.0])
def test_a_space_bezier_projects_to_a_rational_one_also_with_an_attachment_behind_the_camera(y: float) -> None:
    view = tower_view(y)
    points, weights = view.rational_bezier(8.4, 0.1)
    assert (weights[0] < 0) == (y > 0)
    t = np.linspace(0.05, 1.0, 200)
    basis = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2]) * weights[:, None]
    rational = (basis.T @ points) / basis.sum(axis=0)[:, None]
    a, handle, b = control_points(view.near, view.far, 8.4, 0.1)
    parabola = ((1 - t) ** 2)[:, None] * a + (2 * t * (1 - t))[:, None] * handle + (t**2)[:, None] * b
    np.testing.assert_allclose(rational, project(LENS, view.pose, parabola)[0], atol=1e-8)


def test_even_parameters_are_even_in_the_picture_and_only_where_the_curve_is_seen() -> None:
    view = tower_view(0.5)
    t = even_parameters(view, 8.4, 0.0, 50)
    pixels, _ = view.pixels(8.4, 0.0, t)
    steps = np.hypot(*np.diff(pixels, axis=0).T)
    assert steps.max() < 1.3 * steps.min()
    assert t[0] > 0.03, "the near attachment is behind the picture's edge"
    assert even_parameters(view, 8.4, 0.0, 50, span_share=0.9).mean() > t.mean()


def test_nothing_in_view_gives_no_parameters() -> None:
    view = tower_view(0.5)
    away = View(LENS, Pose(rotation_from_angles(180.0, -1.0, 0.0), view.pose.position), view.near, view.far, 0.02)
    assert even_parameters(away, 8.4, 0.0, 50).size == 0
    assert draw_library(away, (6.0, 11.0), 0.5, 0.03) is None
    assert search(np.zeros((1088, 1456), np.uint8), None, 0.2) == []


def test_coarse_search_comes_near_the_truth() -> None:
    scene, moment = simple_scene({"L1": 1.7, "L2": 2.4})
    image = render(scene, moment).image
    for conductor, sag in (("L1", 1.7), ("L2", 2.4)):
        c = next(c for c in scene.true.conductors if c.id == conductor)
        view = View(scene.intrinsics, scene.pose_at(moment), np.array(c.near), np.array(c.far), c.diameter_m)
        library = draw_library(view, (c.sag_min_m, c.sag_max_m), np.radians(20.0), 0.02)
        best = search(image, library, np.radians(10.0))[0]
        assert best.sag == pytest.approx(sag, abs=0.15)
        # seen from the side, swing hardly shows
        assert abs(best.swing) < np.radians(6.0)
        assert best.score > 3.0
