"""The daemon's loop; its one turn is the way of a reading through this process.

::

    wait for the slot -> ask the worker -> stamp -> compare with the past -> record -> publish -> show

Nothing in it waits without a bound, and nothing that a camera, a worker, a disk or a broker does ends it: what fails
becomes an invalid reading or a line of health. It ends when it is told to, or when a replay has shown its last frame.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import Enum
from types import FrameType

from sagnode.daemon.clock import Clock, StepDetector, VirtualClock
from sagnode.daemon.dialogue import Dialogue
from sagnode.daemon.ladder import Ladder, Rung
from sagnode.daemon.link import Link
from sagnode.daemon.machine import ClockTrust, Machine
from sagnode.daemon.notify import Watchdog
from sagnode.daemon.pictures import Pictures
from sagnode.daemon.recorder import Recorder
from sagnode.daemon.schedule import Schedule
from sagnode.daemon.show import Showcase
from sagnode.daemon.stamp import Stamp
from sagnode.message import ReadingHeader
from sagnode.quality import Cause, Reason
from sagnode.trend.watch import Trend
from sagnode.worker.process import KILL_WAIT_S
from sagnode.worker.supervisor import Outcome, Supervisor

log = logging.getLogger(__name__)

_SLICE_S = 0.5
_GRACE_S = 45.0
"""What a turn may take beyond the reading's own deadline: killing, a card that is slow with its commits."""
_SHOW_EVERY_S = 10.0


class Ending(Enum):
    """Why the loop ended."""

    STOPPED = "stopped"
    RELOAD = "reload"
    REOPEN = "the state directory is to be opened anew"
    RESTART = "no reading for too long; the service is to be started anew"
    END_OF_FRAMES = "the replay has shown its last frame"


class Orders:
    """What signals have asked for: they are put down in a dictionary, and a byte in a pipe wakes whoever waits.

    A handler runs between any two steps of the main thread, perhaps while that one holds a lock of :mod:`threading`; to
    wake it by an event of that module would wait for that lock for ever. And a handler written in Python is entered
    anew by the next signal before its first line, so that a flood of them exhausts the stack. Both steps are the
    interpreter's own.
    """

    _STOP = frozenset({signal.SIGTERM, signal.SIGINT})
    _RELOAD = frozenset({signal.SIGHUP})

    def __init__(self) -> None:
        self._came: dict[int, FrameType | None] = {}
        self._news, self._bell = os.pipe()
        for end in (self._news, self._bell):
            os.set_blocking(end, False)

    def install(self) -> None:
        """SIGTERM and SIGINT stop, SIGHUP reloads."""
        # full of bytes that nobody has looked at yet: it wakes all the same
        signal.set_wakeup_fd(self._bell, warn_on_full_buffer=False)
        for number in self._STOP | self._RELOAD:
            signal.signal(number, self._came.setdefault)

    @property
    def stop(self) -> bool:
        """Whether to stop."""
        return not self._STOP.isdisjoint(self._came)

    @property
    def reload(self) -> bool:
        """Whether to read the configuration anew."""
        return not self._RELOAD.isdisjoint(self._came)

    def give(self, number: int) -> None:
        """Give an order as its signal would."""
        self._came.setdefault(number, None)
        with contextlib.suppress(BlockingIOError):
            os.write(self._bell, b"!")

    def wait(self, seconds: float) -> None:
        """Sleep, but wake at once for an order."""
        news = select.poll()
        news.register(self._news, select.POLLIN)
        news.poll(1000 * seconds)

    def reload_done(self) -> None:
        """The order to reload was carried out."""
        for number in self._RELOAD:
            self._came.pop(number, None)
        if not self.stop:
            with contextlib.suppress(BlockingIOError):
                while os.read(self._news, 4096):
                    pass


