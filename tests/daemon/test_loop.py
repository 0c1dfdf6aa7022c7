"""The loop with a real worker process, a real journal, and a clock that is handed in."""

import dataclasses
import json
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from descriptors import all_low_ones_taken

from sagnode.daemon.alarms import Alarms, Debounce
from sagnode.daemon.clock import Clock, SystemClock, VirtualClock
from sagnode.daemon.dialogue import Dialogue
from sagnode.daemon.journal import Journal
from sagnode.daemon.loop import Ending, Loop, Orders, Parts
from sagnode.daemon.machine import Machine
from sagnode.daemon.notify import Notifier, Watchdog
from sagnode.daemon.pictures import Pictures
from sagnode.daemon.recorder import Recorder
from sagnode.daemon.rules import StaleRule
from sagnode.daemon.schedule import Schedule
from sagnode.daemon.show import STATUS_FILE, Facts, Showcase
from sagnode.daemon.stamp import Stamp
from sagnode.exchange import AlarmKind
from sagnode.message import Identity
from sagnode.trend.heat import HeatScale
from sagnode.trend.watch import Trend, Watched
from sagnode.worker.supervisor import Limits, Supervisor

STAND_IN = Path(__file__).parents[1] / "worker" / "stand_in.py"
START = datetime(2026, 6, 1, tzinfo=UTC)
IDENTITY = Identity(utility="u", line="l", span="s", unit="n")


class HandClock(Clock):
    """Time passes only when somebody waits; steps happen when a reading has been made."""

    def __init__(self, steps=()):
        self.wall, self.mono = START, 1000.0
        self.steps = list(steps)

    def now(self):
        return self.wall

    def monotonic(self):
        return self.mono

    def idle_s(self, until):
        return max(0.0, (until - self.wall).total_seconds())

    def pass_(self, seconds):
        self.mono += seconds
        self.wall += timedelta(seconds=seconds)


class HandOrders(Orders):
    """Waiting moves the hand clock; the order to stop comes after so many seconds of it."""

    def __init__(self, clock, stop_after_s, steps=()):
        super().__init__()
        self.clock, self.stop_at, self.steps = clock, clock.mono + stop_after_s, list(steps)

    def wait(self, seconds):
        self.clock.pass_(max(seconds, 0.01))
        if self.steps and self.clock.mono - 1000.0 >= self.steps[0][0]:
            self.clock.wall += timedelta(seconds=self.steps.pop(0)[1])
        if self.clock.mono >= self.stop_at:
            self.give(signal.SIGTERM)


def build(
    tmp_path, plan, clock, orders, *more, schedule=None, interval_s=60.0, deadline_s=5.0, backoff_max_s=0.1, trend=None
):
    (tmp_path / "plan").write_text(plan)

    def command(requests_fd, replies_fd, resume_after):
        words = [sys.executable, "-S", str(STAND_IN), "--plan", str(tmp_path / "plan")]
        words += ["--requests-fd", str(requests_fd), "--replies-fd", str(replies_fd), *more]
        return [*words, "--resume-after", resume_after.isoformat()] if resume_after else words

    journal = Journal(tmp_path / "journal.sqlite")
    machine = Machine()
    worker = Supervisor(
        command, Limits(deadline_s=deadline_s, backoff_max_s=backoff_max_s), beat=lambda: not orders.stop
    )
    recorder = Recorder(journal, owed=False, keep_days=400, keep_mb=100)
    notifier = Notifier(None)
    facts = Facts(IDENTITY, Path("c"), "cid", tmp_path, tmp_path, "boot", False, deadline_s, ("L1", "L2"))
    showcase = Showcase(
        facts, worker=worker, recorder=recorder, journal=journal, link=None, machine=machine, notifier=notifier
    )
    return Parts(
        schedule=schedule or Schedule(interval_s=interval_s),
        interval_s=None if schedule else interval_s,
        clock=clock,
        deadline_s=deadline_s,
        worker=worker,
        stamp=Stamp(IDENTITY, {"L1": "a", "L2": None}, "m", "cid", "0", "boot", False),
        recorder=recorder,
        link=None,
        pictures=Pictures(tmp_path / "pictures", 10, machine),
        showcase=showcase,
        machine=machine,
        watchdog=Watchdog(notifier, None),
        orders=orders,
        trend=trend,
    )


