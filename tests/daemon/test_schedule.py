"""Slots: aligned, coalesced, in UTC, with crontab's own weekdays."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.daemon.schedule import Schedule, _weekdays_by_name
from sagnode.errors import ConfigError

NOON = datetime(2026, 6, 1, 12, 0, tzinfo=UTC)


def test_an_interval_lies_on_round_times_whenever_the_node_starts():
    schedule = Schedule(interval_s=900)
    assert schedule.next_after(NOON + timedelta(minutes=7)) == NOON + timedelta(minutes=15)
    assert schedule.next_after(NOON) == NOON + timedelta(minutes=15)


def test_an_anchor_moves_the_slots():
    anchor = NOON + timedelta(seconds=7)
    assert Schedule(interval_s=60, anchor=anchor).next_after(NOON + timedelta(seconds=8)) == NOON + timedelta(
        seconds=67
    )


@given(
    st.floats(0.1, 1e5),
    st.floats(1e9, 3.7e9),
)
@settings(max_examples=200, deadline=None)
def test_the_next_slot_is_always_later_and_at_most_one_interval_away(interval_s, posix):
    now = datetime.fromtimestamp(posix, UTC)
    slot = Schedule(interval_s=interval_s).next_after(now)
    assert timedelta(0) < slot - now <= timedelta(seconds=interval_s * 1.0001 + 1e-3)


def test_cron_is_utc_and_its_weekdays_are_crontabs():
    # 2026-06-01 is a Monday.
    assert Schedule(cron="30 6 * * 1").next_after(NOON - timedelta(days=1)) == datetime(2026, 6, 1, 6, 30, tzinfo=UTC)
    assert Schedule(cron="0 0 * * 0").next_after(NOON).strftime("%a") == "Sun"
    assert Schedule(cron="0 0 * * 7").next_after(NOON).strftime("%a") == "Sun"
    assert Schedule(cron="*/15 * * * *").next_after(NOON) == NOON + timedelta(minutes=15)


def test_cron_knows_nothing_of_daylight_saving_time():
    night = datetime(2026, 3, 29, 0, 0, tzinfo=UTC)
    slots = []
    for _ in range(6):
        night = Schedule(cron="0 * * * *").next_after(night)
        slots.append(night.hour)
    assert slots == [1, 2, 3, 4, 5, 6]


def test_weekday_steps():
    assert _weekdays_by_name("*/2") == "sun,tue,thu,sat"
    assert _weekdays_by_name("1/2") == "mon,wed,fri"
    assert _weekdays_by_name("*") == "*"
    assert _weekdays_by_name("mon-fri") == "mon-fri"


@pytest.mark.parametrize("cron", ["* * * *", "61 * * * *", "* * * * nonday", "a b c d e", "* * * * 9"])
def test_a_bad_expression_is_explained(cron):
    with pytest.raises(ConfigError, match=r"schedule\.cron"):
        Schedule(cron=cron)


def test_a_day_that_never_comes():
    assert Schedule(cron="0 0 30 2 *").next_after(NOON) is None


def test_a_year_in_one_step_is_one_slot():
    schedule = Schedule(interval_s=60)
    assert schedule.next_after(NOON + timedelta(days=365)) == NOON + timedelta(days=365, minutes=1)
    assert schedule.gap_s(NOON) == 60
