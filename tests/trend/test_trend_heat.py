"""Equivalent temperature against the state-change equation solved by other code, with the span's own numbers."""

from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.config.load import load_span
from sagnode.scene.day import sag_at_temperature
from sagnode.trend.heat import SECTION_FACTOR, HeatScale
from sagnode.trend.watch import Watched

SPAN = load_span(Path(str(files("sagnode.demo") / "site" / "span.toml"))).span
L1 = SPAN.conductors[0]


def test_a_difference_of_sag_is_the_difference_of_temperature_that_makes_it():
    scale = Watched.of(L1).scale
    for cold, hot in ((0.0, 30.0), (20.0, 25.0), (10.0, 80.0)):
        kelvin = scale.temperature_k(sag_at_temperature(L1, hot)) - scale.temperature_k(sag_at_temperature(L1, cold))
        # the span is said to move more than it does alone, for it may hang between longer neighbours
        assert kelvin * SECTION_FACTOR == pytest.approx(hot - cold, rel=0.02)


def test_without_stringing_data_a_jump_is_forgiven_more_and_not_less():
    bare = Watched.of(L1.model_copy(update={"stringing": None, "unit_weight_n_m": None})).scale
    known = Watched.of(L1).scale
    assert bare.kelvin_per_m(8.0) < known.kelvin_per_m(8.0)
    assert bare.kelvin_per_m(8.0) > 0.7 * known.kelvin_per_m(8.0)


@settings(deadline=None)
@given(st.floats(20, 600), st.floats(0.005, 0.12), st.floats(-0.3, 0.3))
def test_the_slope_is_the_derivative_and_positive(span, ratio, slope):
    scale = HeatScale(span, slope * span)
    sag, step = ratio * span, 1e-4 * ratio * span
    numeric = (scale.temperature_k(sag + step) - scale.temperature_k(sag - step)) / (2 * step)
    assert scale.kelvin_per_m(sag) == pytest.approx(numeric, rel=1e-5)
    assert scale.kelvin_per_m(sag) > 0