def run(parts):
    try:
        return Loop(parts).run()
    finally:
        parts.worker.stop()


def rows(tmp_path):
    with sqlite3.connect(tmp_path / "journal.sqlite") as db:
        return [json.loads(text) for (text,) in db.execute("SELECT json FROM readings ORDER BY sequence")]


def times(tmp_path):
    return sorted({r["acquired_at"] for r in rows(tmp_path)})


@pytest.fixture
def hand():
    clock = HandClock()
    return lambda stop_after_s, steps=(): (clock, HandOrders(clock, stop_after_s, steps))


def count(tmp_path):
    return len(rows(tmp_path)) // 2


def test_a_day_of_slots(tmp_path, hand):
    clock, orders = hand(600)
    assert run(build(tmp_path, "ok", clock, orders)) is Ending.STOPPED
    assert count(tmp_path) == 10  # at once, and each full minute; the order comes at the last
    first = rows(tmp_path)[0]
    assert first["conductor"] == "L1"
    assert first["phase"] == "a"
    assert first["sag_m"] == 8.0
    assert first["quality"]["validity"] == "good"
    assert [r["sequence"] for r in rows(tmp_path)] == list(range(1, 21))


def test_a_reading_that_contradicts_the_past_is_marked_before_it_is_recorded(tmp_path, hand):
    clock, orders = hand(240)
    watched = Watched(HeatScale(270.0, 0.0), 5.0, 12.0)
    parts = build(tmp_path, "ok ok sag:10.5 ok", clock, orders, trend=Trend({"L1": watched, "L2": watched}, 1800.0))
    run(parts)
    words = [r["quality"]["detail_qual"] for r in rows(tmp_path) if r["conductor"] == "L1"]
    assert words == [[], [], ["inconsistent"], []]
    assert [r["sag_m"] for r in rows(tmp_path)][4:6] == [10.5, 10.5]
    assert json.loads((tmp_path / STATUS_FILE).read_text())["health"]["trend"] == "ok"


def test_a_crontab_keeps_to_its_times(tmp_path, hand):
    clock, orders = hand(3600)
    run(build(tmp_path, "ok", clock, orders, schedule=Schedule(cron="*/20 * * * *")))
    assert count(tmp_path) in {2, 3}


def test_a_step_forward_by_a_year_makes_one_reading_not_half_a_million(tmp_path, hand):
    clock, orders = hand(600, steps=[(300, 365 * 86400)])
    run(build(tmp_path, "ok", clock, orders))
    assert 9 <= count(tmp_path) <= 12


def test_a_step_back_by_an_hour_does_not_stop_the_schedule(tmp_path, hand):
    clock, orders = hand(600, steps=[(300, -3600)])
    run(build(tmp_path, "ok", clock, orders))
    assert 9 <= count(tmp_path) <= 12


def test_a_step_back_between_two_waits_does_not_stop_the_schedule(tmp_path, hand):
    clock, orders = hand(300)
    clock.wall += timedelta(days=365)
    parts = build(tmp_path, "ok", clock, orders)
    show = parts.showcase.show

    def set_right_meanwhile(readings, **more):
        show(readings, **more)
        if readings and clock.wall > START + timedelta(days=300):
            clock.wall -= timedelta(days=365)

    parts.showcase.show = set_right_meanwhile
    assert run(parts) is Ending.STOPPED
    assert len(rows(tmp_path)) > 4