@dataclass(frozen=True)
class Parts:
    """What the loop works with; made by :mod:`sagnode.daemon.node`."""

    schedule: Schedule
    """Of the configuration; with a virtual clock it is anchored anew at the first frame."""
    interval_s: float | None
    clock: Clock
    """A :class:`VirtualClock` is set to the first frame's time."""
    deadline_s: float
    worker: Supervisor
    stamp: Stamp
    recorder: Recorder
    link: Link | None
    pictures: Pictures | None
    showcase: Showcase
    machine: Machine
    watchdog: Watchdog
    orders: Orders
    ladder: Ladder | None = None
    """What is done when no reading comes for long; None where a restart could not help, as with replayed frames."""
    accept: Callable[[], bool] = lambda: True
    """Has the configuration read anew; False: it was refused, and all goes on as it was."""
    reopen: Callable[[], bool] = lambda: False
    """Whether the readings would be kept better in another place than now; asked after every reading, at least."""
    trend: Trend | None = None
    """Marks readings that contradict those before them."""
    dialogue: Dialogue | None = None
    """Alarms and commands."""


class Loop:
    """One run of the daemon with one configuration."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._schedule = parts.schedule
        self._clock = parts.clock
        self._steps = StepDetector(parts.clock)
        """Looks on through a whole turn: a step between two waits would else leave a slot that is a year away."""
        self._next_frame_at: datetime | None = None
        self._shown_at = float("-inf")
        self._called_away = Ending.RELOAD
        self._out_of_turn = False
        """The present reading was asked for; the next slot is still to come."""

    def run(self) -> Ending:
        """Measure on schedule until there is an order or no frame is left."""
        parts = self._parts
        parts.worker.start()
        slot = self._first_slot()
        while self._wait_for(slot):
            parts.watchdog.promise(parts.deadline_s + KILL_WAIT_S + _GRACE_S)
            began, began_s = self._clock.now(), self._clock.monotonic()
            outcome = parts.worker.measure(parts.pictures.room() if parts.pictures else None)
            if outcome.stopped:
                break
            if outcome.end_of_frames:
                return Ending.END_OF_FRAMES
            rung = self._climb(outcome)
            trust = parts.machine.clock_trust()
            readings = self._stamped(outcome, began, began_s, trust)
            if parts.trend is not None:
                readings = parts.trend.judge(readings)
                parts.showcase.trend_note = parts.trend.state
            readings = parts.recorder.record(readings)
            if parts.link is not None:
                parts.link.wake()
            if parts.dialogue is not None:
                parts.dialogue.recorded(readings, outcome.reply.overlays if outcome.reply else {}, self._clock.now())
            slot = slot if self._out_of_turn else self._next_slot(slot)
            self._show(readings, slot, trust)
            parts.recorder.prune(self._clock.now(), clock_synced=trust.synced)
            if rung is Rung.RESTART:
                return Ending.RESTART
            if rung is Rung.REBOOT:
                parts.watchdog.starve()
            if parts.reopen():
                return Ending.REOPEN
        return Ending.STOPPED if parts.orders.stop else self._called_away

    def _climb(self, outcome: Outcome) -> Rung:
        """What a reading, or its absence, means for the ladder of recovery."""
        ladder = self._parts.ladder
        if ladder is None:
            return Rung.STAY
        if outcome.reply is not None:
            ladder.answered()
            return Rung.STAY
        return ladder.failed(outcome.reason)

    # -- when

    def _first_slot(self) -> datetime | None:
        """Intervals begin with a reading at once; crontabs keep to their times; a replay begins at its first frame."""
        parts = self._parts
        if isinstance(parts.clock, VirtualClock):
            self._await_worker()
            start = parts.worker.hello.first_frame_at if parts.worker.hello else None
            if start is not None:
                parts.clock.set(start)
                if parts.interval_s is not None:
                    self._schedule = Schedule(interval_s=parts.interval_s, anchor=start)
        return self._clock.now() if parts.interval_s is not None else self._next_slot(None)

    def _next_slot(self, last: datetime | None) -> datetime | None:
        """The first slot after now; a clock that was slewed back a little does not make the last one due again."""
        now = self._clock.now()
        slot = self._schedule.next_after(now)
        if last is not None and slot is not None and slot == last:
            slot = self._schedule.next_after(slot)
        if slot is not None and isinstance(self._clock, VirtualClock) and self._next_frame_at is not None:
            slot = max(slot, self._next_frame_at)
        return slot

    def _wait_for(self, slot: datetime | None) -> bool:
        """Wait until the slot has come, however the time of day may jump; False when there is an order instead."""
        parts = self._parts
        if isinstance(self._clock, VirtualClock):
            self._await_worker()
            self._steps = StepDetector(self._clock)  # its jumps are none
        self._out_of_turn = False
        while not self._ordered():
            step = self._steps.step_s()
            if step:
                log.warning("the time of day stepped by %.0f s; the next slot is found anew", step)
                slot = self._next_slot(None)
            if parts.dialogue is not None and parts.dialogue.wanted():
                self._out_of_turn = slot is None or slot > self._clock.now()
                return True
            left = self._clock.idle_s(slot) if slot is not None else float("inf")
            if left <= 0:
                return True
            parts.watchdog.promise(_SLICE_S + _GRACE_S)
            parts.orders.wait(min(left, _SLICE_S))
            if time.monotonic() - self._shown_at > _SHOW_EVERY_S:
                parts.recorder.retry()
                parts.worker.start()
                self._show([], slot, parts.machine.clock_trust())
                if parts.reopen():
                    self._called_away = Ending.REOPEN
                    return False
        return False

    def _ordered(self) -> bool:
        """Whether an order ends this loop; a new configuration does so only once it is found good."""
        orders = self._parts.orders
        if orders.reload and not orders.stop:
            self._called_away = Ending.RELOAD
            if self._parts.accept():
                return True
            orders.reload_done()
        return orders.stop

    def _await_worker(self) -> None:
        """Virtual time must not run away from a worker that is being started: its back-off is real time."""
        parts = self._parts
        while parts.worker.hello is None and not (parts.orders.stop or parts.orders.reload):
            wait_s = parts.worker.wait_s()
            if wait_s <= 0:
                parts.watchdog.promise(parts.deadline_s + KILL_WAIT_S + _GRACE_S)
                parts.worker.ready(parts.deadline_s)
                return
            parts.watchdog.promise(_SLICE_S + _GRACE_S)
            parts.orders.wait(min(wait_s, _SLICE_S))

    # -- what

    def _stamped(self, outcome: Outcome, began: datetime, began_s: float, trust: ClockTrust) -> Sequence[ReadingHeader]:
        parts = self._parts
        if outcome.reply is not None:
            self._next_frame_at = outcome.reply.next_frame_at
            parts.showcase.lens = outcome.reply.lens
            parts.showcase.landmarks = outcome.reply.landmarks
            return parts.stamp.reply(
                outcome.reply, clock_synced=trust.synced, calibration_id=parts.worker.calibration_id
            )
        reason = outcome.reason or Reason(Cause.WORKER_CRASHED, "no answer and no reason")
        return parts.stamp.refusal(
            reason,
            at=began,
            monotonic_s=began_s,
            clock_synced=trust.synced,
            calibration_id=parts.worker.calibration_id,
        )

    def _show(self, readings: Sequence[ReadingHeader], slot: datetime | None, trust: ClockTrust) -> None:
        parts = self._parts
        self._shown_at = time.monotonic()
        if parts.dialogue is not None:
            if not readings:
                parts.dialogue.idle(self._clock.now())
            parts.showcase.alarms = parts.dialogue.active
        gap_s = self._schedule.gap_s(self._clock.now())
        parts.showcase.show(readings, now=self._clock.now(), next_slot=slot, gap_s=gap_s, trust=trust)
