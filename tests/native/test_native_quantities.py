"""The compiled quantities of shapes against those in NumPy, which say what they mean."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import Shape, clearance_place_u, quantities, quantities_of_many
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


def question(seed):
    """Some shapes about one span, and ground with steps and obstacles below it."""
    rng = np.random.default_rng(seed)
    count, length = rng.integers(1, 8), rng.uniform(20, 600)
    near = np.array([0.0, 0.0, 30.0]) + rng.normal(0, 0.1, (count, 3))
    far = length * np.array([np.sin(seed), np.cos(seed), rng.uniform(-0.2, 0.2)]) + rng.normal(0, 0.1, (count, 3))
    sag = length * rng.uniform(0.002, 0.08, count)
    load = rng.normal(0, 0.1, (count, rng.integers(1, 11))) if seed % 3 == 0 else ()
    # whole metres now and then, where a sample of the curve may be; never two heights at one place
    along = np.unique(np.round(rng.uniform(-10, 1.1 * length, rng.integers(1, 9)), 0 if seed % 2 else 6))
    start = rng.uniform(0, length, rng.integers(0, 4))
    obstacles = np.stack([start, start + rng.uniform(0, 9, len(start)), rng.uniform(0, 20, len(start))], axis=1)
    ground = GroundProfile(along, rng.uniform(0, 9, len(along)), obstacles, rng.choice([0.0, 0.05, 0.5]))
    return Shape(near, far, sag, rng.normal(0, 0.5, count), load), ground


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_quantities_are_those_of_numpy(seed):
    shape, ground = question(seed)
    found, expected = quantities_of_many(shape, ground, 10.0), in_numpy(lambda: quantities_of_many(shape, ground, 10.0))
    assert list(found) == list(expected)
    for stem, value in expected.items():
        # a place of an extreme is where a slope is nothing: half the digits
        tolerance = 1e-4 if stem.endswith("_along") else 1e-8
        np.testing.assert_allclose(found[stem], value, rtol=tolerance, atol=tolerance, err_msg=stem)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_uncertainty_of_the_place_is_that_of_numpy(seed):
    many, ground = question(seed)
    load = np.asarray(many.load)
    shape = Shape(many.near[0], many.far[0], many.sag[0], many.swing[0], load[0] if load.ndim == 2 else ())
    expected = in_numpy(lambda: clearance_place_u(shape, ground))
    assert clearance_place_u(shape, ground) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -3.0, 1e300])
@pytest.mark.parametrize("place", range(5))
def test_shapes_that_are_none_answer_something(place, value):
    ground = GroundProfile(np.array([0.0, 50.0]), np.array([0.0, 1.0]), np.array([[20.0, 25.0, 9.0]]), 0.1)
    parts = [np.array([0.0, 0.0, 20.0]), np.array([0.0, 100.0, 20.0]), 3.0, 0.1, (0.1, 0.2)]
    parts[place] = np.full(3, value) if place < 2 else (value, 0.0) if place == 4 else value
    found = quantities(Shape(*parts), ground)
    clearance_place_u(Shape(*parts), ground)
    if np.isnan(value):
        assert np.isnan(found["sag"])
        assert np.isnan(found["clearance"])


@pytest.mark.parametrize(
    ("place", "other", "words"),
    [
        (0, np.zeros((2, 2)), "near"),
        (2, np.zeros(3), "near"),
        (4, np.zeros((3, 1)), "load"),
        (5, np.zeros(1), "two parameters"),
        (6, np.zeros(0), "along"),
        (8, np.zeros((2, 2)), "obstacles"),
        (9, np.zeros((9, 2)), "result"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(place, other, words):
    asked = [np.zeros((2, 3)), np.ones((2, 3)), np.ones(2), np.zeros(2), np.zeros((1, 0)), np.linspace(0, 1, 9)]
    asked += [np.zeros(1), np.zeros(1), np.zeros((0, 3)), np.zeros((10, 2))]
    kernels.quantities(*asked)
    asked[place] = other
    with pytest.raises(ValueError, match=words):
        kernels.quantities(*asked)
