"""Wires in the sun: brighter on its side, by as much as Lambert's law says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.geometry.camera import Intrinsics, Pose, rotation_from_angles
from sagnode.scene.canvas import Air, Canvas
from sagnode.scene.catenary import WireState
from sagnode.scene.wires import WireLook, draw_wire

Floats = NDArray[np.float64]
BLUR, DIAMETER, FOCAL, AWAY = 0.6, 0.04, 1000.0, 10.0
SUNLIT = 100.0


def drawn(towards: Floats, sunlit: float = SUNLIT) -> Floats:
    """Greys (H, W) of a level wire 10 m ahead, as good as straight, across the view of a level camera looking north."""
    lens = Intrinsics(120, 81, FOCAL, FOCAL, 60.0, 40.0)
    pose = Pose(rotation_from_angles(0.0, 0.0, 0.0), np.zeros(3))
    canvas = Canvas.blank(lens, pose, np.eye(3), BLUR, Air(0.0, 150.0))
    canvas.grey[...] = 150.0
    look = WireLook(shade=80.0, lit=80.0, sunlit=sunlit, towards=towards)
    near, far = np.array([-3.0, AWAY, 0.0]), np.array([3.0, AWAY, 0.0])
    draw_wire(canvas, near, far, WireState(1e-4), DIAMETER, look, [1])
    return canvas.grey.astype(np.float64)


def lambert(towards: Floats) -> Floats:
    """The part of the sun's light that is not alike above and below (H,), by brute force: fine strips, each blurred."""
    strip = np.linspace(-1, 1, 4001)
    facing = np.stack([np.zeros_like(strip), -np.sqrt(1 - strip**2), strip], axis=1)
    light = np.maximum(facing @ towards, 0.0)
    odd = 0.5 * (light - light[::-1])
    row = np.arange(81)[:, None] - (40.0 - strip * DIAMETER / 2 * FOCAL / AWAY)
    weight = np.exp(-0.5 * (row / BLUR) ** 2) / (BLUR * np.sqrt(2 * np.pi)) * (DIAMETER * FOCAL / AWAY) / strip.size
    return np.asarray(SUNLIT * weight @ odd)


@pytest.mark.parametrize("elevation", [-80.0, -30.0, 20.0, 50.0, 90.0])
def test_the_side_towards_the_sun_is_brighter_by_lamberts_law(elevation: float) -> None:
    """A slope stands for the whole shape across: it is compared by its pull, the first moment."""
    angle = np.radians(elevation)
    towards = np.array([0.0, -np.cos(angle), np.sin(angle)])
    change = (drawn(towards) - drawn(towards, sunlit=0.0))[:, 50:70].mean(axis=1)
    rows = np.arange(81) - 40.0
    expected = lambert(towards)
    assert change @ rows == pytest.approx(expected @ rows, rel=0.03, abs=0.3)
    assert np.abs(change.sum()) < 0.5
    assert np.sign(change[38]) == np.sign(elevation)


def test_a_sun_behind_the_camera_or_before_it_lights_both_sides_alike() -> None:
    for north in (-1.0, 1.0):
        towards = np.array([0.0, north, 0.0])
        np.testing.assert_allclose(drawn(towards), drawn(towards, sunlit=0.0), atol=0.2)


def test_air_takes_the_light_of_the_side_with_the_rest() -> None:
    towards = np.array([0.0, 0.0, 1.0])
    canvas = Canvas.blank(
        Intrinsics(120, 81, FOCAL, FOCAL, 60.0, 40.0), Pose(rotation_from_angles(0.0, 0.0, 0.0), np.zeros(3)),
        np.eye(3), BLUR, Air(0.1, 150.0),
    )  # fmt: skip
    near, far = np.array([-3.0, AWAY, 0.0]), np.array([3.0, AWAY, 0.0])
    look = WireLook(shade=80.0, lit=80.0, sunlit=SUNLIT, towards=towards)
    pictures = []
    for one in (look, replace(look, sunlit=0.0)):
        canvas.grey[...] = 150.0
        draw_wire(canvas, near, far, WireState(1e-4), DIAMETER, one, [1])
        pictures.append(canvas.grey[:, 60].astype(np.float64))
    clear = drawn(towards)[:, 60] - drawn(towards, sunlit=0.0)[:, 60]
    np.testing.assert_allclose(pictures[0] - pictures[1], clear * np.exp(-0.1 * AWAY), atol=0.05)
