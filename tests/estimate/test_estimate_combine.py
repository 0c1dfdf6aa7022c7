"""Combining the frames of a burst, with numbers that are worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sagnode.estimate.combine import combine_burst
from sagnode.measurement import ConductorMeasurement, FrameMeasurement
from sagnode.message import Estimate
from sagnode.quality import Cause, Reason, Validity


def seen(sag: float, u: float = 0.02, noise: float = 0.01, validity: Validity = Validity.GOOD) -> FrameMeasurement:
    estimates = {"sag": Estimate(sag, u, sag - 2 * u, sag + 2 * u)}
    return FrameMeasurement("L1", "a", validity, (), "m", estimates, {"sag": {"pixel noise": noise}})


def refused(cause: Cause) -> FrameMeasurement:
    return FrameMeasurement("L1", "a", Validity.INVALID, (Reason(cause, str(cause)),), "m")


def combined(*frames: FrameMeasurement) -> ConductorMeasurement:
    (one,) = combine_burst([[frame] for frame in frames])
    return one


def test_one_frame_is_what_it_was() -> None:
    one = combined(seen(8.0))
    assert (one.estimates["sag"].value, one.estimates["sag"].u) == (8.0, 0.02)
    assert (one.frames_used, one.frames_rejected) == (1, 0)


def test_the_surveys_errors_stay_and_the_scatter_averages_out() -> None:
    one = combined(seen(8.00), seen(8.02), seen(8.04))
    # the frames' standard deviation is 0.02: hypot(0.02, 0.02/√3)
    assert one.estimates["sag"].value == pytest.approx(8.02)
    assert one.estimates["sag"].u == pytest.approx(0.023094, abs=1e-6)
    assert one.estimates["sag"].hi - one.estimates["sag"].value == pytest.approx(1.96 * 0.023094, abs=1e-4)
    assert one.validity is Validity.GOOD


def test_a_frame_far_from_the_others_is_left_out_and_the_disagreement_told() -> None:
    one = combined(*(seen(sag) for sag in (8.00, 8.01, 8.02, 8.01, 9.50)))
    assert one.estimates["sag"].value == pytest.approx(8.01)
    assert (one.frames_used, one.frames_rejected) == (4, 1)
    assert one.validity is Validity.QUESTIONABLE
    assert [reason.cause for reason in one.reasons] == [Cause.FRAMES_DISAGREE]


def test_the_most_frequent_reason_speaks_for_a_burst_that_is_mostly_refused() -> None:
    dark, fog = refused(Cause.DARK), refused(Cause.LOW_CONTRAST)
    one = combined(seen(8.0), fog, dark, fog)
    assert one.validity is Validity.INVALID
    assert [reason.cause for reason in one.reasons] == [Cause.LOW_CONTRAST]
    assert one.estimates == {} and one.budget == {}
    assert (one.frames_used, one.frames_rejected) == (0, 4)


def test_what_only_some_frames_tell_the_burst_does_not() -> None:
    uneven = seen(8.01)
    uneven = replace(uneven, estimates={**uneven.estimates, "load_skew": Estimate(0.2, 0.05, 0.1, 0.3)})
    assert set(combined(uneven, uneven).estimates) == {"sag", "load_skew"}
    # whichever of them lies nearest to the middle
    for frames in ((seen(8.0), uneven, seen(8.02)), (uneven, seen(8.0), uneven)):
        assert set(combined(*frames).estimates) == {"sag"}


def test_half_of_the_frames_are_enough_and_the_worse_judgement_counts() -> None:
    one = combined(seen(8.0), seen(8.01, validity=Validity.QUESTIONABLE), refused(Cause.DARK), refused(Cause.DARK))
    assert one.estimates["sag"].value == pytest.approx(8.005)
    assert one.validity is Validity.QUESTIONABLE
    assert (one.frames_used, one.frames_rejected) == (2, 2)


def test_conductors_keep_their_order_and_do_not_mix() -> None:
    first, second = combine_burst([[seen(8.0), seen(3.0)], [seen(8.02), seen(3.02)]])
    assert first.estimates["sag"].value == pytest.approx(8.01)
    assert second.estimates["sag"].value == pytest.approx(3.01)
