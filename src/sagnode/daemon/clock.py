"""The time of day and the time that only goes forward, behind one port, so that a day of frames fits in a minute.

Deadlines and back-off always use the monotonic clock, which no clock step touches and which the virtual clock leaves
real: only idle time is skipped.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from datetime import UTC, datetime, timedelta


class Clock(ABC):
    """What the daemon's loop knows of time."""

    @abstractmethod
    def now(self) -> datetime:
        """Time of day, aware UTC; may step."""

    def monotonic(self) -> float:
        """Seconds since boot; never steps."""
        return time.monotonic()

    def passed_s(self) -> float:
        """Seconds by which the node measures how long ago something was: no step of the time of day is among them."""
        return self.monotonic()

    @abstractmethod
    def idle_s(self, until: datetime) -> float:
        """Real seconds that an idle node has to wait until this time of day; 0 when it is reached."""


class SystemClock(Clock):
    """The machine's clock."""

    def now(self) -> datetime:
        """See :meth:`Clock.now`."""
        return datetime.now(UTC)

    def idle_s(self, until: datetime) -> float:
        """See :meth:`Clock.idle_s`."""
        return max(0.0, (until - self.now()).total_seconds())


class VirtualClock(Clock):
    """Runs as fast as real time while work is done, and jumps when the node would idle.

    Args:
        start: time of day that it shows first.
    """

    def __init__(self, start: datetime) -> None:
        self._skipped_s = 0.0
        self.set(start)

    def set(self, now: datetime) -> None:
        """Go on from here."""
        self._base = (now, self.monotonic())  # one object: other threads read it

    def now(self) -> datetime:
        """See :meth:`Clock.now`."""
        base, at = self._base
        return base + timedelta(seconds=self.monotonic() - at)

    def passed_s(self) -> float:
        """See :meth:`Clock.passed_s`; what was not waited for has passed all the same."""
        return self.monotonic() + self._skipped_s

    def idle_s(self, until: datetime) -> float:
        """Jump to ``until``; there is nothing to wait for."""
        ahead_s = (until - self.now()).total_seconds()
        if ahead_s > 0:
            self._skipped_s += ahead_s
            self.set(until)
        return 0.0


class StepDetector:
    """Tells when the time of day stepped against the monotonic clock.

    Args:
        clock: the clock that is watched.
        tolerance_s: larger differences between two looks are a step; NTP's slewing stays far below.
    """

    def __init__(self, clock: Clock, tolerance_s: float = 2.0) -> None:
        self._clock = clock
        self._tolerance_s = tolerance_s
        self._offset = self._look()

    def step_s(self) -> float:
        """Seconds by which the time of day stepped since the last look; 0 when it did not."""
        before, self._offset = self._offset, self._look()
        step = self._offset - before
        return step if abs(step) > self._tolerance_s else 0.0

    def _look(self) -> float:
        return self._clock.now().timestamp() - self._clock.monotonic()
