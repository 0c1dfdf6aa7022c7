"""The compiled response against the one in NumPy, which says what it means."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sagnode.match.ribbon import NO_BAND, pooled_response
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


def question(seed):
    """A picture, and curves in and around it."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers(2, 90, 2)
    image = rng.integers(0, 256, (height, width), dtype=np.uint8)
    rows, columns, lines = rng.integers(1, 9), rng.integers(1, 200), rng.integers(1, 5)
    u, v = (rng.uniform(-20, end + 20, (rows, columns)).astype(np.float32) for end in (width, height))
    angle = rng.uniform(0, 2 * np.pi, (rows, columns))
    normal = (np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32))
    places = rng.uniform(-4, 4, (lines, rows, columns)).astype(np.float32)
    sides = rng.uniform(1, 6, (lines, 1, columns)).astype(np.float32)
    band = rng.uniform(-3, 3, (rng.integers(1, 6), rows)).astype(np.float32) if seed % 2 else NO_BAND
    if seed % 3 == 0:
        # a thin line whose sides are whole steps of the band away
        step = rng.uniform(0.5, 2.0, (1, rows, 1)).astype(np.float32)
        places, sides = (
            np.zeros((1, 1, 1), dtype=np.float32),
            step * rng.integers(1, 3, (1, rows, 1)).astype(np.float32),
        )
        band = (np.arange(-2.0, 3.0)[:, None] * step[0, :, 0]).astype(np.float32)
    return image, (u, v), normal, (places, sides), band


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
@example(843)
def test_the_response_is_that_of_numpy(seed):
    asked = question(seed)
    best, seen = pooled_response(*asked)
    expected, expected_seen = in_numpy(pooled_response, *asked)
    np.testing.assert_array_equal(seen, expected_seen)
    # on the edge of two grid points the two may round apart: by 1/32 px, between pixels that differ by up to 255
    np.testing.assert_allclose(best[seen].astype(int), expected[seen].astype(int), atol=1 + 255 / 32)
    assert np.count_nonzero(best[seen] != expected[seen]) <= max(1, 0.01 * np.count_nonzero(seen))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sums_are_those_of_the_responses(seed):
    image, pixel, normal, lines, band = question(seed)
    weight = np.random.default_rng(seed).uniform(0, 1, len(pixel[0])).astype(np.float32)
    total, weights = np.empty((2, pixel[0].shape[1]))
    kernels.response_sums(image, *pixel, *normal, *lines, band, weight, total, weights)
    best, seen = pooled_response(image, pixel, normal, lines, band)
    np.testing.assert_allclose(total, (weight.astype(float)[:, None] * np.where(seen, best, 0)).sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(weights, weight.astype(float) @ seen, atol=1e-9)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, -1e30])
def test_places_that_are_nowhere_are_not_in_the_frame(value):
    image = np.full((20, 30), 100, dtype=np.uint8)
    u = np.full((1, 3), value, dtype=np.float32)
    v, zero, one = (np.full((1, 3), each, dtype=np.float32) for each in (10.0, 0.0, 1.0))
    side = np.full((1, 1, 3), 2.5, dtype=np.float32)
    _, seen = pooled_response(image, (u, v), (zero, one), (side * 0, side), NO_BAND)
    assert not seen.any()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({0: np.zeros((20, 30))}, TypeError, "image"),
        ({1: np.zeros((2, 4), dtype=np.float32)}, ValueError, "shape"),
        ({0: np.zeros((1, 30), dtype=np.uint8)}, ValueError, "image"),
        ({7: np.zeros((1, 2), dtype=np.float32)}, ValueError, "band"),
        ({8: np.zeros((1, 4), dtype=np.int16)}, ValueError, "best"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change, error, words):
    single = np.zeros((1, 3), dtype=np.float32)
    line = np.zeros((1, 1, 3), dtype=np.float32)
    asked = [np.zeros((20, 30), dtype=np.uint8), single, single, single, single, line, line, NO_BAND]
    asked += [np.zeros((1, 3), dtype=np.int16), np.zeros((1, 3), dtype=bool)]
    for place, other in change.items():
        asked[place] = other
    with pytest.raises(error, match=words):
        kernels.response(*asked)
