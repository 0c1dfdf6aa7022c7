"""The compiled products of rows under a shared error against those in NumPy, which say what they mean."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st
from solving import hanging, question

from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.joint import solve
from sagnode.estimate.shared import GRID, evidence_of_sharing
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 80))
def test_the_evidence_is_that_of_numpy(seed, count):
    survey, theta, curve = hanging(np.random.default_rng(seed), 0.03, count=count)
    solution = solve(survey, theta, CameraKnowledge(np.zeros((10, 10)), np.zeros(10)), curve)
    found, expected = (way(lambda: evidence_of_sharing(survey, solution)) for way in (lambda call: call(), in_numpy))
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-6)


def test_arrays_that_do_not_fit_are_refused():
    *_, curve = question(2, count=12)
    rows, count = np.zeros((12, 3)), len(GRID)
    good = [np.ones(12), curve.sigma, np.ones(12), rows, GRID, np.zeros((count, 3, 3)), np.zeros(count)]
    kernels.shared_products(*good)
    for k, wrong in [
        (0, np.ones(11)),
        (1, np.ones(13)),
        (2, np.ones(1)),
        (3, np.zeros((11, 3))),
        (4, np.zeros((count, 3))),
        (5, np.zeros((count, 3, 2))),
        (6, np.zeros(count - 1)),
    ]:
        with pytest.raises(ValueError, match="do not fit"):
            kernels.shared_products(*good[:k], wrong, *good[k + 1 :])
    with pytest.raises(TypeError, match="kept"):
        kernels.shared_products(np.ones(12, dtype=np.float32), *good[1:])
    with pytest.raises(ValueError, match="seven"):
        kernels.shared_products(*good[:-1])
