"""Masking and judging blocks, compiled, against the same in NumPy, which says what it means."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.match import masks, sight, standing
from sagnode.match.localise import Beside, Blocks
from sagnode.match.ribbon import arc_length, normals
from sagnode.match.track import Track
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


def polyline(rng, count):
    """A smooth curve across some hundred pixels; it may turn back."""
    along = np.linspace(0, rng.uniform(0.3, 4), count)
    return np.stack([300 + 250 * np.sin(along), 200 + rng.uniform(5, 150) * np.cos(2 * along)], axis=1)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_what_runs_near_is_what_numpy_finds(seed):
    rng = np.random.default_rng(seed)
    pixels = polyline(rng, int(rng.integers(2, 300)))
    normal, reach = normals(pixels), rng.uniform(1, 30, len(pixels))
    other = polyline(rng, int(rng.integers(1, 900))) + rng.uniform(-20, 20, 2)
    other[rng.uniform(size=len(other)) < 0.1 * (seed % 3)] = np.nan
    asked = (pixels[::3], normal[::3], other, reach[::3])
    np.testing.assert_array_equal(masks.near(*asked), in_numpy(masks.near, *asked))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_where_a_curve_folds_back_is_where_numpy_finds_it(seed):
    rng = np.random.default_rng(seed)
    pixels = polyline(rng, int(rng.integers(16, 1500)))
    count = len(pixels)
    track = Track(np.arange(count), pixels, normals(pixels), np.ones(count), arc_length(pixels), np.zeros((1, count)))
    index = np.sort(rng.integers(0, count, 50))
    asked = (track, index, rng.uniform(1, 40, 50))
    np.testing.assert_array_equal(masks.folds_back(*asked), in_numpy(masks.folds_back, *asked))


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_blocks_stand_out_where_they_do_in_numpy(seed):
    rng = np.random.default_rng(seed)
    count, places = int(rng.integers(1, 60)), int(rng.integers(2, 9))
    valid = rng.uniform(size=count) < 0.9
    offset = np.where(valid, rng.normal(0, (0.2, 1.0)[seed % 2], count), np.nan)
    snr = np.where(valid, rng.uniform(0, 30, count), 0.0)
    arc = np.cumsum(rng.uniform(4, 20, count))
    empty = np.zeros(count)
    blocks = Blocks(empty, arc, offset, np.where(valid, 0.1, np.nan), snr, empty, empty, valid, empty)
    beside = Beside(np.round(rng.uniform(0, 12, (places, count)), seed % 3), rng.uniform(size=(places, count)) < 0.9)
    half_range = rng.choice([1.0, 3.0], count) if seed % 5 else np.full(count, 3.0)
    asked = (blocks, beside, rng.uniform(size=count) < 0.2, half_range, 3.0, int(rng.integers(0, 5)))
    found, expected = standing.stand_out(*asked), in_numpy(standing.stand_out, *asked)
    for name in ("offset", "sigma", "rank"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, err_msg=name)
    np.testing.assert_array_equal(found.usable, expected.usable)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_points_that_are_nowhere_are_near_nothing(value):
    pixels = np.stack([np.arange(20.0), np.zeros(20)], axis=1)
    nowhere = np.full((20, 2), value)
    reach = np.full(20, 5.0)
    assert not masks.near(nowhere, normals(pixels), pixels, reach).any()
    assert not masks.near(pixels, normals(pixels), nowhere, reach).any()
    assert not masks.near(pixels, np.full((20, 2), np.nan), pixels, reach).any()
    assert not masks.near(pixels, normals(pixels), np.empty((0, 2)), reach).any()


def test_what_does_not_fit_is_refused():
    pixels, reach, masked = np.zeros((4, 2)), np.zeros(4), np.zeros(4, dtype=bool)
    index = np.zeros(4, dtype=np.int64)
    with pytest.raises(ValueError, match="length"):
        kernels.near_polyline(pixels, pixels[:3], reach, pixels, masked)
    with pytest.raises(TypeError, match="masked"):
        kernels.near_polyline(pixels, pixels, reach, pixels, reach)
    for wrong in (-1, 4):
        with pytest.raises(ValueError, match="index"):
            kernels.folds_back(pixels, pixels, reach, index + wrong, reach, 1, masked)
    with pytest.raises(ValueError, match="length"):
        kernels.folds_back(pixels, pixels, reach, index, reach, 0, masked)
    block, beside = [np.zeros(4) for _ in range(4)], np.zeros((2, 4))
    asked = [*block, masked, beside, beside > 0, masked, reach, 3.0, 2, reach.copy(), reach.copy(), reach.copy()]
    kernels.stand_out(*asked, masked.copy())
    with pytest.raises(ValueError, match="length"):
        kernels.stand_out(*asked, np.zeros(5, dtype=bool))
    with pytest.raises(ValueError, match="two places"):
        kernels.stand_out(*asked[:5], beside[:1], beside[:1] > 0, *asked[7:], masked.copy())


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_windows_stand_out_where_they_do_in_numpy(seed):
    rng = np.random.default_rng(seed)
    rows, count = int(rng.choice([1, 5, 7, 8, 35])), int(rng.integers(1, 300))
    response = rng.integers(-24, 25, (rows, count)).astype(np.float32)
    response[0] += rng.integers(0, 12)
    gone = rng.integers(0, count + 1, 2)
    response[rng.uniform(size=rows) < 0.3, gone.min() : gone.max()] = np.nan
    arc = np.cumsum(rng.uniform(0.5, 4, count))
    t = np.linspace(0.1, rng.uniform(0.1, 1), count)[:: (1, -1)[seed % 2]]
    asked = (response, np.ascontiguousarray(t), arc)
    found, expected = sight.compared(*asked), in_numpy(sight.compared, *asked)
    assert found.score == pytest.approx(expected.score, rel=1e-6)
    assert (found.judged, found.outstanding) == (expected.judged, expected.outstanding)
    np.testing.assert_array_equal(found.seen, expected.seen)


def test_curves_that_do_not_fit_are_refused():
    line, seen = np.zeros(4), np.zeros(4, dtype=bool)
    kernels.sight(np.zeros((3, 4), dtype=np.float32), line, line, seen)
    for shape in ((0, 4), (257, 4), (3, 5)):
        with pytest.raises(ValueError, match="response"):
            kernels.sight(np.zeros(shape, dtype=np.float32), line, line, seen)
    with pytest.raises(TypeError, match="response"):
        kernels.sight(np.zeros((3, 4)), line, line, seen)
