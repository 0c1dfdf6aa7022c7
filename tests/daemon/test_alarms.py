"""Alarms: raised by what the interval says, debounced, with hysteresis, latched, and alive across restarts."""

import json
import tempfile
from datetime import timedelta
from importlib.resources import files
from itertools import count
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import START, reading

from sagnode.config.load import load_span
from sagnode.config.node import Alarms as Settings
from sagnode.daemon.alarms import ALARMS_FILE, Alarms, Debounce
from sagnode.daemon.rules import configured_rules
from sagnode.exchange import AlarmMessage
from sagnode.message import Identity, QualityMessage
from sagnode.quality import Cause, Reason, Validity

SPAN = load_span(Path(str(files("sagnode.demo") / "site" / "span.toml"))).span
IDENTITY = Identity(utility="u", line="l", span="s", unit="n")


class Bench:
    """Alarms of L1 with the demonstration's limits (clearance 6.0 m, sag 9.6 m) and what they have published."""

    def __init__(self, directory, span=SPAN, settings=None, **options):
        self.published, self.topics, self.at = [], {}, 0
        self.passed, self.now = 1000.0, START
        ids = count(1)
        rules = {"L1": configured_rules(span, settings or Settings())["L1"]}
        self.alarms = Alarms(
            IDENTITY,
            rules,
            Debounce(2, 3),
            file=directory / ALARMS_FILE,
            publish=self.publish,
            new_id=lambda: f"event-{next(ids)}",
            passed_s=lambda: self.passed,
            **options,
        )

    def publish(self, topic, payload):
        self.published.append((topic, payload))
        self.topics[topic] = payload

    def read(self, *, number=None, reasons=(), validity=None, u=0.02, minutes=5, **values):
        """One reading; values are ``clearance=6.2`` and the like."""
        self.at += 1
        fields = dict.fromkeys(("sag_m", "sag_u", "sag_lo", "sag_hi"))
        for stem, value in values.items():
            unit = {"swing": "_deg", "load_skew": ""}.get(stem, "_m")
            fields |= {f"{stem}{unit}": value, f"{stem}_u": u, f"{stem}_lo": value - 2 * u, f"{stem}_hi": value + 2 * u}
        kind = validity or (Validity.QUESTIONABLE if reasons else Validity.GOOD)
        fields["quality"] = QualityMessage.of(kind, tuple(reasons))
        fields["landmarks_used"] = 0 if kind is Validity.INVALID else 8
        self.idle(minutes, look=False)
        return self.alarms.look([reading(number or self.at, acquired_at=self.now, **fields)], self.now)

    def idle(self, minutes, *, look=True):
        """Time passes, by the clock and in truth."""
        self.passed += 60 * minutes
        self.now += timedelta(minutes=minutes)
        if look:
            self.alarms.look([], self.now)

    def invalid(self, cause=Cause.DARK):
        return self.read(reasons=[Reason(cause, "because")], validity=Validity.INVALID)

    def alarm(self, kind):
        payload = self.topics.get(f"alarm/L1/{kind}", b"")
        return AlarmMessage.model_validate_json(payload) if payload else None


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_clearance_is_held_against_its_limit_by_the_lower_end_of_its_interval(bench):
    for _ in range(3):
        bench.read(clearance=6.05, u=0.02)  # lo = 6.01
    assert bench.alarm("clearance") is None
    bench.read(clearance=6.05, u=0.05)  # lo = 5.95
    bench.read(clearance=6.06, u=0.05)
    alarm = bench.alarm("clearance")
    assert (alarm.value, alarm.lo, alarm.hi, alarm.limit) == (6.06, pytest.approx(5.96), pytest.approx(6.16), 6.0)
    assert alarm.worst == pytest.approx(5.96)
    assert alarm.since == START + timedelta(minutes=20)  # the first reading that showed it, not the one that raised it
    assert alarm.text == "clearance 6.06 m [5.96 .. 6.16], limit 6 m"


