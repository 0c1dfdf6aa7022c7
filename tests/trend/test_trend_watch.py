"""The watch over readings: what it marks, what it lets pass, and that it forgets nothing at a restart."""

import json
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import reading

from sagnode.config.load import load_span
from sagnode.message import Estimate, QualityMessage, Reading, estimate_fields
from sagnode.quality import Cause, DetailQual, Reason, Validity
from sagnode.scene.day import sag_at_temperature
from sagnode.trend.watch import Trend, Watched

SPAN = load_span(Path(str(files("sagnode.demo") / "site" / "span.toml"))).span
PHASES = [c for c in SPAN.conductors if c.measured]
START = datetime(2026, 6, 21, tzinfo=UTC)


def watch(names=("L1", "L2", "L3"), circuits=None, accept_after_s=1800.0):
    circuits = circuits or {}
    chosen = [c.model_copy(update={"circuit": circuits.get(c.id)}) for c in PHASES if c.id in names]
    return Trend({c.id: Watched.of(c) for c in chosen}, accept_after_s)


def one(conductor, minutes, sag, *, u=0.02, swing=0.0, reasons=(), **fields):
    estimates = {
        "sag": Estimate(sag, u, sag - 2 * u, sag + 2 * u),
        "swing": Estimate(swing, 0.5, swing - 1, swing + 1),
    }
    own = {
        "sequence": 1,
        "acquired_at": START + timedelta(minutes=minutes),
        "monotonic_s": 60.0 * minutes,
        "quality": QualityMessage.of(Validity.QUESTIONABLE if reasons else Validity.GOOD, tuple(reasons)),
    }
    return reading(**{**own, "conductor": conductor, **estimate_fields(estimates), **fields})


def invalid(conductor, minutes):
    quality = QualityMessage.of(Validity.INVALID, (Reason(Cause.DARK, "night"),))
    bare = one(conductor, minutes, 8.0).model_dump()
    return Reading(**{**bare, **dict.fromkeys((k for k in bare if k.startswith(("sag", "swing"))), None)}).model_copy(
        update={"quality": quality}
    )


def marked(readings):
    return [r.conductor for r in readings if any(x.cause is Cause.THERMAL_TREND for x in r.quality.reasons)]


def burst(minutes, **sags):
    return [one(conductor, minutes, sag) for conductor, sag in sags.items()]


def test_a_marked_reading_is_questionable_and_keeps_every_number():
    trend = watch()
    trend.judge(burst(0, L1=8.3, L2=8.3, L3=8.3))
    given = burst(5, L1=8.3, L2=8.9, L3=8.3)
    judged = trend.judge(given)
    assert marked(judged) == ["L2"]
    wrong = judged[1]
    assert wrong.quality.validity is Validity.QUESTIONABLE
    assert wrong.quality.detail_qual == (DetailQual.INCONSISTENT,)
    text = wrong.quality.reasons[0].text
    assert "8.900 m after 8.300 m 5 min ago" in text
    assert "while the others changed by +0, +0 K" in text
    for before, after in zip(given, judged, strict=True):
        assert before.model_dump(exclude={"quality"}) == after.model_dump(exclude={"quality"})
    assert "L2" in trend.state


def test_the_first_reading_of_all_has_no_past_to_contradict():
    assert marked(watch().judge(burst(0, L1=6.1, L2=11.0, L3=8.0))) == []


def test_the_line_is_switched_on_and_all_phases_warm_together():
    trend, sags = watch(), [sag_at_temperature(PHASES[0], t) for t in (20.0, 32.0, 41.0, 47.0, 51.0)]
    for number, sag in enumerate(sags):
        assert marked(trend.judge(burst(5 * number, L1=sag, L2=sag, L3=sag))) == []


def test_all_phases_cannot_jump_together_farther_than_heat_can_drive_them():
    trend = watch()
    trend.judge(burst(0, L1=8.0, L2=8.0, L3=8.0))
    assert marked(trend.judge(burst(1, L1=8.8, L2=8.8, L3=8.8))) == ["L1", "L2", "L3"]


def test_after_a_night_without_readings_nearly_anything_may_have_happened():
    trend = watch()
    trend.judge(burst(0, L1=8.0, L2=8.0, L3=8.0))
    assert marked(trend.judge(burst(600, L1=8.9, L2=8.9, L3=8.9))) == []


def test_after_one_mistake_the_right_readings_are_not_marked():
    trend = watch(("L1",))
    for minutes in (0, 5, 10):
        trend.judge(burst(minutes, L1=8.3))
    assert marked(trend.judge(burst(15, L1=10.3))) == ["L1"]
    assert marked(trend.judge(burst(20, L1=8.31))) == []
    assert trend.state == "ok"


def test_what_a_reading_does_not_know_it_is_not_blamed_for():
    trend = watch()
    trend.judge(burst(0, L1=8.3, L2=8.3, L3=8.3))
    vague = [one("L1", 5, 8.3), one("L2", 5, 8.9, u=0.4), one("L3", 5, 8.3)]
    assert marked(trend.judge(vague)) == []


