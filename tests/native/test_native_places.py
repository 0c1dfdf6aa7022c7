"""The compiled family of curves against the one in NumPy, which says what it means."""

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.geometry.camera import Intrinsics, Pose, rotation_from_angles
from sagnode.match.family import Family
from sagnode.match.templates import View
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")
LENSES = {
    "perfect": {},
    "pinhole": {"distortion": (-0.2, 0.05, 1e-3, -5e-4, 0.01)},
    "rational": {"distortion": (0.1, 0.02, 0.0, 0.0, 0.01, 0.15, 0.01, 0.001)},
    "fisheye": {"distortion": (0.02, -0.01, 0.002, 0.0), "model": "fisheye"},
}


def both_ways(family, *asked, **of):
    return family.placed(*asked, **of), in_numpy(family.placed, *asked, **of)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(LENSES)))
def test_places_are_those_of_numpy(seed, lens):
    rng = np.random.default_rng(seed)
    glass = Intrinsics(1456, 1088, 1500.0, 1490.0, 730.0, 540.0, **LENSES[lens])
    # now and then the conductor passes beside or behind the camera
    pose = Pose(rotation_from_angles(*rng.uniform((-60, -20, -5), (60, 10, 5))), np.array([rng.uniform(-9, 9), 0, 3.0]))
    near, far = np.array([0.0, rng.uniform(-20, 40), 12.0]), np.array([rng.uniform(-40, 40), 250.0, 15.0])
    t = np.sort(rng.uniform(0, 1, rng.integers(3, 70)))
    family = Family.of(View(glass, pose, near, far, 0.03), (2.0, 12.0), t)
    first = rng.integers(0, len(t) - 1)
    part = np.arange(first, rng.integers(first + 1, len(t) + 1))
    compiled, in_numpy = both_ways(
        family, glass, part, rng.uniform(2, 12, (7, 1)), rng.uniform(-0.5, 0.5, (1, rng.integers(1, 40)))
    )
    seen = (in_numpy[0] > 0) & (in_numpy[0] < 1456) & (in_numpy[1] > 0) & (in_numpy[1] < 1088)
    for own, other in zip(compiled[:2], in_numpy[:2], strict=True):
        np.testing.assert_allclose(own[seen], other[seen], atol=2e-3)
        np.testing.assert_array_equal(own == -1e4, other == -1e4)
    np.testing.assert_allclose(compiled[4], in_numpy[4], rtol=1e-5)
    # where two samples are one pixel there is no direction
    steps = np.hypot(*np.gradient(np.stack(in_numpy[:2]), axis=1)) if len(part) > 1 else np.zeros(seen.shape)
    clear = seen & (steps > 1.0)
    for own, other in zip(compiled[2:4], in_numpy[2:4], strict=True):
        np.testing.assert_allclose(own[clear], other[clear], atol=5e-3)


@pytest.mark.parametrize("steps", [None, np.array([0.0, 0.3, 0.5, 0.8, 1.3, 2.0], dtype=np.float32)])
def test_sides_are_those_of_numpy(steps):
    glass = Intrinsics(1456, 1088, 1500.0, 1490.0, 730.0, 540.0)
    pose = Pose(rotation_from_angles(0.0, -3.0, 0.0), np.array([2.0, 0.0, 8.0]))
    view = View(glass, pose, np.array([0.0, 4.0, 12.0]), np.array([0.0, 250.0, 15.0]), 0.03)
    family = Family.of(view, (2.0, 12.0), np.linspace(0.02, 0.9, 6))
    grid = (np.linspace(2, 12, 9)[:, None], np.linspace(-0.2, 0.2, 5)[None])
    compiled, in_numpy = both_ways(family, glass, np.arange(6), *grid, width=0.03 * 1500.0, step=steps)
    assert np.ptp(in_numpy[4]) > 0.5
    # a side on the edge between two numbers of steps may go either way
    same = np.isclose(compiled[4], in_numpy[4], rtol=1e-4)
    assert same.mean() > 0.97


def test_shapes_that_do_not_fit_are_refused():
    single = np.zeros(4, dtype=np.float32)
    grid = np.zeros((2, 4), dtype=np.float32)
    lens, chord, turn = np.zeros(17), np.zeros((4, 3), dtype=np.float32), np.zeros((3, 3), dtype=np.float32)
    steps = single[:2].copy()
    asked = [chord, single, single, turn, lens, single, single, single, 0, 0.0, steps, *(grid.copy() for _ in range(5))]
    kernels.places(*asked)
    wrong = ((8, 3), (8, -1), (4, np.zeros(13)), (10, single), (15, grid[:, :3].copy()), (1, single[:3].copy()))
    for place, other in wrong:
        with pytest.raises(ValueError, match=r"places|lens"):
            kernels.places(*asked[:place], other, *asked[place + 1 :])