def test_a_models_alarm_is_told_to_a_tenth_of_a_millimetre(tmp_path):
    """In the laboratory 0.09 m of sag is known to 1 mm; with two decimals both ends would be the value."""
    limits = SPAN.limits.model_copy(update={"clearance_min_m": 0.2, "sag_max_m": 0.09})
    bench = Bench(tmp_path, SPAN.model_copy(update={"limits": limits}))
    for _ in range(2):
        bench.read(clearance=0.18012, sag=0.09512, u=0.0009)
    assert bench.alarm("clearance").text == "clearance 0.1801 m [0.1783 .. 0.1819], limit 0.2 m"
    assert bench.alarm("sag").text == "sag 0.0951 m [0.0933 .. 0.0969], limit 0.09 m"


def test_it_takes_two_readings_in_a_row_to_raise_and_three_beyond_the_margin_to_clear(bench):
    story = [5.5, 7.0, 5.5, 7.0, 5.5, 5.6, 6.1, 6.1, 6.1, 6.1, 6.5, 6.5, 6.1, 6.5, 6.5, 6.5]
    state = []
    for clearance in story:
        bench.read(clearance=clearance)
        state.append(bench.alarm("clearance") is not None)
    # 6.1 is beyond the limit, but its lower end is not beyond limit and margin (6.10)
    assert state == [False] * 5 + [True] * 10 + [False]
    assert bench.topics["alarm/L1/clearance"] == b""


def test_an_event_keeps_its_id_and_its_worst_and_the_next_one_has_another(bench):
    for clearance in (5.5, 5.4, 5.0, 5.6):
        bench.read(clearance=clearance)
    first = bench.alarm("clearance")
    assert (first.event_id, first.worst, first.value) == ("event-1", pytest.approx(4.96), 5.6)
    assert first.worst_at == START + timedelta(minutes=15)
    assert first.sequence == 4
    for clearance in (7.0, 7.0, 7.0, 5.5, 5.5):
        bench.read(clearance=clearance)
    assert bench.alarm("clearance").event_id == "event-2"


def test_readings_without_a_number_show_nothing_either_way(bench):
    bench.read(clearance=5.5)
    bench.invalid()
    bench.read(clearance=5.5)
    assert bench.alarm("clearance") is not None
    for _ in range(5):
        bench.invalid()
    assert bench.alarm("clearance") is not None


def test_a_reading_that_contradicts_its_past_raises_but_does_not_clear(bench):
    marked = [Reason(Cause.THERMAL_TREND, "jump")]
    bench.read(clearance=5.5, reasons=marked)
    bench.read(clearance=5.5, reasons=marked)
    assert bench.alarm("clearance") is not None
    for _ in range(5):
        bench.read(clearance=9.0, reasons=marked)
    assert bench.alarm("clearance") is not None


def test_sag_is_held_against_its_limit_by_the_upper_end(bench):
    bench.read(sag=9.57, u=0.01)
    bench.read(sag=9.57, u=0.01)
    assert bench.alarm("sag") is None
    bench.read(sag=9.57, u=0.02)
    bench.read(sag=9.57, u=0.02)
    assert bench.alarm("sag").worst == pytest.approx(9.61)


@pytest.mark.parametrize("side", [1, -1])
def test_swing_must_be_sure(bench, side):
    for _ in range(3):
        bench.read(swing=14.0 * side, u=5.0)  # a view that hardly sees it; limit 12 degrees
    assert bench.alarm("swing") is None
    bench.read(swing=14.0 * side, u=0.5)
    bench.read(swing=14.0 * side, u=0.5)
    assert bench.alarm("swing").value == 14.0 * side


def test_uneven_load_is_suspected_ice_when_it_is_large_and_sure(bench):
    for skew, u in ((0.05, 0.01), (0.05, 0.01), (0.2, 0.06), (0.2, 0.06), (0.2, 0.04), (0.0, 0.01)):
        bench.read(load_skew=skew, u=u)
    assert bench.alarm("ice-suspect") is None
    bench.read(load_skew=-0.2, u=0.04)
    bench.read(load_skew=-0.2, u=0.04)
    assert "heavier at the near end" in bench.alarm("ice-suspect").text
    for _ in range(3):
        bench.invalid()
    assert bench.alarm("ice-suspect") is not None
    for _ in range(3):
        bench.read(sag=8.0)  # an even load was enough for these
    assert bench.alarm("ice-suspect") is None


