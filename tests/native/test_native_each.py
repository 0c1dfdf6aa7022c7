"""The compiled solutions of many small systems against those in NumPy, which say what they mean."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.estimate.steps import solved_each
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


def systems(seed, count, width, columns):
    """Equations whose unknowns differ in size by up to twelve orders of magnitude."""
    rng = np.random.default_rng(seed)
    parts = rng.standard_normal((count, width + 3, width))
    size = 10.0 ** rng.uniform(-6, 6, (count, width))
    matrices = np.swapaxes(parts, 1, 2) @ parts + np.eye(width)
    return matrices * size[:, :, None] * size[:, None, :], rng.standard_normal((count, width, columns)) * size[
        ..., None
    ]


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(1, 20), st.integers(1, 3))
def test_the_solutions_are_those_of_numpy(seed, count, width, columns):
    asked = systems(seed, count, width, columns)
    (found, spread), (expected, expected_spread) = solved_each(*asked), in_numpy(lambda: solved_each(*asked))
    scale = np.sqrt(np.diagonal(asked[0], axis1=1, axis2=2))[..., None]
    np.testing.assert_allclose(found * scale, expected * scale, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(spread, expected_spread, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(asked[0] @ expected, asked[1], atol=1e-6 * (1 + np.abs(asked[1]).max(initial=0.0)))


@pytest.mark.parametrize("wrong", [-1.0, 0.0, np.nan])
def test_what_is_not_positive_definite_has_no_solution_and_spoils_no_other(wrong):
    matrices, right = systems(1, 3, 5, 2)
    matrices[1, 4, 4] = wrong * matrices[1, 4, 4]
    for way in (lambda call: call(), in_numpy):
        found, spread = way(lambda: solved_each(matrices, right))
        assert np.isnan(found[1]).all()
        assert np.isnan(spread[1])
        assert np.isfinite(found[[0, 2]]).all()
        assert np.isfinite(spread[[0, 2]]).all()


def test_arrays_that_do_not_fit_are_refused():
    good = [np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3, 1)), np.zeros((2, 3, 1)), np.zeros(2)]
    kernels.solve_each(*good)
    for k, wrong in [
        (0, np.zeros((2, 3, 4))),
        (1, np.zeros((2, 4, 1))),
        (1, np.zeros((1, 3, 1))),
        (2, np.zeros((2, 3, 2))),
        (3, np.zeros(3)),
    ]:
        with pytest.raises(ValueError, match="do not fit"):
            kernels.solve_each(*good[:k], wrong, *good[k + 1 :])
    with pytest.raises(TypeError, match="right"):
        kernels.solve_each(good[0], np.zeros((2, 3, 1), dtype=np.float32), *good[2:])
    with pytest.raises(ValueError, match="four"):
        kernels.solve_each(*good[:-1])
