"""The conductor's shape against printed vectors and against a catenary computed from its own equation."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.geometry.conductor import (
    catenary_half_angle,
    conductor_derivatives,
    conductor_points,
    control_points,
    finer_load_shapes,
    gravity_direction,
    load_shapes,
    sag_profile,
)


def mid_sag(span: float, rise: float, constant: float) -> float:
    """Mid-chord sag of y = a cosh(x/a), from the supports' heights, by bisection for the lowest point."""
    low, high = -20 * span, 20 * span
    for _ in range(200):
        x0 = 0.5 * (low + high)
        difference = math.cosh((span - x0) / constant) - math.cosh(-x0 / constant)
        low, high = (x0, high) if constant * difference > rise else (low, x0)
    y = [constant * math.cosh((x - x0) / constant) for x in (0.0, span / 2, span)]
    return 0.5 * (y[0] + y[2]) - y[1]


# chord sag of the spans A-E of mechaphlowers' test_span.py, p = H/w; printed to a centimetre, E by its solver
@pytest.mark.parametrize(
    ("span", "rise", "constant", "chord_sag", "tolerance"),
    [
        (497.30361916, 20.70485389, 1200.0, 25.88, 0.01),
        (297.90642086, 9.38674557, 1200.0, 9.26, 0.01),
        (400.23314761, -4.90829475, 1200.0, 16.73, 0.01),
        (500.0, 150.0, 1800.0, 18.1507, 1e-4),
        (269.7, 0.83, 1200.0, 7.5849, 1e-4),
    ],
)
def test_chord_sag_of_published_spans(
    span: float, rise: float, constant: float, chord_sag: float, tolerance: float
) -> None:
    profile = sag_profile(span, rise, mid_sag(span, rise, constant), np.linspace(0, 1, 4001))
    assert profile.max() == pytest.approx(chord_sag, abs=tolerance)


@settings(deadline=None)
@given(
    span=st.floats(20, 800),
    slope=st.floats(-0.3, 0.3),
    ratio=st.floats(0.002, 0.1),
)
def test_the_constant_gives_the_sag_it_was_solved_for(span: float, slope: float, ratio: float) -> None:
    sag = ratio * span
    constant = span / (2 * float(catenary_half_angle(span, slope * span, sag)))
    assert mid_sag(span, slope * span, constant) == pytest.approx(sag, rel=1e-6)


@settings(deadline=None)
@given(span=st.floats(20, 800), slope=st.floats(-0.3, 0.3), ratio=st.floats(0.002, 0.1))
def test_profile_is_a_catenary_everywhere(span: float, slope: float, ratio: float) -> None:
    sag, rise = ratio * span, slope * span
    s = np.linspace(0, 1, 501)
    below = s * rise - sag_profile(span, rise, sag, s)
    constant = span / (2 * float(catenary_half_angle(span, rise, sag)))
    # y'' = sqrt(1 + y'^2) / a is the catenary's own equation
    h = span / 500
    second = (below[2:] - 2 * below[1:-1] + below[:-2]) / h**2
    first = (below[2:] - below[:-2]) / (2 * h)
    np.testing.assert_allclose(second, np.sqrt(1 + first**2) / constant, rtol=2e-3)


def test_ends_lie_on_the_attachments_and_mid_chord_at_the_sag() -> None:
    near, far = np.array([1.0, 2.0, 30.0]), np.array([5.0, 180.0, 42.0])
    points = conductor_points(near, far, 6.0, 0.3, np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(points[[0, 2]], [near, far], atol=1e-9)
    from_chord = points[1] - 0.5 * (near + far)
    np.testing.assert_allclose(from_chord, 6.0 * gravity_direction(near, far, 0.3), atol=1e-9)


def test_positive_swing_goes_to_the_right_seen_from_the_near_attachment() -> None:
    near, far = np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 20.0])
    middle = conductor_points(near, far, 5.0, np.radians(20.0), np.array([0.5]))[0]
    assert middle[0] == pytest.approx(5.0 * np.sin(np.radians(20.0)))
    assert middle[2] == pytest.approx(20.0 - 5.0 * np.cos(np.radians(20.0)))


def test_parabola_of_the_control_points_is_within_the_known_departure() -> None:
    near, far = np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 25.0])
    t = np.linspace(0, 1, 101)
    a, handle, b = control_points(near, far, 10.0, 0.1)
    bezier = ((1 - t) ** 2)[:, None] * a + (2 * t * (1 - t))[:, None] * handle + (t**2)[:, None] * b
    departure = np.linalg.norm(conductor_points(near, far, 10.0, 0.1, t) - bezier, axis=1).max()
    # sag/span = 5 %: a catenary leaves its parabola by about r²/3 of the sag
    assert 1e-4 < departure < 10.0 * 0.05**2


