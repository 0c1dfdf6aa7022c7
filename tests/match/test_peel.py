"""Taking known wires out of a picture: what stays is what would be there without them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.match.kernels import wire_kernel
from sagnode.match.localise import localise
from sagnode.match.masks import Neighbour, others_near, pulled
from sagnode.match.peel import Line, aside, peeled
from sagnode.match.ribbon import arc_length, normals, straighten
from sagnode.match.track import Track

Floats = NDArray[np.float64]
U = np.linspace(5.0, 395.0, 391)
WIDTH = 1.0


def wire(height: float, slope: float = 0.0, bend: float = 12.0) -> Line:
    """A hanging wire whose middle is at row ``height``, with a slope."""
    v = height + bend * (1 - ((U - 200) / 200) ** 2) - bend + slope * (U - 200)
    pixels = np.stack([U, v], axis=1)
    return Line(pixels, normals(pixels), np.full(len(U), WIDTH))


def picture(rng: np.random.Generator, wires: list[tuple[Line, float]], noise: float) -> NDArray[np.uint8]:
    """Wires with their contrasts before a sky that brightens downwards, 400 x 120 px."""
    columns, rows = np.arange(400.0), np.arange(120.0)[:, None]
    grey = 140 + 0.3 * rows + noise * rng.standard_normal((120, 400))
    for line, contrast in wires:
        middle = np.interp(columns, line.pixels[:, 0], line.pixels[:, 1])
        across = np.interp(columns, line.pixels[:, 0], np.abs(line.normal[:, 1]))
        shown = wire_kernel(WIDTH, (rows - middle) * across, 0.8)
        grey = grey + contrast * shown
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("apart", [2.5, 4.0, 6.0])
@pytest.mark.parametrize("contrast", [-60.0, 50.0])
def test_a_wire_is_measured_as_well_as_if_its_neighbour_were_not_there(apart: float, contrast: float) -> None:
    rng = np.random.default_rng(1)
    own, other = wire(60.0), wire(60.0 + apart)
    image = picture(rng, [(own, -30.0), (other, contrast)], 2.0)
    alone = picture(np.random.default_rng(1), [(own, -30.0)], 2.0)
    bare = peeled(image, [other], [own])
    beside, without = (localise(each, own.pixels, own.normal, WIDTH, 3.0, 20.0) for each in (bare, alone))
    assert beside.valid.all()
    assert abs(np.mean(beside.offset)) < 0.04
    assert np.std(beside.offset) < 1.5 * np.std(without.offset)
    assert np.median(beside.sigma) < 1.6 * np.median(without.sigma)


def test_nothing_is_left_of_a_wire_whose_contrast_changes_along_it() -> None:
    rng = np.random.default_rng(2)
    line = wire(60.0, slope=0.1)
    dark, bright = picture(rng, [(line, -40.0)], 0.5), picture(rng, [(line, 30.0)], 0.5)
    image = np.where(np.arange(400) < 190, dark, bright).astype(np.uint8)
    profile = straighten(peeled(image, [line]), line.pixels, line.normal, np.arange(-8.0, 9.0))
    for part in (profile[:170], profile[210:]):
        mean = part.mean(axis=0)
        assert np.ptp(mean - np.polyval(np.polyfit(np.arange(17), mean, 1), np.arange(17))) < 3.0


def test_where_wires_cross_the_one_that_is_kept_stays() -> None:
    rng = np.random.default_rng(3)
    own, other = wire(60.0), wire(60.0, slope=0.06)
    bare = peeled(picture(rng, [(own, -30.0), (other, -30.0)], 1.0), [other], [own])
    alone = picture(rng, [(own, -30.0)], 1.0)
    contrast, there = (localise(each, own.pixels, own.normal, WIDTH, 3.0, 20.0).contrast for each in (bare, alone))
    assert np.median(contrast) == pytest.approx(np.median(there), rel=0.05)
    assert (contrast < 0.5 * np.median(there)).all()


def test_steep_wires_are_taken_out_too() -> None:
    rng = np.random.default_rng(4)
    line = wire(60.0)
    image = np.ascontiguousarray(picture(rng, [(line, -40.0)], 0.5).T)
    pixels = np.ascontiguousarray(line.pixels[::-1, ::-1])
    steep = Line(pixels, normals(pixels), line.width)
    left = straighten(peeled(image, [steep]), steep.pixels, steep.normal, np.arange(-2.0, 3.0)).mean(axis=0)
    assert abs(left[2] - 0.5 * (left[0] + left[4])) < 2.0


def test_a_wire_partly_out_of_the_picture_is_no_error() -> None:
    image = picture(np.random.default_rng(5), [], 1.0)
    for height in (-3.0, 0.0, 119.0, 400.0):
        assert peeled(image, [wire(height)]).shape == image.shape
    assert peeled(image, []) is image


def test_how_far_a_line_lies_aside() -> None:
    own, other = wire(60.0, bend=0.0), wire(64.0, slope=0.02, bend=0.0)
    away, nearest = aside(own.pixels, own.normal, other.pixels, 10.0)
    assert np.allclose(np.abs(away), np.abs(4.0 + 0.02 * (U - 200)), atol=1e-6)
    assert (np.abs(nearest - np.arange(len(U))) <= 8).all()
    assert np.isnan(aside(own.pixels, own.normal, other.pixels + np.array([0, 30]), 10.0)[0]).all()


def test_a_wire_taken_out_hides_only_what_merges_with_it_and_makes_the_rest_less_sure() -> None:
    own, other = wire(60.0, bend=0.0), wire(60.0, slope=0.04, bend=0.0)
    track = Track(
        np.linspace(0, 1, len(U)), own.pixels, own.normal, own.width, arc_length(own.pixels), np.zeros((1, len(U)))
    )
    index = np.arange(len(U))
    gap = np.abs(0.04 * (U - 200))
    taken = Neighbour(other.pixels, WIDTH, np.full(len(U), 0.2))
    hidden = others_near(track, index, [taken], np.full(len(U), 6.0))
    assert hidden[gap < 2].all()
    assert not hidden[gap > 4].any()
    assert others_near(track, index, [Neighbour(other.pixels, WIDTH)], np.full(len(U), 6.0))[gap < 5].all()
    unsure = pulled(track, index, [taken])
    assert unsure[(gap > 2.6) & (gap < 3)].min() > 0.05
    assert unsure[gap > 7.5].max() < 0.01


def test_what_a_wire_taken_out_leaves_is_no_surer_along_all_of_another_than_at_one_place() -> None:
    own, other = wire(60.0, bend=0.0), wire(63.0, bend=0.0)
    track = Track(
        np.linspace(0, 1, len(U)), own.pixels, own.normal, own.width, arc_length(own.pixels), np.zeros((1, len(U)))
    )
    taken = Neighbour(other.pixels, WIDTH, np.full(len(U), 0.2))
    one, few, many = (pulled(track, np.linspace(50, 340, n).astype(int), [taken]) for n in (1, 4, 64))
    assert 0.02 < one[0] < 0.1
    for several in (few, many):
        assert 1 / np.sqrt(np.sum(several**-2)) == pytest.approx(one[0], rel=0.02)
