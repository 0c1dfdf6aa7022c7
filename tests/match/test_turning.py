"""A turn of the camera, as its landmarks show it through any lens."""

from dataclasses import replace

import numpy as np
import pytest

from sagnode.geometry.camera import Intrinsics, project_camera, rotation_from_vector, undistort
from sagnode.match.landmarks import consensus
from sagnode.match.patches import Patch
from sagnode.match.turning import as_turns

WIDE = Intrinsics(1456, 1088, 900.0, 900.0, 720.0, 540.0, (-0.2, 0.05, 1e-4, 1e-4, 0.0))
FISHEYE = Intrinsics(1456, 1088, 700.0, 700.0, 720.0, 540.0, (0.02, 0.001, 0.0, 0.0), "fisheye")
PIXELS = np.array([(90.0, 950.0), (1350.0, 120.0), (700.0, 560.0), (150.0, 90.0), (1300.0, 900.0), (600.0, 200.0)])


def moved(lens: Intrinsics, turn: tuple[float, float, float], scale: float = 1.0) -> np.ndarray:
    """How far (N, 2) what is seen at the pixels goes when the camera turns by a vector, rad, and its lens is longer."""
    rays = np.stack([*undistort(lens, *PIXELS.T), np.ones(len(PIXELS))], axis=1)
    longer = replace(lens, fx=scale * lens.fx, fy=scale * lens.fy)
    return project_camera(longer, rays @ rotation_from_vector(np.array(turn)).T)[0] - PIXELS


@pytest.mark.parametrize("lens", [WIDE, FISHEYE])
def test_a_turn_aside_is_one_movement_of_all_places(lens: Intrinsics) -> None:
    shift = moved(lens, (0.04, 0.05, 0.0))
    assert np.ptp(shift, axis=0).max() > 8.0
    _, turn = as_turns(lens, PIXELS, shift)
    assert np.abs(turn - lens.fx * (0.05 - 0.04j)).max() < 0.3


def test_roll_and_scale_turn_and_stretch_the_plane() -> None:
    place, turn = as_turns(WIDE, PIXELS, moved(WIDE, (0.03, -0.04, 0.05), 1.002))
    basis = np.stack([np.ones(len(place)), place], axis=1)
    similar = basis @ np.linalg.lstsq(basis, turn, rcond=None)[0]
    assert np.abs(turn - similar).max() < 1.0


def test_landmarks_in_all_corners_agree_on_a_turn() -> None:
    shift = np.round(moved(WIDE, (0.04, 0.05, 0.0)))
    patches = [Patch(pixel, np.zeros((33, 33), np.uint8)) for pixel in PIXELS]
    # each has a weaker likeness where a movement that is the same all over the picture would put it
    options = [[(du, dv, 0.95), (*np.round(np.median(shift, axis=0)), 0.7)] for du, dv in shift]
    chosen = consensus(patches, options, WIDE)
    assert {i: peak[:2] for i, peak in chosen.items()} == {i: tuple(own) for i, own in enumerate(shift)}
