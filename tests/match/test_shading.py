"""Light from one side: what it moves, and what is expected of it; profiles are made by brute force."""

import numpy as np
import pytest

from sagnode.match.localise import localise
from sagnode.match.shading import MOST_PX, PER_WIDTH, moved_by_light

FINE = 20
"""Samples to a pixel across."""
ALONG = np.arange(20.0, 180.0)


def lit_cylinder(width, angle, *, albedo=0.3, sky=160.0, ambient=0.4, blur=0.7):
    """A level wire in row 80 before an even sky, lit by a sun ``angle`` rad from behind the camera towards row 160.

    Lambert's law at every fine sample across, then the blur, then the mean over each pixel.
    """
    fine = (np.arange(161 * FINE) + 0.5) / FINE - 0.5 - 80.0
    across = np.clip(2 * fine / width, -1, 1)
    light = ambient + (1 - ambient) * np.maximum(0.0, np.cos(np.arcsin(across) - angle))
    grey = np.where(np.abs(fine) < width / 2, 255 * albedo * light, sky)
    reach = np.arange(-5 * FINE, 5 * FINE + 1) / FINE
    spread = np.exp(-0.5 * (reach / blur) ** 2)
    padded = np.pad(grey, len(reach) // 2, mode="edge")
    rows = np.convolve(padded, spread / spread.sum(), mode="valid").reshape(161, FINE).mean(axis=1)
    noise = np.random.default_rng(5).normal(0, 0.7, (161, 200))
    return np.clip(np.rint(rows[:, None] + noise), 0, 255).astype(np.uint8)


def looked_at(image, width):
    """Blocks of the wire, and what is expected that light moves them by."""
    pixels = np.column_stack([ALONG, np.full(len(ALONG), 80.0)])
    normals = np.tile([0.0, 1.0], (len(ALONG), 1))
    blocks = localise(image, pixels, normals, width, 5.0, 20.0)
    place = np.rint(blocks.index).astype(int)
    widths = np.full(len(place), width)
    return blocks, moved_by_light(image, pixels[place], normals[place], widths, blocks.contrast, blocks.snr)


@pytest.mark.parametrize("width", [0.6, 1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("albedo", [0.1, 0.3, 0.5])
def test_what_light_moves_is_expected(width, albedo):
    """A sun from below: the wire is moved by 0.7 to 4.2 standard deviations of what is expected of light from below.

    The greys here are linear, and the sun stands where it moves most."""
    moved = []
    for angle in (0.0, 1.2):
        blocks, expected = looked_at(lit_cylinder(width, angle, albedo=albedo), width)
        moved.append(np.median(blocks.offset))
        assert expected is not None
        assert not expected[:, 0].any()
    ratio = (moved[1] - moved[0]) / np.median(expected[:, 1])
    assert 0.7 < ratio < 4.2


def test_a_dark_wire_seems_to_lie_away_from_the_light_and_a_bright_one_towards_it():
    dark, bright = (looked_at(lit_cylinder(3.0, 1.2, albedo=0.2, sky=sky), 3.0) for sky in (200.0, 10.0))
    assert np.median(dark[0].offset) < -0.02
    assert np.median(bright[0].offset) > 0.02
    assert (dark[1][:, 1] < 0).all()
    assert (bright[1][:, 1] > 0).all()


def test_what_is_expected_is_bounded_and_nothing_of_thin_wires():
    pixel, normal = np.array([[50.0, 50.0], [0.0, 99.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])
    image = np.full((100, 100), 120, np.uint8)
    faint = np.array([0.1, -0.1])
    thick = moved_by_light(image, pixel, normal, np.array([40.0, 2.0]), faint, np.ones(2))
    np.testing.assert_allclose(thick, [[0, MOST_PX], [-2 * PER_WIDTH, 0]], atol=1e-12)
    assert moved_by_light(image, pixel, normal, np.array([0.3, 0.4]), faint, np.ones(2)) is None
    assert moved_by_light(image, pixel, normal, np.array([3.0, 3.0]), np.full(2, np.nan), np.zeros(2)) is None
