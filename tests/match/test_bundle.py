"""Bundles: the centre line is measured, whether the sub-conductors are seen apart or not, and never one of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.geometry.bundle import sub_conductor_offsets
from sagnode.geometry.camera import Intrinsics, Pose, rotation_from_angles
from sagnode.match.bundle import lines
from sagnode.match.kernels import wire_kernel
from sagnode.match.localise import localise_beside
from sagnode.match.masks import Neighbour, others_near
from sagnode.match.ribbon import line_response, normals
from sagnode.match.templates import View
from sagnode.match.track import Track, trace

Floats = NDArray[np.float64]


def strip(rows: Floats, width: float, noise: float, seed: int = 0) -> NDArray[np.uint8]:
    """Level dark wires at ``rows`` across a sky, 160 x 400 px."""
    v = np.arange(160.0)
    profile = 150 - 40 * sum(wire_kernel(width, v - row, 0.8) for row in rows)
    noisy = profile[:, None] + noise * np.random.default_rng(seed).standard_normal((160, 400))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def curve(row: float) -> tuple[Floats, Floats]:
    u = np.linspace(10, 390, 381)
    pixels = np.stack([u, np.full_like(u, row)], axis=1)
    return pixels, normals(pixels)


@pytest.mark.parametrize(("count", "sides"), [(1, 0), (2, 1), (3, 3), (4, 4)])
def test_sub_conductors_stand_a_spacing_apart_about_the_centre_line_across_the_chord(count: int, sides: int) -> None:
    near, far = np.array([1.0, 2.0, 20.0]), np.array([40.0, 250.0, 45.0])
    places = sub_conductor_offsets(near, far, count, 0.4)
    np.testing.assert_allclose(places.sum(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(places @ (far - near), 0, atol=1e-9)
    apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(count, 1)]
    assert np.isclose(apart, 0.4).sum() == sides
    if count == 3:
        assert np.argmin(places[:, 2]) == 2, "its point hangs down"


def test_lines_merge_where_the_picture_does_not_tell_them_apart() -> None:
    width = np.array([0.5, 0.5, 6.0, 6.0])
    members = np.array([[-0.6, -10.0, -3.5, -10.0], [0.6, 10.0, 3.5, 10.0]])
    place, side = lines(members, width)
    np.testing.assert_allclose(place, [[0, -10, 0, -10], [0, 10, 0, 10]])
    np.testing.assert_allclose(side, [[3.1, 2.5, 8.0, 4.5]] * 2)
    close, near_side = lines(np.array([[-2.0], [2.0]]), np.array([0.5]))
    assert (np.abs(close) + near_side).min() == pytest.approx(4.0), "each takes half of what lies between them"


@pytest.mark.parametrize("spacing", [0.7, 1.8, 3.0, 6.0, 14.0])
def test_the_centre_line_of_two_is_unbiased_with_honest_uncertainty(spacing: float) -> None:
    errors, sigmas = [], []
    for seed in range(6):
        shift = np.random.default_rng(seed).uniform(-2, 2)
        pixels, normal = curve(80.0 + shift)
        image = strip(80.0 + 0.5 * spacing * np.array([-1, 1]), 0.8, 6, seed)
        members = np.full((2, len(pixels)), 0.5 * spacing) * np.array([[-1], [1]])
        blocks, _ = localise_beside(image, pixels, normal, 0.8, 5.0, [], members=members)
        good = blocks.valid & (np.abs(blocks.offset + shift) < 1.5)
        assert good.mean() > 0.95
        errors.append((blocks.offset + shift)[good])
        sigmas.append(blocks.sigma[good])
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    assert abs(error.mean()) < 0.03
    assert 0.55 < (error / sigma).std() < 1.4


def test_a_pattern_a_spacing_off_fits_half_as_well() -> None:
    image = strip(np.array([70.0, 90.0]), 1.0, 2)
    members = np.array([[-10.0], [10.0]]) * np.ones((1, 381))
    scores, strengths = [], []
    for row in (80.0, 100.0):
        pixels, normal = curve(row)
        place, side = lines(members, np.ones(381))
        scores.append(float(np.mean(line_response(image, pixels, normal, place, side))))
        blocks, _ = localise_beside(image, pixels, normal, 1.0, 5.0, [], members=members)
        strengths.append(float(np.median(blocks.correlation)))
    assert scores[1] < 0.6 * scores[0]
    assert strengths[1] < 0.8 * strengths[0]


def test_sub_conductors_are_met_on_the_normals_of_the_centre_line() -> None:
    lens = Intrinsics(1456, 1088, 2050.0, 2050.0, 727.5, 543.5, (-0.05, 0.01))
    pose = Pose(rotation_from_angles(0.0, -1.0, 0.0), np.array([0.3, 0.5, 14.5]))
    near, far = np.array([-3.5, 0.0, 20.0]), np.array([-3.5, 269.7, 20.8])
    places = sub_conductor_offsets(near, far, 4, 0.4)
    track = trace(View(lens, pose, near, far, 0.0218, (), places), 8.4, 0.1)
    assert track is not None
    inner = slice(100, -100)
    for offset, place in zip(track.members, places, strict=True):
        member = trace(View(lens, pose, near + place, far + place, 0.0218), 8.4, 0.1)
        assert member is not None
        met = (track.pixels + offset[:, None] * track.normal)[inner]
        gap = met[:, None] - member.pixels
        nearest = np.argmin(np.hypot(gap[..., 0], gap[..., 1]), axis=1)
        across = np.sum(gap[np.arange(len(met)), nearest] * member.normal[nearest], axis=1)
        assert np.abs(across).max() < 0.02


@pytest.mark.parametrize(("aside_px", "near"), [(0.0, False), (7.0, True), (17.0, True), (20.0, False)])
def test_another_wire_hides_a_bundle_only_beside_one_of_its_own(aside_px: float, near: bool) -> None:
    # two sub-conductors 24 px apart, looked about 6 px to either side
    along = np.arange(200.0)
    pixels = np.stack([along, np.full(200, 100.0)], axis=1)
    normal = np.tile([0.0, 1.0], (200, 1))
    members = np.stack([np.full(200, -12.0), np.full(200, 12.0)])
    track = Track(along / 199, pixels, normal, np.ones(200), along, members)
    index = np.arange(20, 180, 20)
    other = pixels + np.array([0.0, aside_px])
    assert (others_near(track, index, [Neighbour(other)], np.full(len(index), 6.0)) == near).all()
