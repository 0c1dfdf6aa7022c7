"""The last look at a number before it is believed."""

from datetime import UTC, datetime

import pytest

from sagnode.daemon.stamp import Stamp
from sagnode.message import Estimate, Identity
from sagnode.quality import Cause, Reason, Validity
from sagnode.worker.protocol import ConductorResult, MeasureReply

STAMP = Stamp(Identity(utility="u", line="l", span="s", unit="n"), {"L1": "a"}, "m", "cfg", "1.0", "boot", True)
GOOD = {"sag": Estimate(8.0, 0.01, 7.98, 8.02), "clearance": Estimate(7.0, 0.1, 6.8, 7.2)}


def stamped(**fields):
    result = ConductorResult(**{"conductor": "L1", "validity": "good", "method": "x", "estimates": GOOD, **fields})
    reply = MeasureReply(
        id=1,
        acquired_at=datetime(2026, 6, 1, tzinfo=UTC),
        monotonic_s=5.0,
        camera="c",
        results=(result,),
        elapsed_s=0.1,
        memory_mb=50,
    )
    (reading,) = STAMP.reply(reply, clock_synced=False, calibration_id="cal")
    return reading


def test_a_good_reading_bears_everything():
    reading = stamped(visible_share=0.8, frames_used=3)
    assert reading.sag_m == 8.0
    assert reading.clearance_lo == 6.8
    assert reading.phase == "a"
    assert reading.quality.test
    assert reading.clock_synced is False
    assert reading.calibration_id == "cal"
    assert reading.frames_used == 3


def test_an_invalid_one_never_bears_numbers_whatever_the_worker_sent():
    reading = stamped(validity="invalid")
    assert reading.quality.validity is Validity.INVALID
    assert reading.sag_m is None
    assert reading.clearance_hi is None


@pytest.mark.parametrize(
    "estimates",
    [
        {},
        {"clearance": GOOD["clearance"]},
        {"sag": Estimate(8.0, 0.01, 8.1, 8.2)},
        {"sag": Estimate(8.0, 0.01, 7.9, 7.95)},
        {"sag": Estimate(8.0, -0.01, 7.9, 8.1)},
        {**GOOD, "swing": Estimate(1.0, 0.1, 2.0, 0.0)},
    ],
)
def test_contradictions_become_invalid_with_the_reason(estimates):
    reading = stamped(estimates=estimates)
    assert reading.quality.validity is Validity.INVALID
    assert reading.quality.reasons[0].cause is Cause.WORKER_GARBAGE
    assert reading.sag_m is None


def test_impossible_figures_become_invalid():
    reading = stamped(visible_share=1.7)
    assert reading.quality.reasons[0].cause is Cause.WORKER_GARBAGE
    assert "visible_share" in reading.quality.reasons[0].text
    assert stamped(visible_share=1.7, validity="invalid").quality.validity is Validity.INVALID


def test_a_refusal_names_its_reason_for_every_conductor():
    (reading,) = STAMP.refusal(
        Reason(Cause.DEADLINE, "too slow"),
        at=datetime(2026, 6, 1, tzinfo=UTC),
        monotonic_s=1.0,
        clock_synced=True,
        calibration_id="cal",
    )
    assert reading.quality.validity is Validity.INVALID
    assert reading.quality.reasons[0].text == "too slow"
    assert reading.method == "m"
