"""The exact curves against published values, physics and symmetry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sagnode.geometry.conductor import conductor_points, gravity_direction
from sagnode.scene.catenary import (
    Load,
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


@settings(deadline=None)
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


def chain(
    span: float, rise: float, tension: float, state: WireState, links: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes of a chain of so many equal links, weights at its nodes, that is in equilibrium between A and B.

    The horizontal force is ``tension`` (in weights of a metre of bare wire) in every link; the vertical force steps by
    the weight of each node, which is a link's, and of the ice or weight that is there. The links' length and the force
    in the first are found by Newton's method, so that the chain ends at B.
    """

    def hang(link: float, force: float) -> NDArray[np.float64]:
        nodes = np.zeros((links + 1, 2))
        for k in range(links):
            x, y = nodes[k]
            pull = math.hypot(tension, force)
            nodes[k + 1] = x + link * tension / pull, y + link * force / pull
            at = nodes[k + 1, 0] / span
            force += link
            for load in state.loads:
                if isinstance(load, PartialLoad):
                    force += link * load.ratio * (load.start <= at < load.end)
                else:
                    force += load.share * span * (x / span < load.at <= at)
        return nodes

    link, force = 1.002 * math.hypot(span, rise) / links, -0.5 * span
    for _ in range(40):
        end = hang(link, force)[-1]
        miss = end - [span, rise]
        steps = (1e-6 * link, 1e-4)
        slope = np.column_stack(
            [(hang(link + steps[0], force)[-1] - end) / steps[0], (hang(link, force + steps[1])[-1] - end) / steps[1]]
        )
        step = np.linalg.solve(slope, -miss)
        link, force = link + step[0], force + step[1]
        if np.abs(miss).max() < 1e-9:
            break
    nodes = hang(link, force)
    return nodes[:, 0], nodes[:, 1]


@pytest.mark.parametrize("rise", [0.0, 25.0])
@pytest.mark.parametrize(
    "loads",
    [
        (PartialLoad(0.55, 0.95, 1.2),),
        (PointLoad(0.3, 0.12),),
        (PartialLoad(0.0, 0.4, 0.5), PartialLoad(0.3, 0.7, 0.8), PointLoad(0.8, 0.05)),
    ],
    ids=["ice", "weight", "both"],
)
def test_an_unevenly_loaded_wire_hangs_as_a_chain_of_links(rise: float, loads: tuple[Load, ...]) -> None:
    span, state = 270.0, WireState(9.0, loads=loads)
    x, y = chain(span, rise, constant_of_state(span, rise, state), state, 1500)
    below = profile(span, rise, state, x / span)
    # a chain of 1500 links lets a load begin up to a link (0.18 m) beside its place
    np.testing.assert_allclose(x / span * rise - y, below, atol=0.02)
    assert np.interp(0.5, x / span, x / span * rise - y) == pytest.approx(9.0, abs=0.015)


def test_a_loaded_wire_satisfies_its_differential_equation() -> None:
    """H y'' = w(x) sqrt(1 + y'^2) on every stretch, and the slope is continuous where the load only begins."""
    span, rise, state = 269.7, 20.0, WireState(10.0, loads=(PartialLoad(0.25, 0.6, 1.4),))
    x = S * span
    y = S * rise - profile(span, rise, state, S)
    slope = np.gradient(y, x, edge_order=2)
    bend = np.gradient(slope, x, edge_order=2)
    weight = 1.0 + 1.4 * ((S > 0.25) & (S < 0.6))
    expected = weight * np.sqrt(1 + slope**2) / constant_of_state(span, rise, state)
    smooth = np.ones(len(S), bool)
    for edge in (0.0, 0.25, 0.6, 1.0):
        smooth &= np.abs(S - edge) > 0.003
    np.testing.assert_allclose(bend[smooth], expected[smooth], rtol=2e-5)
    assert np.abs(np.diff(slope)).max() < 1.1 * bend[smooth].max() * (x[1] - x[0])


def test_a_shallow_loaded_wire_hangs_as_its_moment_diagram() -> None:
    """M(x)/H of a simply supported beam, which a cable becomes when it is nearly straight."""
    loads = (PartialLoad(0.1, 0.5, 0.9), PointLoad(0.7, 0.1))
    state = WireState(0.5, loads=loads)
    weight = 1.0 + 0.9 * ((S > 0.1) & (S < 0.5))
    shear = np.concatenate([[0.0], np.cumsum((weight[1:] + weight[:-1]) / 2 * np.diff(S))]) + 0.1 * (S >= 0.7)
    area = np.concatenate([[0.0], np.cumsum((shear[1:] + shear[:-1]) / 2 * np.diff(S))])
    moment = S * area[-1] - area
    np.testing.assert_allclose(profile(300.0, 0.0, state, S), 0.5 * moment / moment[1000], atol=6e-4)


def test_a_load_without_weight_changes_nothing() -> None:
    state = WireState(8.0, 12.0, (PartialLoad(0.2, 0.9, 0.0), PointLoad(0.5, 0.0)))
    np.testing.assert_allclose(profile(270.0, -20.0, state, S), profile(270.0, -20.0, WireState(8.0), S), atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(
    start=st.floats(0.0, 0.6),
    length=st.floats(0.05, 0.4),
    ratio=st.floats(0.0, 4.0),
    at=st.floats(0.05, 0.95),
    share=st.floats(0.0, 0.5),
    sag_ratio=st.floats(0.005, 0.1),
    slope=st.floats(-0.3, 0.3),
)
def test_any_load_keeps_ends_and_stated_sag(
    start: float, length: float, ratio: float, at: float, share: float, sag_ratio: float, slope: float
) -> None:
    state = WireState(sag_ratio * 200.0, loads=(PartialLoad(start, start + length, ratio), PointLoad(at, share)))
    below = profile(200.0, slope * 200.0, state, np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(below, [0.0, state.sag_m, 0.0], atol=1e-6)


def test_ice_over_the_whole_span_is_a_uniform_load_again() -> None:
    whole = WireState(8.0, loads=(PartialLoad(0.0, 1.0, 0.7),))
    np.testing.assert_allclose(profile(270.0, 3.0, whole, S), profile(270.0, 3.0, WireState(8.0), S), atol=1e-9)
    assert constant_of_state(270.0, 3.0, whole) == pytest.approx(1.7 * catenary_constant(270.0, 3.0, 8.0))
