"""The curve of an uncalibrated fit."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.fit.curve import Curve, Prior, adjust, shares

FLAT = Curve(np.array([[0.0, 0.0], [400.0, 160.0], [800.0, 20.0]]), 1.2)


@settings(deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.6, 3.5))
def test_shares_sum_to_one(t: float, weight: float) -> None:
    share = shares(np.array([t]), weight)
    assert np.isclose(share.sum(), 1)
    assert (share >= 0).all()


@settings(max_examples=25, deadline=None)
@given(st.floats(-40, 40), st.floats(20, 200), st.floats(0.5, 8.0))
def test_the_picture_of_a_parabola_in_space_is_the_rational_bezier(x: float, depth: float, ratio: float) -> None:
    near, far = np.array([x, -5.0, depth]), np.array([-x / 2, -3.0, depth * ratio])
    handle = 0.5 * (near + far) + (0, 8.0, 0)
    t = np.linspace(0, 1, 50)[:, None]
    space = (1 - t) ** 2 * near + 2 * t * (1 - t) * handle + t**2 * far
    control = np.stack([1000 * p[:2] / p[2] for p in (near, handle, far)])
    # outer weights are made 1 by a change of the parameter, which leaves the curve as it is
    weight = handle[2] / np.sqrt(near[2] * far[2])
    s = np.sqrt(far[2] / near[2])
    u = (t * s / (1 - t + t * s))[:, 0]
    assert np.allclose(Curve(control, float(weight)).conic(u), 1000 * space[:, :2] / space[:, 2:], atol=1e-6)


def test_points_are_equally_spaced() -> None:
    _, pixels = FLAT.evenly(60)
    steps = np.hypot(*np.diff(pixels, axis=0).T)
    assert steps.std() < 0.005 * steps.mean()


def test_adjusting_reaches_the_curve_that_was_measured() -> None:
    wanted = Curve(FLAT.control + np.array([[0, 3.0], [20.0, -15.0], [0, -2.0]]), 1.25)
    prior = Prior(wanted.control[[0, 2]], 2.0, weight_spread=0.5)
    curve = FLAT
    fraction = np.linspace(0.01, 0.99, 80)
    dense = wanted.evenly(4000)[1]
    for _ in range(8):
        _, pixels = curve.evenly(800)
        tangent = np.gradient(pixels, axis=0)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
        index = np.rint(fraction * 799).astype(int)
        offset = []
        for point, across in zip(pixels[index], normal[index], strict=True):
            away = dense - point
            nearest = np.argmin(np.abs(away @ np.array([across[1], -across[0]])))
            offset.append(away[nearest] @ across)
        curve, _ = adjust(curve, fraction, np.array(offset), np.full(80, 100.0), prior)
    far = [np.min(np.hypot(*(dense - point).T)) for point in curve.evenly(60)[1]]
    assert max(far) < 0.2


def test_moving_a_curve_there_and_back_changes_nothing() -> None:
    there = FLAT.moved(np.array([30.0, 40.0]), 0.5)
    back = there.moved(-np.array([30.0, 40.0]) * 0.5, 2.0)
    assert np.allclose(back.control, FLAT.control)
