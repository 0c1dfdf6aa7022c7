"""Measuring across a curve, compiled, against the same in NumPy, which says what it means."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.match import localise
from sagnode.match.localise import localise_beside
from sagnode.match.ribbon import normals
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


def question(seed):
    """A picture, and a curve through it that may leave it; one wire or several."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers(*((2, 100), (100, 400))[seed % 4 > 0], 2)
    image = rng.integers(0, 256, (height, width), dtype=np.uint8)
    image = image if seed % 3 else image.astype(np.float32) + rng.uniform(0, 1, image.shape).astype(np.float32)
    count = int(rng.integers(2, 600))
    along = np.linspace(0, 1, count)
    pixels = np.stack([width * along + rng.uniform(-10, 10), height * (0.5 + 0.3 * np.sin(3 * along))], axis=1)
    pixels = pixels if seed % 5 else pixels[:, ::-1]
    wires = int(rng.integers(1, 5))
    apart = (np.arange(wires)[:, None] - (wires - 1) / 2) * rng.uniform(1, 12) + rng.uniform(-3, 3) * (seed % 2)
    members = apart + np.zeros((wires, count)) if wires > 1 else None
    half_range = rng.uniform(0, 8) if seed % 2 else rng.uniform(0, 8, count)
    shifts = rng.uniform(-40, 40, rng.integers(0, 9))
    return (image, pixels, normals(pixels), rng.uniform(0.1, 9), half_range, shifts, rng.uniform(3, 40)), members


@settings(max_examples=120, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_blocks_are_those_of_numpy(seed):
    asked, members = question(seed)
    more = {"members": members, "exact": seed % 7 > 0}
    found, expected = localise_beside(*asked, **more), in_numpy(localise_beside, *asked, **more)
    # of a place that is a tie, or on the edge of the range, either answer is right
    same = (found[0].valid == expected[0].valid) & ~(np.abs(found[0].offset - expected[0].offset) > 0.25)
    assert np.mean(same) > 0.9
    for name in ("index", "arc", "offset", "snr", "correlation", "contrast"):
        mine, theirs = getattr(found[0], name)[same], getattr(expected[0], name)[same]
        np.testing.assert_allclose(mine, theirs, rtol=1e-3, atol=1e-3, err_msg=name)
    # its neighbours' windows have a share in a block's uncertainty
    alike = np.isclose(found[0].sigma, expected[0].sigma, rtol=1e-3, equal_nan=True)
    assert np.mean(alike[same]) > 0.8 if (~same).any() else alike.all()
    np.testing.assert_array_equal(found[1].inside, expected[1].inside)
    assert (
        np.mean(np.isclose(found[1].snr, expected[1].snr, rtol=1e-3, atol=1e-3)) > 0.99 if found[1].snr.size else True
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-300])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_curves_that_go_nowhere_show_nothing(value, kind):
    image = np.random.default_rng(0).integers(0, 256, (60, 90)).astype(kind)
    pixels = np.stack([np.linspace(10, 80, 71), np.full(71, 30.0)], axis=1)
    for part in range(2):
        curve, normal = pixels.copy(), normals(pixels)
        (curve, normal)[part][:, part] = value
        arc = np.arange(71.0)
        with np.errstate(all="ignore"), pytest.MonkeyPatch.context() as patch:
            patch.setattr(localise, "arc_length", lambda _, arc=arc: arc)
            blocks, beside = localise_beside(image, curve, normal, 2.0, 4.0, [20.0, -20.0])
        if abs(value) > 1 or part == 0:
            assert not blocks.valid.any()
            assert np.isnan(blocks.offset).all()
        assert np.isfinite(beside.snr).all()


def arguments():
    pixels = np.stack([np.linspace(10, 50, 41), np.full(41, 30.0)], axis=1)
    starts, centres = np.array([0, 20]), np.array([0, 30])
    asked = [np.zeros((60, 80), dtype=np.uint8), pixels, normals(pixels), np.ones(41), np.full(41, 3.0)]
    asked += [np.zeros((1, 41)), starts, centres, 0.9, 3.0, True]
    return [
        *asked,
        np.empty((localise.ROWS, 2)),
        np.empty(2, dtype=bool),
        np.empty((1, 2)),
        np.empty((1, 2), dtype=bool),
    ]


@pytest.mark.parametrize(
    ("place", "other", "error", "words"),
    [
        (0, np.zeros((60, 80)), TypeError, "image"),
        (0, np.zeros((1, 80), dtype=np.uint8), ValueError, "image"),
        (0, np.zeros((60, 160), dtype=np.uint8)[:, ::2], ValueError, "image"),
        (1, np.zeros((41, 3)), ValueError, "length"),
        (3, np.ones(40), ValueError, "length"),
        (3, np.full(41, np.nan), ValueError, "finite"),
        (4, np.full(41, np.inf), ValueError, "finite"),
        (4, np.full(41, 1e9), ValueError, "range"),
        (5, np.zeros((65, 41)), ValueError, "members"),
        (6, np.array([0, 41]), ValueError, "starts"),
        (6, np.array([20, 0]), ValueError, "starts"),
        (6, np.array([-1, 20]), ValueError, "starts"),
        (7, np.array([0, 10**9]), ValueError, "shift"),
        (7, np.array([0]), ValueError, "beside"),
        (9, np.nan, ValueError, "margin"),
        (11, np.empty((5, 2)), ValueError, "blocks"),
        (12, np.empty(3, dtype=bool), ValueError, "valid"),
    ],
)
def test_what_does_not_fit_is_refused(place, other, error, words):
    asked = arguments()
    kernels.localise(*asked)
    asked[place] = other
    with pytest.raises(error, match=words):
        kernels.localise(*asked)