def test_a_gust_swings_the_conductor_up_and_is_no_jump_of_its_own_sag():
    trend = watch(("L1",))
    in_plane = {f"inplane_sag_{k}": v for k, v in (("m", 8.31), ("u", 0.02), ("lo", 8.27), ("hi", 8.35))}
    trend.judge([one("L1", 0, 8.3, **in_plane)])
    assert marked(trend.judge([one("L1", 1, 7.8, swing=20.0, **in_plane)])) == []


@pytest.mark.parametrize("names", [("L1",), ("L1", "L2", "L3")])
def test_a_slipped_clamp_is_marked_for_half_an_hour_then_taken_as_real_and_told_once(caplog, names):
    trend = watch(names)
    trend.judge(burst(0, **dict.fromkeys(names, 8.0)))
    others = dict.fromkeys(names[1:], 8.0)
    flags = [bool(marked(trend.judge(burst(5 * k, L1=9.8 + 0.01 * (k % 2), **others)))) for k in range(1, 16)]
    assert flags == [True] * 6 + [False] * 9  # 5 to 30 min marked; the reading at 35 min has lasted 30
    told = [r.message for r in caplog.records if "taken as real" in r.message]
    assert len(told) == 1
    assert "was 8.000 m" in told[0]
    assert "taken as real" in trend.state
    trend.judge(burst(75 + 24 * 60, L1=9.8, **others))
    assert trend.state == "ok"


def test_mistakes_that_do_not_agree_with_each_other_are_never_taken_as_real():
    trend = watch()
    trend.judge(burst(0, L1=8.0, L2=8.0, L3=8.0))
    wrong = [10.9, 6.1, 10.5, 6.3, 10.8, 6.2, 10.6, 6.1]
    assert all(marked(trend.judge(burst(5 + 10 * k, L1=s, L2=8.0, L3=8.0))) for k, s in enumerate(wrong))


def test_two_circuits_may_warm_each_by_itself():
    jump = sag_at_temperature(PHASES[0], 31.0) - sag_at_temperature(PHASES[0], 20.0)
    for circuits, expected in (({"L1": "a", "L2": "b"}, []), ({}, ["L1"])):
        trend = watch(("L1", "L2"), circuits)
        trend.judge(burst(0, L1=8.0, L2=8.0))
        assert marked(trend.judge(burst(4, L1=8.0 + jump, L2=8.0))) == expected


@pytest.mark.parametrize("other", [{"calibration_id": "d"}, {"configuration_id": "d"}])
def test_readings_of_another_calibration_are_no_past(other):
    trend = watch(("L1",))
    trend.judge(burst(0, L1=8.0))
    assert marked(trend.judge([one("L1", 1, 10.0, **other)])) == []


def test_refused_and_doubtful_readings_are_no_past_either():
    trend = watch(("L1",))
    trend.judge(burst(0, L1=8.0))
    trend.judge([invalid("L1", 1)])
    trend.judge([one("L1", 2, 8.5, reasons=[Reason(Cause.FRAMES_DISAGREE, "gusts")])])
    assert marked(trend.judge(burst(3, L1=8.0))) == []
    assert marked(trend.judge([invalid("L1", 4)])) == []


@settings(deadline=None)
@given(st.floats(-1e308, 1e308), st.floats(0, 1e308), st.floats(-1e308, 1e308))
def test_no_number_of_a_mad_worker_ends_the_watch(sag, u, swing):
    trend = watch(("L1",))
    trend.judge(burst(0, L1=8.0))
    mad = Estimate(sag, u, sag, sag)
    reading = one("L1", 5, 8.0, **estimate_fields({"inplane_sag": mad, "swing": Estimate(swing, 1.0, swing, swing)}))
    (judged,) = trend.judge([reading])
    assert judged.inplane_sag_m == sag


def test_a_clock_that_goes_back_makes_no_jump_of_a_slow_change():
    trend = watch(("L1",))
    trend.judge(burst(0, L1=8.0))
    later = one("L1", -60, 8.5, monotonic_s=3600.0)
    assert marked(trend.judge([later])) == []
    other_boot = one("L1", -90, 8.0, boot_id="after a power cut", monotonic_s=20.0)
    assert marked(trend.judge([other_boot])) == []


def test_what_it_knows_is_restored_from_the_readings_that_were_recorded():
    one_run, recorded = watch(), []
    story = [burst(5 * k, L1=8.3, L2=8.3 + (1.0 if k >= 6 else 0.0), L3=8.3) for k in range(20)]
    whole = [marked(one_run.judge(b)) for b in story]
    restarted = []
    for made in story:
        afresh = watch()
        afresh.remember([Reading.model_validate_json(text) for text in recorded])
        judged = afresh.judge(made)
        restarted.append(marked(judged))
        recorded += [json.dumps(r.model_dump(mode="json")) for r in judged]
    assert restarted == whole
    assert ["L2"] in whole
    assert whole[-1] == []