def with_alarms(parts, directory):
    rules = {"L1": [StaleRule(AlarmKind.STALE, limit=7200.0)]}
    file, topics = directory / "alarms.json", {}
    alarms = Alarms(
        IDENTITY, rules, Debounce(1, 1), file=file, publish=topics.__setitem__, passed_s=parts.clock.passed_s
    )
    told = []  # what was said of it at each look, and when
    look = alarms.look

    def looked(readings, now):
        news = look(readings, now)
        told.extend((parts.clock.mono - 1000.0, "raised") for _ in news.raised)
        return news

    alarms.look = looked
    journal = parts.recorder._journal
    talk = Dialogue(alarms, None, journal=journal, link=None, conductors=["L1"], picture_on_alarm=False)
    return dataclasses.replace(parts, dialogue=talk), told


def test_a_clock_that_is_set_back_a_year_does_not_silence_the_alarm_for_no_readings(tmp_path, hand):
    clock, orders = hand(3 * 3600, [(30.0, -365 * 86400)])
    clock.wall += timedelta(days=365)
    parts, told = with_alarms(build(tmp_path, "ok camera-fault", clock, orders, interval_s=600.0), tmp_path)
    run(parts)
    assert len(told) == 1
    assert 7200.0 < told[0][0] < 7810.0


def test_a_clock_that_is_set_forward_raises_no_alarm_for_no_readings(tmp_path, hand):
    clock, orders = hand(3600, [(30.0, 3 * 3600)])
    parts, told = with_alarms(build(tmp_path, "ok camera-fault", clock, orders, interval_s=600.0), tmp_path)
    run(parts)
    assert told == []


def test_a_clock_that_is_wrong_by_decades_and_then_set(tmp_path, hand):
    clock, orders = hand(600, steps=[(100, 40 * 365 * 86400), (200, -39 * 365 * 86400), (300, 1800)])
    run(build(tmp_path, "ok", clock, orders))
    assert 8 <= count(tmp_path) <= 13


def test_failures_are_invalid_readings_with_reasons_and_the_loop_goes_on(tmp_path, hand):
    clock, orders = hand(600)
    parts = build(tmp_path, "ok crash ok garbage ok fault segfault ok", clock, orders)
    run(parts)
    made = rows(tmp_path)
    causes = [r["quality"]["reasons"][0]["cause"] if r["quality"]["reasons"] else "-" for r in made[::2]]
    assert causes[:8] == ["-", "worker-crashed", "-", "worker-garbage", "-", "dark", "worker-crashed", "-"]
    for reading in made:
        if reading["quality"]["validity"] == "invalid":
            assert all(
                reading[f"sag_{x}"] is None and reading[f"clearance_{x}"] is None for x in ("m", "u", "lo", "hi")
            )
            assert reading["quality"]["reasons"][0]["text"]


def test_a_hanging_worker_costs_its_own_reading_only(tmp_path, hand):
    clock, orders = hand(240)
    parts = build(tmp_path, "ok hang ok", clock, orders, deadline_s=0.5)
    run(parts)
    validity = [r["quality"]["validity"] for r in rows(tmp_path)[::2]]
    assert validity == ["good", "invalid", "good", "good"]
    assert parts.worker.restarts == 1


def test_conductors_that_the_worker_does_not_mention_are_invalid(tmp_path, hand):
    clock, orders = hand(30)
    run(build(tmp_path, "ok", clock, orders, "--conductors", "L1,L9"))
    first, second = rows(tmp_path)
    assert first["quality"]["validity"] == "good"
    assert second["conductor"] == "L2"
    assert second["quality"]["reasons"][0]["cause"] == "worker-garbage"


def test_a_replay_on_a_virtual_clock_follows_the_frames_and_ends(tmp_path):
    plan = " ".join(["ok"] * 96) + " end"
    clock = VirtualClock(datetime.now(UTC))
    parts = build(tmp_path, plan, clock, Orders(), "--frames-from", "2026-06-21T00:00:00+00:00", interval_s=900.0)
    assert run(parts) is Ending.END_OF_FRAMES
    made = times(tmp_path)
    assert len(made) == 96
    assert made[0].startswith("2026-06-21T00:00:00")
    assert made[-1].startswith("2026-06-21T23:45:00")
    assert timedelta(0) <= clock.now() - datetime(2026, 6, 22, tzinfo=UTC) < timedelta(seconds=10)


