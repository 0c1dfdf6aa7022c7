"""What the demonstration makes of readings and truth."""

import json
from datetime import UTC, datetime, timedelta

import pytest
from readings import reading

from sagnode.demo.results import Truth, best_frame, delivery, join, read_truth, readings_summary, score, summary
from sagnode.message import QualityMessage
from sagnode.quality import Cause, Reason, Validity

NOON = datetime(2026, 6, 21, 12, tzinfo=UTC)
NONE = dict.fromkeys(("sag_m", "sag_u", "sag_lo", "sag_hi"))


def at(sequence, hour, conductor="L1", **fields):
    return reading(sequence, conductor, acquired_at=NOON + timedelta(hours=hour), **fields)


def invalid(sequence, hour):
    quality = QualityMessage.of(Validity.INVALID, (Reason(Cause.DARK, "night"),))
    return at(sequence, hour, quality=quality, **NONE)


def test_truth_is_read_and_foreign_files_are_passed_over(tmp_path):
    document = {"time": "2026-06-21T12:00:00Z", "conductors": {"L1": {"sag_m": 8.1, "clearance_m": 7.0}}}
    (tmp_path / "a.json").write_text(json.dumps(document))
    (tmp_path / "b.json").write_text("[1, 2")
    (tmp_path / "c.json").write_text('{"time": 3}')
    assert read_truth(tmp_path) == {(NOON, "L1"): Truth(8.1, 7.0)}


def test_scores():
    truth = {(NOON + timedelta(hours=h), "L1"): Truth(8.0 + e, 7.0) for h, e in enumerate((0.01, -0.01, 0.3))}
    points = join([at(1, 0), at(2, 1), at(3, 2), at(3, 2), invalid(4, 3)], truth)
    assert [p.reading.sequence for p in points] == [1, 2, 3, 4]
    result = score(points, "sag")
    assert result.count == 3
    assert result.covered == 2
    assert result.rmse == pytest.approx(((0.01**2 + 0.01**2 + 0.3**2) / 3) ** 0.5)
    assert score(points, "clearance") is None


def test_lost_and_repeated():
    sent = delivery([1, 2, 3, 4], [1, 2, 2, 4])
    assert sent.lost == (3,)
    assert sent.repeated == (2,)


def test_summary_says_it_all():
    points = join([at(1, 0), invalid(2, 1)], {(NOON, "L1"): Truth(8.0, 7.0)})
    text = "\n".join(summary(points, delivery([1, 2], [1, 2])))
    assert "2 readings of 2 frames: 1 good, 0 questionable, 1 invalid" in text
    assert "dark (1)" in text
    assert "RMSE 0.0 cm" in text
    assert "2 in the journal, 0 lost, 0 repeated" in text


def test_readings_that_are_invalid_for_two_reasons_are_counted_under_both_and_said():
    both = (Reason(Cause.LANDMARKS_LOST, "0 of 10"), Reason(Cause.DARK, "night"))
    twice = at(3, 2, quality=QualityMessage.of(Validity.INVALID, both), **NONE)
    lines = readings_summary(join([invalid(1, 0), invalid(2, 1), twice], {}))
    assert lines[1] == "invalid because of dark (3), landmarks-lost (1); 1 of them for more than one of these"
    assert readings_summary(join([invalid(1, 0)], {}))[1] == "invalid because of dark (1)"


def test_the_frame_to_show_has_most_good_readings():
    points = join([at(1, 0), at(2, 1, "L1"), at(3, 1, "L2"), invalid(4, 2)], {})
    assert best_frame(points) == NOON + timedelta(hours=1)
    assert best_frame(join([invalid(1, 0)], {})) is None
