"""The halved picture against the whole one, and the single precision family against exact curves."""

import numpy as np
import pytest

from sagnode.geometry.camera import Intrinsics, Pose, rotation_from_angles
from sagnode.match.family import OUTSIDE_PX, Family
from sagnode.match.shrink import box_around, halved, halved_view
from sagnode.match.templates import View

LENS = Intrinsics(1456, 1088, 1739.0, 1741.0, 727.5, 543.5, (-0.08, 0.02, 0.0004, -0.0003, 0.001))
POSE = Pose(rotation_from_angles(0.0, -4.0, 1.0), np.array([1.0, -6.0, 15.0]))
VIEW = View(LENS, POSE, np.array([0.0, 0.0, 20.0]), np.array([3.0, 260.0, 24.0]), 0.025)
T = np.linspace(0.1, 1.0, 40)


@pytest.mark.parametrize(("sag", "swing"), [(6.0, 0.0), (8.0, 0.3), (10.0, -0.2)])
def test_a_family_is_its_curves(sag: float, swing: float) -> None:
    family = Family.of(VIEW, (6.0, 10.0), T)
    u, v, depth = family.pixels(LENS, np.arange(len(T)), np.array([sag]), np.array([swing]))
    pixels, exact = VIEW.pixels(sag, swing, T)
    seen = np.isfinite(pixels[:, 0])
    np.testing.assert_allclose(np.stack([u, v], axis=1)[seen, :, 0], pixels[seen], atol=0.05)
    np.testing.assert_allclose(depth[seen, 0], exact[seen], rtol=1e-3)
    assert np.all(u[~seen] == np.float32(OUTSIDE_PX))


def test_a_halved_picture_shows_the_same_at_the_same_place() -> None:
    columns = np.broadcast_to(np.arange(LENS.width), (LENS.height, LENS.width))
    # a ramp: its value tells the place
    image = np.round(255 * columns / LENS.width).astype(np.uint8)
    box = (201, 100, 1001, 700)
    small, view = halved(image, box), halved_view(VIEW, box)
    assert small.shape == (300, 400)
    pixels, _ = VIEW.pixels(8.0, 0.1, T)
    moved, _ = view.pixels(8.0, 0.1, T)
    # pixel (0, 0) of the small picture covers (201, 100) to (202, 101) of the whole one
    np.testing.assert_allclose(2 * moved + (201.5, 100.5), pixels, atol=1e-9)
    inside = (moved > 0).all(axis=1) & (moved < (399, 299)).all(axis=1)
    assert inside.sum() > 5
    near = np.round(moved[inside]).astype(int)
    np.testing.assert_allclose(small[near[:, 1], near[:, 0]], 255 * pixels[inside, 0] / LENS.width, atol=1.0)


def test_the_box_holds_what_is_in_the_frame_and_its_surroundings() -> None:
    u, v = np.array([-50.0, 10.0, 300.0, 5000.0]), np.array([20.0, 90.0, 400.0, 10.0])
    left, top, right, bottom = box_around(u, v, 20.0, (1088, 1456)) or (0, 0, 0, 0)
    assert (left, top) == (0, 70)
    assert (right, bottom) == (320, 420)
    assert box_around(u[:1], v[:1], 20.0, (1088, 1456)) is None