@pytest.mark.parametrize("term", [1, 2, 3, 4, 6])
def test_terms_of_an_uneven_load_are_its_bending_moments(term: int) -> None:
    """The depth below the chord is the moment of the load on a simple beam, here summed from many small weights."""
    weights = 4000
    place = (np.arange(weights) + 0.5) / weights
    load = np.polynomial.legendre.Legendre.basis(term)(2 * place - 1) / weights
    s = np.linspace(0.0, 1.0, 41)
    # moment at s of a unit weight at a, on a beam of length 1 between supports
    moment = (np.minimum(s[:, None], place) * (1 - np.maximum(s[:, None], place))) @ load
    # an even load of 1 has the moment 1/8 at mid-span, where its depth is D
    np.testing.assert_allclose(load_shapes(s, term)[term - 1], 8 * moment, atol=1e-6)


def test_finer_terms_of_an_uneven_load_continue_the_first_ones() -> None:
    s = np.linspace(0.0, 1.0, 41)
    np.testing.assert_allclose(finer_load_shapes(s, 2, 9), load_shapes(s, 9)[1:], atol=1e-12)
    # the far ones, which powers of x cannot give: what is bent twice is Legendre's polynomial again
    k, fine = 40, np.linspace(0.0, 1.0, 20001)
    bent = finer_load_shapes(fine, k, k)[0]
    curvature = np.diff(bent, 2) / (fine[1] - fine[0]) ** 2 / 4
    legendre = np.polynomial.legendre.legval(2 * fine - 1, [0.0] * k + [1.0])
    np.testing.assert_allclose(curvature, -2 * legendre[1:-1], atol=1e-3)
    np.testing.assert_allclose(bent[[0, -1]], 0.0, atol=1e-15)


def test_first_term_of_an_uneven_load_is_the_skew_of_the_bezier() -> None:
    near, far = np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 25.0])
    t = np.linspace(0, 1, 101)
    a, handle, b = control_points(near, far, 2.0, 0.0, 0.5 + 0.06 / 6)
    bezier = ((1 - t) ** 2)[:, None] * a + (2 * t * (1 - t))[:, None] * handle + (t**2)[:, None] * b
    heights = np.interp(200.0 * t, bezier[:, 1], bezier[:, 2])
    # to first order in the skew: 0.06² of the sag remains, and interpolation
    np.testing.assert_allclose(conductor_points(near, far, 2.0, 0.0, t, [0.06])[:, 2], heights, atol=2e-3)


def test_many_curves_at_once_equal_one_by_one() -> None:
    near, far = np.array([0.0, 0.0, 20.0]), np.array([3.0, 200.0, 25.0])
    sags, swings, t = np.array([3.0, 7.0]), np.array([0.0, -0.2]), np.linspace(0, 1, 7)
    loads = np.array([[0.0, 0.0], [0.2, -0.1]])
    together = conductor_points(near, far, sags, swings, t, loads)
    for i, load in enumerate(loads):
        alone = conductor_points(near, far, sags[i], swings[i], t, load)
        np.testing.assert_allclose(together[i], alone, rtol=1e-12, atol=1e-12)
    shifted = conductor_points(np.stack([near, near + 1.0]), np.stack([far, far]), sags, swings, t)
    np.testing.assert_allclose(shifted[1], conductor_points(near + 1.0, far, 7.0, -0.2, t), rtol=1e-12)


@pytest.mark.parametrize("load", [(), (0.2, -0.1)])
def test_derivatives_equal_differences(load: tuple[float, ...]) -> None:
    own, t = np.array([1.0, -3.0, 20.0, 240.0, 110.0, 34.0, 9.0, 0.35]), np.linspace(0.0, 1.0, 11)

    def points(shape: np.ndarray) -> np.ndarray:
        return conductor_points(shape[:3], shape[3:6], shape[6], shape[7], t, load)

    at, derivatives = conductor_derivatives(own[:3], own[3:6], own[6], own[7], t, load)
    np.testing.assert_allclose(at, points(own), rtol=1e-12)
    for k, step in enumerate(1e-4 * np.eye(8)):
        np.testing.assert_allclose(derivatives[:, :, k], (points(own + step) - points(own - step)) / 2e-4, atol=1e-3)
