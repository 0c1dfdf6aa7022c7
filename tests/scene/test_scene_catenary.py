"""The exact curves against published values, physics and symmetry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sagnode.geometry.conductor import conductor_points, gravity_direction
from sagnode.scene.catenary import (
    PartialLoad,
    PointLoad,
    WireState,
    catenary_constant,
    constant_of_state,
    profile,
    wire_points,
)

S = np.linspace(0.0, 1.0, 2001)


@pytest.mark.parametrize(
    ("span", "rise", "constant", "chord_sag"),
    [
        # mechaphlowers (RTE, MPL-2.0), its own tests of CatenarySpan, sag to a centimetre
        (497.30361916, 20.70485389, 1200.0, 25.88),
        (297.90642086, 9.38674557, 1200.0, 9.26),
        (400.23314761, -4.90829475, 1200.0, 16.73),
    ],
)
def test_the_constant_agrees_with_published_spans(span: float, rise: float, constant: float, chord_sag: float) -> None:
    found = catenary_constant(span, rise, chord_sag)
    assert found == pytest.approx(constant, rel=0.01 / chord_sag * 1.5)
    assert profile(span, rise, WireState(chord_sag), S).max() == pytest.approx(chord_sag, abs=2e-3)


def test_a_catenary_satisfies_its_differential_equation() -> None:
    """y'' = sqrt(1 + y'^2) / a, which nothing in the module is written from."""
    span, rise, sag = 269.7, 30.0, 12.0
    a = catenary_constant(span, rise, sag)
    x = S * span
    y = S * rise - profile(span, rise, WireState(sag), S)
    slope = np.gradient(y, x, edge_order=2)
    bend = np.gradient(slope, x, edge_order=2)
    inner = slice(5, -5)
    np.testing.assert_allclose(bend[inner], np.sqrt(1 + slope[inner] ** 2) / a, rtol=2e-5)


@given(
    span=st.floats(5, 800),
    sag_ratio=st.floats(0.002, 0.15),
    slope=st.floats(-0.4, 0.4),
    swing=st.floats(-60, 60),
    azimuth=st.floats(0, 2 * math.pi),
)
def test_two_independent_solutions_agree(
    span: float, sag_ratio: float, slope: float, swing: float, azimuth: float
) -> None:
    near = np.array([3.0, -7.0, 20.0])
    far = near + np.array([span * math.sin(azimuth), span * math.cos(azimuth), slope * span])
    sag = sag_ratio * span
    ours = wire_points(near, far, WireState(sag, swing), S[::50])
    theirs = conductor_points(near, far, sag, math.radians(swing), S[::50])
    np.testing.assert_allclose(ours, theirs, atol=1e-6 * span)


def test_swing_is_positive_to_the_right_seen_from_the_near_end() -> None:
    near, far = np.array([0.0, 0.0, 10.0]), np.array([0.0, 100.0, 10.0])
    middle = wire_points(near, far, WireState(3.0, 30.0), np.array([0.5]))[0]
    assert middle == pytest.approx([1.5, 50.0, 10.0 - 3.0 * math.cos(math.radians(30))])
    assert middle - [0, 50, 10] == pytest.approx(3.0 * gravity_direction(near, far, math.radians(30)))


def test_a_point_load_pulls_a_corner_under_it_and_keeps_the_stated_sag() -> None:
    state = WireState(8.0, loads=(PointLoad(0.3, 0.2),))
    below = profile(270.0, 0.0, state, S)
    assert below[1000] == pytest.approx(8.0, abs=1e-9)
    slope = np.gradient(below, S)
    jump = slope[int(0.3 * 2000) - 2] - slope[int(0.3 * 2000) + 2]
    # The slopes on both sides differ by the load over the tension, P/H = share·w·L/H (per unit of the span: times L).
    constant = constant_of_state(270.0, 0.0, state)
    smooth = slope[int(0.7 * 2000) - 2] - slope[int(0.7 * 2000) + 2]
    assert jump - smooth == pytest.approx(0.2 * 270.0**2 / constant, rel=0.02)


def test_ice_on_one_half_moves_the_lowest_point_towards_it() -> None:
    bare = profile(270.0, 0.0, WireState(8.0), S)
    iced = profile(270.0, 0.0, WireState(8.0, loads=(PartialLoad(0.5, 1.0, 1.0),)), S)
    assert abs(S[np.argmax(bare)] - 0.5) < 1e-3
    assert 0.52 < S[np.argmax(iced)] < 0.60
    assert iced[0] == pytest.approx(0.0, abs=1e-9)
    assert iced[-1] == pytest.approx(0.0, abs=1e-9)


def test_ice_over_the_whole_span_is_a_uniform_load_again() -> None:
    whole = WireState(8.0, loads=(PartialLoad(0.0, 1.0, 0.7),))
    np.testing.assert_allclose(profile(270.0, 3.0, whole, S), profile(270.0, 3.0, WireState(8.0), S), atol=1e-9)
    assert constant_of_state(270.0, 3.0, whole) == pytest.approx(1.7 * catenary_constant(270.0, 3.0, 8.0))
