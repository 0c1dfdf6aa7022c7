"""The library of a burst: taken again while the camera stays, drawn anew when it has moved, and free of any picture."""

from dataclasses import replace

import numpy as np
import pytest

from sagnode.geometry.camera import Intrinsics, Pose, rotation_from_angles, turned
from sagnode.match.library import Library, Shelf, draw_library
from sagnode.match.search import search
from sagnode.match.templates import View

LENS = Intrinsics(1456, 1088, 1739.0, 1739.0, 727.5, 543.5)
SAGS, SWING, ATTACHMENT_U = (6.0, 11.0), 0.3, 0.02


def view_turned(pixels: float = 0.0) -> View:
    pose = Pose(rotation_from_angles(0.0, -1.0, 0.0), np.array([0.3, -6.0, 14.5]))
    pose = turned(pose, np.array([0.0, pixels / LENS.fx, 0.0]), np.zeros(3))
    return View(LENS, pose, np.array([-3.5, 0.0, 20.0]), np.array([-3.5, 269.7, 20.8]), 0.0218)


def drawn(view: View) -> Library:
    library = draw_library(view, SAGS, SWING, ATTACHMENT_U)
    assert library is not None
    return library


def test_a_library_serves_while_its_curves_stay_within_a_third_of_a_pixel() -> None:
    library = drawn(view_turned())
    assert library.serves(view_turned())
    assert library.serves(view_turned(0.2))
    assert not library.serves(view_turned(0.5))
    assert not library.serves(replace(view_turned(), load=(0.2,)))
    away = replace(view_turned(), pose=Pose(rotation_from_angles(180.0, 0.0, 0.0), np.zeros(3)))
    assert not library.serves(away), "nothing of it is in view"


def test_a_shelf_gives_the_same_library_again_and_a_new_one_to_a_moved_camera() -> None:
    shelf = Shelf()

    def take(name: str, view: View) -> Library | None:
        return shelf.take(name, view, SAGS, SWING, ATTACHMENT_U)

    first = take("L1", view_turned())
    assert take("L1", view_turned(0.1)) is first
    assert take("L2", view_turned()) is not first
    moved = take("L1", view_turned(2.0))
    assert moved is not first
    assert take("L1", view_turned(2.0)) is moved, "the newest one is kept"


@pytest.mark.parametrize("pixels", [0.0, 0.25])
def test_searching_does_not_write_into_a_library(pixels: float) -> None:
    rng = np.random.default_rng(5)
    shown, other = (rng.integers(0, 255, (1088, 1456)).astype(np.uint8) for _ in range(2))
    fresh = search(shown, drawn(view_turned(pixels)), 0.1)
    library = drawn(view_turned(pixels))
    search(other, library, 0.1)
    assert search(shown, library, 0.1) == fresh
