"""The statistics behind docs/accuracy.md, on outcomes whose errors are known."""

import math

import numpy as np
import pytest

import tally
from sagnode.message import Estimate
from sagnode.quality import Validity


def one(value, truth, u=0.1, validity=Validity.GOOD, *, limit=0.05, world=0, frame=0, clear=0.9, fair=True):
    return tally.Outcome(
        group="g",
        world=world,
        frame=frame,
        conductor="L1",
        method=tally.OWN,
        validity=validity,
        reasons=(),
        estimates={"sag": Estimate(value, u, value - 1.96 * u, value + 1.96 * u)},
        truth={} if truth is None else {"sag": truth},
        limit={"sag": limit},
        seen={"clear_share": clear},
        fair=fair,
    )


def refused(*, clear=0.9, fair=True, truth=8.0):
    return tally.Outcome(
        group="g",
        world=0,
        frame=0,
        conductor="L1",
        method=tally.OWN,
        validity=Validity.INVALID,
        reasons=("dark", "low-contrast"),
        estimates={},
        truth={"sag": truth} if truth else {},
        seen={"clear_share": clear},
        fair=fair,
    )


def test_errors_are_estimate_minus_truth_and_refusals_have_none():
    row = tally.statistics([one(8.1, 8.0), one(8.3, 8.0, validity=Validity.QUESTIONABLE), refused()], "sag")
    assert row.told == 2
    assert row.bias == pytest.approx(0.2)
    assert row.rmse == pytest.approx(math.sqrt((0.01 + 0.09) / 2))
    assert row.bias_rel == pytest.approx(0.2 / 8)
    assert row.coverage == 0.5
    assert row.half_width == pytest.approx(0.196)
    assert row.worst_z == pytest.approx(3.0)


def test_every_error_is_held_against_the_limit_of_its_own_frame():
    row = tally.statistics([one(8.1, 8.0, limit=0.05), one(8.1, 8.0, limit=0.1)], "sag")
    assert row.to_limit == pytest.approx(math.sqrt((4 + 1) / 2))
    assert row.width_to_limit == pytest.approx((0.196 / 0.1 + 0.196 / 0.2) / 2)
    assert row.limit == pytest.approx(math.sqrt((0.0025 + 0.01) / 2))
    assert row.limit_rel == pytest.approx(row.limit / 8)
    assert row.stated_to_limit == pytest.approx(math.sqrt((4 + 1) / 2))


def test_normal_errors_are_covered_as_often_as_stated():
    rng = np.random.default_rng(1)
    row = tally.statistics([one(8 + 0.1 * e, 8.0, limit=0.1) for e in rng.standard_normal(4000)], "sag")
    assert row.coverage == pytest.approx(0.95, abs=0.011)
    assert row.to_limit == pytest.approx(1.0, abs=0.04)


def test_nothing_told_has_no_statistics():
    assert tally.statistics([refused()], "sag") is None


def test_an_error_where_certainty_was_claimed_is_without_end():
    assert tally.statistics([one(8.1, 8.0, u=0.0)], "sag").worst_z == math.inf
    assert tally.statistics([one(8.0, 8.0, u=0.0)], "sag").worst_z == 0.0


def test_a_reading_is_due_where_half_of_the_span_is_clear_by_day():
    some = [one(8.0, 8.0), refused(), refused(clear=0.49), refused(fair=False)]
    found = tally.answers(some)
    assert (found.good, found.questionable, found.invalid) == (1, 0, 3)
    assert (found.due, found.missed) == (2, 1)
    assert found.refusals == {"dark": 3}
    assert found.missed_because == {"dark": 1}


def test_a_number_without_a_wire_or_far_beyond_its_own_uncertainty_is_false():
    assert one(8.0, None).false
    assert one(8.51, 8.0).false
    assert not one(8.49, 8.0).false
    assert not refused(truth=None).false


def test_a_sequence_shows_what_the_survey_cannot_disturb():
    """Errors of 0.5 and -0.5 m that stay are the survey's; what changes is the reader's."""
    rng = np.random.default_rng(2)
    some = [
        one(8.0 + k + offset + 0.01 * rng.standard_normal(), 8.0 + k, world=world, frame=k)
        for world, offset in enumerate((0.5, -0.5))
        for k in range(2000)
    ]
    found = tally.changes(some)
    assert (found.worlds, found.readings) == (2, 4000)
    assert found.scatter == pytest.approx(0.01, rel=0.05)
    assert found.step == pytest.approx(0.01 * math.sqrt(2), rel=0.05)
    assert tally.changes(some[:1]) is None


def test_chance_moves_the_coverage_of_few_worlds_far():
    assert tally.coverage_by_chance(25) == pytest.approx(0.0854, abs=1e-4)
