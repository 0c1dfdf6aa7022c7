"""The compiled pictures of conductors against those in NumPy, which say what they mean."""

from dataclasses import replace

import numpy as np
import pytest
from both_ways import in_numpy
from hypothesis import given, settings
from hypothesis import strategies as st
from solving import LENSES

from sagnode.geometry import camera
from sagnode.geometry.camera import Pose, rotation_from_angles
from sagnode.geometry.conductor import conductor_points
from sagnode.match.templates import View, visible_part
from sagnode.match.track import trace
from sagnode.native import kernels

pytestmark = pytest.mark.skipif(kernels is None, reason="the extension was not built here")


def view(seed, lens="pinhole"):
    """A camera near a span, looking along it, across it, or away, and a sag and a swing."""
    rng = np.random.default_rng(seed)
    near, far = np.array([0.0, 0.0, 30.0]), np.array([0.0, rng.uniform(30, 500), rng.uniform(10, 60)])
    place = np.array([rng.uniform(-40, 40), rng.uniform(-30, 60), rng.uniform(2, 35)])
    pose = Pose(rotation_from_angles(rng.uniform(-180, 180) if seed % 5 == 0 else rng.uniform(-40, 40), 0, 3), place)
    load = tuple(rng.normal(0, 0.2, rng.integers(1, 11))) if seed % 3 == 0 else ()
    sag = rng.uniform(0.001, 0.08) * far[1]
    return View(LENSES[lens], pose, near, far, 0.03, load), sag, rng.normal(0, 0.4)


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_pixels_and_depths_are_those_of_numpy(lens, seed):
    own, sag, swing = view(seed, lens)
    t = np.linspace(0, 1, 97)
    pixels, depth = own.pixels(sag, swing, t)
    expected, expected_depth = in_numpy(lambda: own.pixels(sag, swing, t))
    np.testing.assert_allclose(depth, expected_depth, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(pixels, expected, rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("shape", [(), (7,), (2, 5), (0,)])
def test_points_are_projected_as_in_numpy(lens, shape):
    own, sag, swing = view(3, lens)
    points = own.pose.position + np.random.default_rng(1).normal(0, 30, (*shape, 3))
    pixels, depth = camera.project(own.intrinsics, own.pose, points)
    expected, expected_depth = in_numpy(lambda: camera.project(own.intrinsics, own.pose, points))
    np.testing.assert_allclose(pixels, expected, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(depth, expected_depth, rtol=1e-9, atol=1e-9)
    if not shape:
        t = np.linspace(0, 1, 21)
        space = conductor_points(own.near, own.far, sag, swing, t, own.load)
        expected = in_numpy(lambda: conductor_points(own.near, own.far, sag, swing, t, own.load))
        np.testing.assert_allclose(space, expected, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-50, 50))
def test_the_visible_part_is_that_of_numpy(lens, seed, margin):
    own, sag, swing = view(seed, lens)
    arc, t = visible_part(own, sag, swing, margin)
    expected_arc, expected_t = in_numpy(lambda: visible_part(own, sag, swing, margin))
    assert bool(len(arc)) == bool(len(expected_arc))
    if len(arc):
        # two nodes that are alike but for rounding may be one
        assert arc[-1] == pytest.approx(expected_arc[-1], rel=1e-9, abs=1e-6)
        assert (t[0], t[-1]) == pytest.approx((expected_t[0], expected_t[-1]), abs=1e-9)
        places = np.linspace(0.0, arc[-1], 61)[1:-1] * (1 + 1e-7)
        np.testing.assert_allclose(np.interp(places, arc, t), np.interp(places, expected_arc, expected_t), atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_track_is_that_of_numpy(lens, seed):
    own, sag, swing = view(seed, lens)
    found, expected = trace(own, sag, swing), in_numpy(lambda: trace(own, sag, swing))
    assert (found is None) == (expected is None)
    if found is not None:
        # a length may be rounded to the sample before or after
        if len(found.t) != len(expected.t):
            assert expected.arc[-1] == pytest.approx(round(expected.arc[-1]), abs=1e-6)
            return
        for name in ("t", "pixels", "normal", "width", "arc", "members"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, 0.0, -5.0])
def test_a_curve_that_is_nowhere_is_not_seen(value):
    own, sag, swing = view(1)
    for odd in (replace(own, far=np.full(3, value)), replace(own, near=own.near + value), replace(own, load=(value,))):
        trace(odd, sag, swing)
    for shape in ((value, swing), (sag, value)):
        trace(own, *shape)
    assert trace(replace(own, near=own.near * np.nan), sag, swing) is None
    assert trace(own, np.nan, swing) is None


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({0: np.zeros(16)}, ValueError, "lens"),
        ({1: np.eye(2)}, ValueError, "rotation"),
        ({3: np.zeros(2)}, ValueError, "place"),
        ({5: "much"}, TypeError, "real number"),
        ({7: np.zeros((1, 1))}, TypeError, "load"),
        ({8: np.zeros(3, dtype=np.float32)}, TypeError, "t"),
        ({9: np.zeros((4, 2))}, ValueError, "pixels"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(change, error, words):
    own, sag, swing = view(1)
    asked = [*own.words(sag, swing), np.zeros(3), np.zeros((3, 2)), np.zeros(3)]
    for place, other in change.items():
        asked[place] = other
    with pytest.raises(error, match=words):
        kernels.curve_pixels(*asked)