def test_readings_that_are_refused_for_an_uneven_load_raise_the_suspicion_as_well(bench):
    bench.invalid(Cause.ICE_SUSPECT)
    bench.invalid(Cause.DARK)
    assert bench.alarm("ice-suspect") is None
    bench.invalid(Cause.ICE_SUSPECT)
    assert (bench.alarm("ice-suspect").text, bench.alarm("ice-suspect").value) == ("because", None)


def test_a_moved_camera_is_told_and_fog_says_nothing_of_it(bench):
    bench.invalid(Cause.CAMERA_MOVED)
    bench.invalid(Cause.CAMERA_MOVED)
    assert bench.alarm("camera-moved").text == "because"
    for _ in range(5):
        bench.invalid(Cause.LANDMARKS_LOST)
    assert bench.alarm("camera-moved") is not None
    for _ in range(3):
        bench.read(sag=8.0)
    assert bench.alarm("camera-moved") is None


def test_staleness_counts_from_the_last_reading_with_a_number_and_ends_with_the_next(bench):
    bench.read(sag=8.0)
    last = bench.now
    bench.invalid()
    bench.idle(114)
    assert bench.alarm("stale") is None
    bench.idle(2)
    assert bench.alarm("stale").since == last
    bench.read(sag=8.0)
    assert bench.alarm("stale") is None


YEAR, HOURS = timedelta(days=365), timedelta(hours=3)


@pytest.mark.parametrize("step", [-YEAR, -HOURS, HOURS, YEAR])
def test_a_step_of_the_clock_neither_raises_staleness_nor_hides_it(bench, step):
    bench.read(sag=8.0)
    bench.now += step
    last = bench.now
    bench.idle(119)
    assert bench.alarm("stale") is None
    bench.idle(2)
    assert bench.alarm("stale").since == last  # by the clock as it is now
    bench.now -= step
    bench.idle(1)
    assert bench.alarm("stale") is not None
    bench.read(sag=8.0)
    assert bench.alarm("stale") is None


@pytest.mark.parametrize("step", [-YEAR, YEAR])
def test_a_step_before_the_first_reading_does_not_either(bench, step):
    bench.idle(1)
    bench.now += step
    bench.idle(118)
    assert bench.alarm("stale") is None
    bench.idle(3)
    assert bench.alarm("stale") is not None


def test_after_a_restart_staleness_counts_from_the_journal(tmp_path):
    bench = Bench(tmp_path)
    bench.alarms.remember([reading(1, acquired_at=START)])
    bench.alarms.look([], START + timedelta(hours=3))
    assert bench.alarm("stale").since == START


def test_a_reading_of_this_boot_is_as_old_as_the_time_that_has_passed_whatever_it_bears(tmp_path):
    bench = Bench(tmp_path)
    bench.alarms.remember([reading(1, acquired_at=START + YEAR, boot_id="b", monotonic_s=1000.0 - 3600.0)], "b")
    bench.idle(59)
    assert bench.alarm("stale") is None
    bench.idle(2)
    assert bench.alarm("stale") is not None


def test_a_reading_of_an_earlier_boot_that_is_of_the_future_was_made_before_this_one(tmp_path):
    bench = Bench(tmp_path)
    bench.alarms.remember([reading(1, acquired_at=START + YEAR, boot_id="a", monotonic_s=1.0)], "b")
    bench.idle(119)
    assert bench.alarm("stale") is None
    bench.idle(2)
    assert bench.alarm("stale") is not None