def test_a_virtual_clock_waits_for_a_worker_that_is_being_replaced(tmp_path):
    plan = "ok crash crash crash ok ok end"
    parts = build(
        tmp_path,
        plan,
        VirtualClock(datetime.now(UTC)),
        Orders(),
        "--frames-from",
        "2026-06-21T00:00:00+00:00",
        interval_s=900.0,
        backoff_max_s=1.0,
    )
    assert run(parts) is Ending.END_OF_FRAMES
    assert [r["quality"]["validity"] for r in rows(tmp_path)[::2]] == ["good", *["invalid"] * 3, "good", "good"]


def test_an_order_ends_a_reading_in_flight(tmp_path):
    orders = Orders()
    parts = build(tmp_path, "hang", SystemClock(), orders, deadline_s=60.0)
    threading.Timer(1.0, lambda: orders.give(signal.SIGTERM)).start()
    before = time.monotonic()
    assert run(parts) is Ending.STOPPED
    assert time.monotonic() - before < 60.0  # the reading's own deadline
    assert rows(tmp_path) == []


def test_reload_ends_the_loop_too(tmp_path, hand):
    clock, orders = hand(1e9)
    orders.give(signal.SIGHUP)
    assert run(build(tmp_path, "ok", clock, orders)) is Ending.RELOAD
    orders.reload_done()
    assert not orders.reload
    assert not orders.stop


def test_status_file_tells_it_all(tmp_path, hand):
    clock, orders = hand(100)
    run(build(tmp_path, "ok fault", clock, orders))
    page = json.loads((tmp_path / STATUS_FILE).read_text())
    assert page["unit"]["unit"] == "n"
    assert page["readings"]["L1"]["validity"] == "invalid"
    assert page["readings"]["L1"]["reasons"][0]["cause"] == "dark"
    assert page["health"]["readings_made"] == 4
    assert page["health"]["readings_invalid"] == 2
    assert page["health"]["camera"] == "median grey 3 of 255"
    assert page["gap_s"] == 60
    assert not list(tmp_path.glob("*.part"))


def test_a_disk_that_refuses_is_told_and_nothing_is_lost(tmp_path, hand):
    clock, orders = hand(300)
    parts = build(tmp_path, "ok", clock, orders)
    journal = parts.recorder._journal
    journal._db.execute("PRAGMA max_page_count = 1")
    whole, seen = parts.recorder.record, []

    def record(readings):
        numbered = whole(readings)
        seen.append(parts.recorder.state)
        if len(seen) == 4:
            journal._db.execute("PRAGMA max_page_count = 100000")
        return numbered

    parts.recorder.record = record
    run(parts)
    assert any("full" in state and "wait in memory" in state for state in seen)
    assert seen[-1] == "ok"
    made = [r["sequence"] for r in rows(tmp_path)]
    assert made == list(range(1, 2 * len(seen) + 1))


ORDERED = """
import sys
from sagnode.daemon.loop import Orders
orders = Orders()
orders.install()
print("ready", flush=True)
while not orders.stop:
    orders.wait(0.00001)
    if orders.reload:
        orders.reload_done()
"""


def test_an_order_in_any_moment_of_the_wait_is_taken_and_never_hangs():
    with subprocess.Popen([sys.executable, "-c", ORDERED], stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            until = time.monotonic() + 2.0
            while time.monotonic() < until:
                process.send_signal(signal.SIGHUP)
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
        finally:
            process.kill()


def test_an_order_is_heard_through_a_descriptor_above_a_thousand():
    with all_low_ones_taken():
        orders = Orders()
    threading.Timer(0.1, orders.give, (signal.SIGTERM,)).start()
    began = time.monotonic()
    orders.wait(20.0)
    assert orders.stop
    assert time.monotonic() - began < 10.0
