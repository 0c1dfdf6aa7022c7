"""Odds of a change of temperature: densities against numbers worked out by hand, and the laws that they obey."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import NormalDist

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.trend.odds import TAU_S, Change, normal, odds_of_mistake, reached, thermal_density

SIZES = st.floats(0.0, 200.0)
SPANS_OF_TIME = st.floats(1.0, 1e5)


@pytest.mark.parametrize("x", [0.0, -0.3, 4.0])
def test_the_normal_density_is_that_of_the_standard_library(x: float) -> None:
    assert normal(x, 1.7) == pytest.approx(NormalDist(0.0, 1.7).pdf(x), rel=1e-12)


def test_a_time_constant_later_63_per_cent_are_reached() -> None:
    assert reached(TAU_S) == pytest.approx(0.632121, abs=1e-6)
    assert reached(0.0) == reached(-5.0) == 0.0
    assert reached(1e6) == 1.0


def test_five_minutes_without_a_change() -> None:
    # half a time constant: share 0.393469, spreads hypot(2.36082, 0.1) and hypot(7.86939, 0.1), one step in fifty
    assert thermal_density(Change(0.0, 0.1, 300.0)) == pytest.approx(0.98 * 0.168833 + 0.02 * 0.050691, rel=1e-4)


def test_what_heat_cannot_do_only_the_readings_own_uncertainty_explains() -> None:
    # in a minute the largest step of 80 K gives 7.613 K; 10 K are 2.387 K beyond, six standard uncertainties
    beyond, limit = (thermal_density(Change(kelvin, 0.4, 60.0)) for kelvin in (10.0, 7.613))
    assert beyond / limit == pytest.approx(math.exp(-0.5 * (2.387 / 0.4) ** 2), rel=0.02)


@settings(deadline=None)
@given(SIZES, st.floats(0.05, 20.0), SPANS_OF_TIME)
def test_heating_is_as_likely_as_cooling_and_less_likely_the_more(kelvin: float, u: float, after_s: float) -> None:
    change = Change(kelvin, u, after_s)
    assert thermal_density(change) == thermal_density(replace(change, kelvin=-kelvin))
    assert thermal_density(replace(change, kelvin=kelvin + 1.0)) <= thermal_density(change)


@pytest.mark.parametrize("after_s", [60.0, 900.0, 7200.0])
def test_the_density_is_one_of_probability(after_s: float) -> None:
    step = 0.05
    whole = step * sum(thermal_density(Change(step * k, 0.5, after_s)) for k in range(-6000, 6001))
    assert whole == pytest.approx(1.0, abs=1e-3)


@settings(deadline=None)
@given(SIZES, st.floats(0.05, 20.0), SPANS_OF_TIME, SIZES)
def test_company_never_makes_a_change_likelier_than_heat_does(
    kelvin: float, u: float, after_s: float, other: float
) -> None:
    change = Change(kelvin, u, after_s)
    alone = odds_of_mistake([(change, [])], 100.0)
    assert odds_of_mistake([(change, [replace(change, kelvin=other)])], 100.0) >= alone * (1 - 1e-9)


def test_a_change_that_no_other_conductor_shares_is_a_mistake_sooner() -> None:
    change, still = Change(15.0, 0.5, 900.0), Change(0.0, 0.5, 900.0)
    odds = odds_of_mistake([(change, [still, still])], 100.0)
    assert odds > 10 * odds_of_mistake([(change, [change, change])], 100.0)


def test_an_older_reading_vouches_where_the_newest_was_the_mistake() -> None:
    leap, back = Change(-40.0, 0.5, 300.0), Change(0.5, 0.5, 600.0)
    assert odds_of_mistake([(leap, [])], 100.0) > 1
    assert odds_of_mistake([(leap, []), (back, [])], 100.0) < 0.1


def test_a_mistake_is_the_less_likely_the_wider_it_may_lie() -> None:
    since = [(Change(9.0, 0.5, 300.0), [])]
    assert odds_of_mistake(since, 50.0) == pytest.approx(4 * odds_of_mistake(since, 200.0))
