"""Where a wire lies across a curve: unbiased, with honest uncertainties, for wires of any width and either sign."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.match.kernels import wire_kernel
from sagnode.match.localise import localise, localise_beside
from sagnode.match.ribbon import normals, straighten

Floats = NDArray[np.float64]


def strip(rng: np.random.Generator, row: float, width: float, contrast: float, noise: float) -> NDArray[np.uint8]:
    """A level wire across a sky that brightens downwards, 400 x 120 px."""
    v = np.arange(120.0)
    profile = 120 + 0.3 * v + contrast * wire_kernel(width, v - row, 0.8)
    return np.clip(np.rint(profile[:, None] + noise * rng.standard_normal((120, 400))), 0, 255).astype(np.uint8)


def curve(row: float) -> tuple[Floats, Floats]:
    u = np.linspace(10, 390, 381)
    pixels = np.stack([u, np.full_like(u, row)], axis=1)
    return pixels, normals(pixels)


@pytest.mark.parametrize(
    ("width", "contrast", "noise"), [(0.5, -40, 3), (1.5, -10, 3), (1.5, 60, 8), (3.0, -40, 3), (8.0, 60, 8)]
)
def test_offsets_are_unbiased_and_their_uncertainties_hold(width: float, contrast: float, noise: float) -> None:
    rng = np.random.default_rng(1)
    errors, sigmas = [], []
    for _ in range(12):
        row, shift = 60 + rng.uniform(-0.5, 0.5), rng.uniform(-2, 2)
        pixels, normal = curve(row + shift)
        blocks = localise(strip(rng, row, width, contrast, noise), pixels, normal, width, 6.0)
        error = blocks.offset + shift
        good = blocks.valid & (np.abs(error) < 1.5)
        assert good.mean() > 0.95
        assert np.sign(blocks.contrast[good]).mean() == np.sign(contrast)
        errors.append(error[good])
        sigmas.append(blocks.sigma[good])
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    assert abs(error.mean()) < 0.03
    assert 0.6 < (error / sigma).std() < 1.4


def test_a_slope_of_the_background_does_not_pull() -> None:
    rng = np.random.default_rng(2)
    image = strip(rng, 60.0, 1.5, -30, 0.5).astype(float) + np.linspace(-80, 60, 120)[:, None]
    pixels, normal = curve(60.0)
    blocks = localise(np.clip(image, 0, 255).astype(np.uint8), pixels, normal, 1.5, 5.0)
    assert abs(np.median(blocks.offset)) < 0.05


def test_blocks_lie_in_order_and_outside_the_frame_none_is_valid() -> None:
    rng = np.random.default_rng(3)
    pixels, normal = curve(60.0)
    shifted = pixels + np.array([200.0, 0.0])
    blocks = localise(strip(rng, 60.0, 1.5, -30, 2), shifted, normal, 1.5, 5.0)
    assert (np.diff(blocks.arc) > 0).all()
    assert len(blocks.index) == round(380 / 8)
    right = shifted[np.rint(blocks.index).astype(int), 0] > 404
    assert not blocks.valid[right].any()
    assert np.isnan(blocks.offset[right]).all()
    assert (blocks.snr[right] == 0).all()


def test_single_precision_pictures_give_the_same() -> None:
    rng = np.random.default_rng(4)
    image = strip(rng, 60.3, 1.5, -30, 2)
    pixels, normal = curve(60.0)
    bytes_, singles = (localise(part, pixels, normal, 1.5, 5.0) for part in (image, image.astype(np.float32)))
    assert np.nanmax(np.abs(bytes_.offset - singles.offset)) < 0.01


def test_fewer_than_two_samples_give_no_blocks() -> None:
    blocks = localise(np.zeros((50, 50), np.uint8), np.zeros((1, 2)), np.zeros((1, 2)), 1.0, 5.0)
    assert len(blocks.offset) == 0


def test_the_surroundings_look_as_they_do_about_the_shifted_curve() -> None:
    rng = np.random.default_rng(5)
    image = strip(rng, 60.0, 1.5, -30, 3)
    pixels, normal = curve(60.0)
    shifts = [20.0, -17.0, 70.0]
    blocks, beside = localise_beside(image, pixels, normal, 1.5, 5.0, shifts)
    alone = localise(image, pixels, normal, 1.5, 5.0)
    np.testing.assert_allclose(blocks.offset, alone.offset, atol=1e-9)
    for row, shift in enumerate(shifts[:2]):
        aside = localise(image, pixels + shift * normal, normal, 1.5, 5.0)
        np.testing.assert_allclose(beside.snr[row], aside.snr, rtol=1e-3)
        assert beside.inside[row].all()
        assert np.median(beside.snr[row]) < 0.2 * np.median(blocks.snr)
    assert not beside.inside[2].any(), "70 px aside is out of the picture"


def test_a_ribbon_follows_the_picture_to_a_fraction_of_a_grey_level_along_any_curve() -> None:
    v, u = np.mgrid[0:300, 0:900].astype(float)
    image = np.rint(20 + 0.1 * u + 0.3 * v).astype(np.uint8)
    along = np.linspace(0, 1, 700)
    pixels = np.stack([20 + 840 * along, 150 + 100 * np.sin(4 * along)], axis=1)
    offsets = np.arange(-20.0, 20.5, 0.5)
    ribbon = straighten(image, pixels, normals(pixels), offsets)
    place = pixels[:, None] + offsets[:, None] * normals(pixels)[:, None]
    error = ribbon - (20 + 0.1 * place[..., 0] + 0.3 * place[..., 1])
    assert np.abs(error).max() < 0.75, "one rounding of the picture, none of its own"
    assert abs(error.mean()) < 0.05
    np.testing.assert_allclose(
        ribbon, straighten(image.astype(np.float32), pixels, normals(pixels), offsets), atol=0.07
    )


@pytest.mark.parametrize("mistaken", [0.8, 1.0, 1.2])
def test_a_wire_unlike_its_kernel_is_as_certain_as_it_is_alike_on_both_sides(mistaken: float) -> None:
    rng = np.random.default_rng(4)
    errors, sigmas = [], []
    for _ in range(8):
        row = 60 + rng.uniform(-0.5, 0.5)
        pixels, normal = curve(60.0)
        blocks = localise(strip(rng, row, 6.0, 80, 1), pixels, normal, 6.0 * mistaken, 3.0)
        errors.append(blocks.offset - (row - 60.0))
        sigmas.append(blocks.sigma)
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    assert np.median(sigma) < 0.05, "a width that is wrong by a fifth does not move the wire"
    assert (error / sigma).std() < 1.4


def test_halves_agree_on_a_wire_and_contradict_each_other_where_something_else_crosses() -> None:
    rng = np.random.default_rng(9)
    pixels, normal = curve(60.3)
    wire = strip(rng, 60.0, 1.5, -40, 3)
    # the leg of a tower, at 12 degrees to the curve
    v, u = np.mgrid[0:120, 0:400].astype(float)
    leg = wire_kernel(3.0, (v - 60.0) * np.cos(np.pi / 15) - (u - 200.0) * np.sin(np.pi / 15), 0.8)
    crossed = np.clip(wire - 80 * leg, 0, 255).astype(np.uint8)

    def measured(image: NDArray[np.uint8]) -> Floats:
        blocks, _ = localise_beside(image, pixels, normal, 1.5, 5.0, (), 20.0, halves=True)
        return np.stack([blocks.arc, blocks.sigma, blocks.scatter, blocks.offset])

    _, sigma, scatter, _ = measured(wire)
    assert np.median(scatter) < np.median(sigma)
    assert np.max(scatter) < 0.1
    arc, sigma, scatter, offset = measured(crossed)
    # what leaves the range within a block shows in one half only
    wrong = (np.abs(offset + 0.3) > 5 * sigma) & (np.abs(offset) < 4.5)
    assert wrong.any()
    assert (scatter[wrong] > 3 * sigma[wrong]).all()
    assert np.max(scatter[np.abs(arc - 190.0) > 60.0]) < 0.1
