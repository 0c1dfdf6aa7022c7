"""Reported quantities against hand-made cases, brute force and published state-change results."""

import numpy as np
import pytest

from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import Shape, Stringing, clearance_place_u, conductor_temperature, quantities

FLAT = GroundProfile(np.array([0.0, 300.0]), np.array([0.0, 0.0]), np.empty((0, 3)), 0.05)


def test_level_span_without_wind() -> None:
    shape = Shape(np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 20.0]), 6.0)
    q = quantities(shape, FLAT, unit_weight_n_m=10.0)
    for stem in ("sag", "inplane_sag", "midspan_sag", "drop"):
        assert q[stem] == pytest.approx(6.0, abs=1e-6)
    assert q["lowest_height"] == pytest.approx(14.0, abs=1e-6)
    assert q["clearance"] == pytest.approx(14.0, abs=1e-6)
    assert q["lowest_along"] == pytest.approx(100.0, abs=1e-3)
    assert q["swing"] == q["blowout"] == 0.0
    # H = w L²/8D + w D/6 to second order
    assert q["tension"] == pytest.approx(10 * 200**2 / 48 + 10.0, rel=1e-3)


def test_unequal_supports_of_the_field_span() -> None:
    # L = 269.7 m, h = 0.83 m, H/w = 1200 m: sag 7.5849, lowest support to lowest point 7.1756, low point at 131.165 m
    shape = Shape(np.array([0.0, 0.0, 15.0]), np.array([0.0, 269.7, 15.83]), 7.584897)
    q = quantities(shape, FLAT)
    assert q["sag"] == pytest.approx(7.5849, abs=1e-4)
    assert 15.0 - q["lowest_height"] == pytest.approx(7.1756, abs=1e-4)
    assert q["lowest_along"] == pytest.approx(131.165, abs=5e-3)
    assert q["catenary_constant"] == pytest.approx(1200.0, abs=0.01)


def test_swung_conductor_hangs_higher_and_aside() -> None:
    shape = Shape(np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 20.0]), 6.0, np.radians(30.0))
    q = quantities(shape, FLAT, unit_weight_n_m=10.0)
    assert q["inplane_sag"] == pytest.approx(6.0, abs=1e-6)
    assert q["sag"] == pytest.approx(6.0 * np.cos(np.radians(30.0)), abs=1e-6)
    assert q["blowout"] == pytest.approx(3.0, abs=1e-6)
    assert q["swing"] == pytest.approx(30.0)
    # the wind's pull adds to the weight: H is that of w/cos(swing)
    assert q["tension"] == pytest.approx(10.0 / np.cos(np.radians(30.0)) * q["catenary_constant"])


def test_least_clearance_is_found_at_an_obstacle_and_not_at_mid_span() -> None:
    ground = GroundProfile(
        np.array([0.0, 60.0, 300.0]), np.array([0.0, 5.0, 0.0]), np.array([[150.0, 151.0, 9.0]]), 0.05
    )
    shape = Shape(np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 20.0]), 6.0)
    q = quantities(shape, ground)
    assert 150.0 <= q["clearance_along"] <= 151.0
    height = shape.points(np.linspace(0, 1, 100_001))
    at = np.interp(150.0, height[:, 1], height[:, 2])
    assert q["clearance"] == pytest.approx(at - 9.0, abs=1e-4)
    assert q["midspan_clearance"] == pytest.approx(14.0 - np.interp(100.0, ground.along, ground.height), abs=1e-5)


def test_flat_ground_leaves_the_place_of_least_clearance_open_and_a_hill_does_not() -> None:
    shape = Shape(np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 20.0]), 6.0)
    hill = GroundProfile(
        np.array([0.0, 90.0, 100.0, 110.0, 300.0]), np.array([0.0, 0, 5, 0, 0]), np.empty((0, 3)), 0.05
    )
    # 6 m of sag over 200 m rises by a decimetre within 13 m of the lowest point
    assert 3.0 < clearance_place_u(shape, FLAT) < 13.0
    assert clearance_place_u(shape, hill) < 0.5


# ASTER600 (S 600.4 mm², E 60 GPa, α 23e-6, w 17.658 N/m), strung at 15 °C with H/w = 1200 m over 269.7 m and 0.83 m;
# H/w at 40, 60, 80 °C as mechaphlowers' BalanceEngine solves it
@pytest.mark.parametrize(("temperature", "constant"), [(40, 1075.74), (60, 998.30), (80, 934.60)])
def test_temperature_of_the_state_change(temperature: float, constant: float) -> None:
    stringing = Stringing(15.0, 1200.0 * 17.658, 600.4e-6 * 60e9, 23e-6)
    assert conductor_temperature(269.7, 0.83, constant, 17.658, stringing) == pytest.approx(temperature, abs=0.1)
