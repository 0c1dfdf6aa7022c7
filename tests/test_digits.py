"""How many digits of a length are written: enough to tell an interval's ends apart, and never more than 0.1 mm."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sagnode.digits import decimals
from sagnode.message import Estimate


@pytest.mark.parametrize(
    ("width", "digits"), [(3.0, 2), (0.2, 2), (0.08, 3), (0.0036, 4), (1e-6, 4), (0.0, 4), (math.inf, 2), (math.nan, 2)]
)
def test_two_significant_digits_of_the_width_between_centimetres_and_tenths_of_a_millimetre(
    width: float, digits: int
) -> None:
    assert decimals(width) == digits


@given(st.floats(-50, 50), st.floats(0.002, 5.0))
def test_the_ends_of_an_interval_are_written_apart(value: float, width: float) -> None:
    estimate = Estimate(value, width / 4, value - width / 2, value + width / 2)
    texts = {f"{x:.{estimate.decimals}f}" for x in (estimate.lo, estimate.value, estimate.hi)}
    assert len(texts) == 3
