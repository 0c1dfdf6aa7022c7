"""The statistics behind docs/accuracy.md, on outcomes whose errors are known."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from sagnode.message import Estimate
from sagnode.quality import Validity

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
tally = pytest.importorskip("tally")


def one(value, truth, u=0.1, validity=Validity.GOOD):
    estimate = Estimate(value, u, value - 1.96 * u, value + 1.96 * u)
    return tally.Outcome("g", "f", 0, "L1", "m", validity, "", {"sag": estimate}, {"sag": truth})


def refused():
    return tally.Outcome("g", "f", 0, "L1", "m", Validity.INVALID, "dark: too dark", {}, {"sag": 8.0})


def test_errors_are_estimate_minus_truth_and_refusals_count_only_as_refusals():
    row = tally.statistics([one(8.1, 8.0), one(8.3, 8.0, validity=Validity.QUESTIONABLE), refused()], "sag")
    assert (row.good, row.questionable, row.invalid, row.told) == (1, 1, 1, 2)
    assert row.bias == pytest.approx(0.2)
    assert row.rmse == pytest.approx(math.sqrt((0.01 + 0.09) / 2))
    assert row.bias_rel == pytest.approx(0.2 / 8)
    assert row.coverage == 0.5
    assert row.half_width == pytest.approx(0.196)
    assert row.worst_z == pytest.approx(3.0)


def test_normal_errors_are_covered_as_often_as_stated():
    rng = np.random.default_rng(1)
    row = tally.statistics([one(8 + 0.1 * e, 8.0) for e in rng.standard_normal(4000)], "sag")
    assert row.coverage == pytest.approx(0.95, abs=0.011)
    assert row.z_rms == pytest.approx(1.0, abs=0.04)


def test_nothing_told_has_no_statistics():
    assert tally.statistics([refused()], "sag") is None


def test_an_error_where_certainty_was_claimed_is_without_end():
    assert tally.statistics([one(8.1, 8.0, u=0.0)], "sag").worst_z == math.inf
    assert tally.statistics([one(8.0, 8.0, u=0.0)], "sag").worst_z == 0.0


@pytest.mark.parametrize(("value", "shown"), [(8.123, "+12.3 cm"), (8.0012, "+1.20 mm")])
def test_lengths_are_told_in_a_fitting_unit(value, shown):
    assert shown in tally.table_line("sag", tally.statistics([one(value, 8.0)], "sag"))
