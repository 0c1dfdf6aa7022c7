"""One load on one stretch of a span as terms of an uneven load, against its density and its bending moment."""

import numpy as np
import pytest
from numpy.polynomial import legendre

from sagnode.geometry.conductor import finer_load_shapes, load_shapes
from sagnode.geometry.single_load import single_load_terms


@pytest.mark.parametrize(("share", "place", "length"), [(0.3, 0.4, 0.5), (0.1, 0.8, 0.2), (0.5, 0.5, 1.0)])
def test_terms_are_those_of_the_density(share: float, place: float, length: float) -> None:
    x, weight = legendre.leggauss(2000)
    loaded = np.abs(0.5 * (x + 1) - place) < 0.5 * length
    density = 1 - share + share / length * loaded
    k = np.arange(1, 11)
    projected = (2 * k + 1) / 2 * (legendre.legvander(x, 10)[:, 1:].T @ (weight * density))
    np.testing.assert_allclose(single_load_terms(share, place, length, 10), projected, atol=3e-3)


def test_a_weight_makes_a_kink_where_it_hangs() -> None:
    s, place, share = np.linspace(0.0, 1.0, 201), 0.3, 0.1
    shapes = np.concatenate([load_shapes(s, 1), finer_load_shapes(s, 2, 80)])
    uneven = single_load_terms(share, place, 0.005, 80) @ shapes
    # statics: the bending moment of a point load in place of as much of an even one, over an eighth
    moment = np.minimum(s, place) * (1 - np.maximum(s, place)) - 0.5 * s * (1 - s)
    np.testing.assert_allclose(uneven, 8 * share * moment, atol=1.5e-3)


def test_many_loads_at_once_equal_one_by_one() -> None:
    share, place, length = np.array([0.1, 0.2, 0.4]), np.array([0.3, 0.5, 0.6]), np.array([0.01, 0.3, 0.5])
    many = single_load_terms(share, place, length, 10)
    assert many.shape == (3, 10)
    for row, one in zip(many, zip(share, place, length, strict=True), strict=True):
        np.testing.assert_allclose(row, single_load_terms(*one, 10))