def test_a_node_that_was_off_for_long_is_stale_as_soon_as_its_clock_is_set(tmp_path):
    bench = Bench(tmp_path)
    bench.alarms.remember([reading(1, acquired_at=START - timedelta(minutes=5), boot_id="a")], "b")
    bench.idle(1)
    assert bench.alarm("stale") is None  # a clock without a battery goes on where it stood
    bench.now += HOURS
    bench.idle(1)
    assert bench.alarm("stale").since == START - timedelta(minutes=5)


def test_alarms_and_half_raised_ones_survive_a_restart(tmp_path):
    before = Bench(tmp_path)
    for clearance, sag in ((5.5, 8.0), (5.5, 8.0), (5.5, 9.8)):
        before.read(clearance=clearance, sag=sag)
    after = Bench(tmp_path)
    after.at = before.at
    assert [a.event_id for a in after.alarms.active] == ["event-1"]
    after.alarms.show()
    assert after.alarm("clearance") == before.alarm("clearance").model_copy(
        update={k: getattr(after.alarm("clearance"), k) for k in ("value", "u", "lo", "hi", "updated_at", "sequence")}
    )
    after.read(clearance=5.5, sag=9.8)
    assert after.alarm("sag").since == START + timedelta(minutes=15)
    assert after.alarm("clearance").event_id == "event-1"


def test_what_is_not_an_alarm_is_published_as_empty_at_the_start(bench):
    bench.alarms.show()
    kinds = {topic.rpartition("/")[2] for topic in bench.topics}
    assert kinds == {"clearance", "sag", "swing", "ice-suspect", "camera-moved", "stale"}
    assert set(bench.topics.values()) == {b""}


def test_a_limit_that_was_taken_back_takes_its_alarm_with_it(tmp_path):
    before = Bench(tmp_path)
    before.read(clearance=5.5)
    before.read(clearance=5.5)
    without = SPAN.model_copy(update={"limits": SPAN.limits.model_copy(update={"clearance_min_m": None})})
    after = Bench(tmp_path, without)
    assert after.alarms.active == []
    assert after.topics == {"alarm/L1/clearance": b""}


@pytest.mark.parametrize("text", ["", "{", "[1, {}]", '{"a": 1}', '[{"conductor": "L1", "kind": "hail"}]'])
def test_a_damaged_file_is_a_fresh_start(tmp_path, text):
    (tmp_path / ALARMS_FILE).write_text(text)
    bench = Bench(tmp_path)
    assert bench.alarms.active == []
    bench.read(clearance=5.5)
    bench.read(clearance=5.5)
    assert json.loads((tmp_path / ALARMS_FILE).read_text())[0]["alarm"]["kind"] == "clearance"


def test_the_file_is_not_written_for_every_reading(tmp_path, bench):
    bench.read(clearance=7.0)
    assert not (tmp_path / ALARMS_FILE).exists()
    bench.read(clearance=5.5)
    bench.read(clearance=5.5)
    written = (tmp_path / ALARMS_FILE).read_text()
    bench.read(clearance=5.4)
    assert (tmp_path / ALARMS_FILE).read_text() == written


@settings(max_examples=40, deadline=None)
@given(st.floats(-1e308, 1e308), st.floats(0, 1e308))
def test_no_number_of_a_mad_worker_ends_it(value, u):
    with tempfile.TemporaryDirectory() as directory:
        bench = Bench(Path(directory))
        names = {"clearance": "_m", "sag": "_m", "swing": "_deg", "load_skew": ""}
        fields = {}
        for stem, unit in names.items():
            fields |= {f"{stem}{unit}": value, f"{stem}_u": u, f"{stem}_lo": value, f"{stem}_hi": value}
        for minute in range(3):
            bench.alarms.look([reading(1 + minute, **fields)], START + timedelta(minutes=minute))


def test_a_disk_that_refuses_costs_no_alarm(tmp_path, caplog):
    bench = Bench(tmp_path / "gone")
    bench.read(clearance=5.5)
    bench.read(clearance=5.5)
    assert bench.alarm("clearance") is not None
    assert "would not survive a restart" in caplog.text
