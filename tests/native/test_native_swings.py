"""The compiled sum over explanations of a picture against the one in NumPy, which says what it means."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.estimate.swings import GRID, _summed
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


def question(seed, count):
    """Explanations of swings that are known to minutes of arc or hardly at all, some of them next to impossible."""
    rng = np.random.default_rng(seed)
    level, swing = rng.normal(0, 10.0 ** rng.uniform(-1, 2), count), rng.normal(0, 0.3, count)
    common = rng.uniform(0.01, 0.3) * GRID[: int(rng.integers(1, len(GRID) + 1))]
    return level, swing, 10.0 ** rng.uniform(-9, 0, count), common, 1e-6 + (0.1 * common) ** 2


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 100))
def test_the_sum_is_that_of_numpy(seed, count):
    asked = question(seed, count)
    np.testing.assert_allclose(_summed(*asked), in_numpy(lambda: _summed(*asked)), rtol=1e-13, atol=1e-13)


def test_arrays_that_do_not_fit_are_refused():
    good = [np.zeros(2), np.zeros(2), np.ones(2), np.zeros(5), np.ones(5), np.zeros(5)]
    kernels.sum_explanations(*good)
    for k in range(6):
        with pytest.raises(ValueError, match="do not fit"):
            kernels.sum_explanations(*good[:k], np.ones(3), *good[k + 1 :])
    with pytest.raises(ValueError, match="do not fit"):
        kernels.sum_explanations(*[np.zeros(0)] * 3, *good[3:])
    with pytest.raises(TypeError, match="swing"):
        kernels.sum_explanations(good[0], np.zeros(2, dtype=np.float32), *good[2:])
    with pytest.raises(ValueError, match="six"):
        kernels.sum_explanations(*good[:-1])
