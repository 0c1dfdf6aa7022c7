"""The clocks, and the detector of steps, with a clock that is handed in."""

import time
from datetime import UTC, datetime, timedelta

from sagnode.daemon.clock import Clock, StepDetector, SystemClock, VirtualClock

START = datetime(2026, 6, 1, tzinfo=UTC)


class HandClock(Clock):
    def __init__(self):
        self.wall, self.mono = START, 100.0

    def now(self):
        return self.wall

    def monotonic(self):
        return self.mono

    def idle_s(self, until):
        return 0.0

    def advance(self, seconds, step=0.0):
        self.mono += seconds
        self.wall += timedelta(seconds=seconds + step)


def test_system_clock_is_aware_utc():
    clock = SystemClock()
    assert clock.now().utcoffset() == timedelta(0)
    assert 3500 < clock.idle_s(clock.now() + timedelta(hours=1)) <= 3600
    assert clock.idle_s(clock.now() - timedelta(seconds=1)) == 0.0


def test_virtual_clock_jumps_when_idle_and_runs_while_working():
    clock = VirtualClock(START)
    assert clock.idle_s(START + timedelta(hours=6)) == 0.0
    time.sleep(0.05)
    assert timedelta(seconds=0.05) <= clock.now() - START - timedelta(hours=6) < timedelta(hours=1)
    clock.idle_s(START)
    assert clock.now() > START + timedelta(hours=6)


def test_what_a_virtual_clock_skips_has_passed_and_where_it_is_set_to_has_not():
    clock = VirtualClock(START)
    before = clock.passed_s()
    clock.set(START - timedelta(days=365))
    assert 0.0 <= clock.passed_s() - before < 60.0
    clock.idle_s(clock.now() + timedelta(hours=6))
    assert 6 * 3600 <= clock.passed_s() - before + 1.0 < 6 * 3600 + 60.0


def test_steps_are_seen_once_and_slewing_is_not():
    clock = HandClock()
    detector = StepDetector(clock)
    clock.advance(900, step=0.4)
    assert detector.step_s() == 0.0
    clock.advance(1, step=365 * 86400)
    assert round(detector.step_s()) == 365 * 86400
    assert detector.step_s() == 0.0
    clock.advance(1, step=-3600)
    assert round(detector.step_s()) == -3600
