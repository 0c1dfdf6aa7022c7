"""What the node shows of itself: ``status.json`` for ``sagnode status``, ``health`` on MQTT, a line for systemctl."""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sagnode import __version__
from sagnode.daemon.delivery import Delivery
from sagnode.daemon.files import write_atomic
from sagnode.daemon.journal import Journal
from sagnode.daemon.journal_table import Backlog
from sagnode.daemon.ladder import Ladder
from sagnode.daemon.link import Link
from sagnode.daemon.logs import Seldom
from sagnode.daemon.machine import ClockTrust, Machine
from sagnode.daemon.notify import Notifier
from sagnode.daemon.recorder import Recorder
from sagnode.daemon.status_page import STATUS_FILE, STATUS_SCHEMA
from sagnode.digits import decimals
from sagnode.errors import JournalError
from sagnode.exchange import AlarmMessage
from sagnode.message import HealthMessage, Identity, LandmarksMessage, LensMessage, ReadingHeader
from sagnode.quality import Validity
from sagnode.worker.supervisor import Supervisor

log = logging.getLogger(__name__)

_HEALTH_EVERY_S = 300.0
_SHOWN = (
    "sag_m",
    "sag_u",
    "sag_lo",
    "sag_hi",
    "clearance_m",
    "clearance_u",
    "clearance_lo",
    "clearance_hi",
    "landmarks_by_appearance",
)


@dataclass(frozen=True)
class Facts:
    """What does not change while one configuration is in force."""

    identity: Identity
    configuration: Path
    configuration_id: str
    state_dir: Path
    status_dir: Path
    boot_id: str
    virtual_clock: bool
    deadline_s: float
    conductors: tuple[str, ...]


class Showcase:
    """Gathers and shows; whatever cannot be shown is logged and no reason to stop."""

    def __init__(
        self,
        facts: Facts,
        *,
        worker: Supervisor,
        recorder: Recorder,
        journal: Journal,
        link: Link | None,
        machine: Machine,
        notifier: Notifier,
        ladder: Ladder | None = None,
    ) -> None:
        self._facts = facts
        self._worker = worker
        self._recorder = recorder
        self._journal = journal
        self._link = link
        self._machine = machine
        self._notifier = notifier
        self._ladder = ladder
        self._complaints = Seldom(log)
        self._started = time.monotonic()
        self._health_at = float("-inf")
        self._made = 0
        self._invalid = 0
        self._last_good_at: datetime | None = None
        self._last: dict[str, dict[str, Any]] = {}
        self._delivery = Delivery()
        self.configuration_note = "ok"
        """What health says of the configuration, such as a reload that was refused."""
        self.alarms: Sequence[AlarmMessage] = ()
        """Alarms in force."""
        self.lens: LensMessage | None = None
        """As the newest frame shows it."""
        self.landmarks: LandmarksMessage | None = None
        """By which pictures they are recognised."""
        self.trend_note = "ok"
        """What health says of readings that contradict those before them."""

    def hurry(self) -> None:
        """There is news for health; it is not to wait for its turn."""
        self._health_at = float("-inf")

    def show(
        self,
        readings: Sequence[ReadingHeader],
        *,
        now: datetime,
        next_slot: datetime | None,
        gap_s: float,
        trust: ClockTrust,
        state: str = "running",
    ) -> None:
        """Take note of new readings (none, when only time has passed) and show everything."""
        for reading in readings:
            self._count(reading)
        health = self._health(now, trust)
        if self._link is not None and (readings or time.monotonic() - self._health_at > _HEALTH_EVERY_S):
            self._health_at = time.monotonic()
            self._link.show("health", health.model_dump_json().encode())
        page = {
            "schema_version": STATUS_SCHEMA,
            "state": state,
            "software_version": __version__,
            "unit": self._facts.identity.model_dump(),
            "pid": os.getpid(),
            "boot_id": self._facts.boot_id,
            "configuration": str(self._facts.configuration),
            "configuration_id": self._facts.configuration_id,
            "state_dir": str(self._facts.state_dir),
            "written_at": time.time(),
            "written_monotonic_s": time.monotonic(),
            "now": now.isoformat(),
            "virtual_clock": self._facts.virtual_clock,
            "clock": {"synced": trust.synced, "source": trust.source},
            "next_slot": next_slot.isoformat() if next_slot else None,
            "gap_s": gap_s if gap_s != float("inf") else None,
            "deadline_s": self._facts.deadline_s,
            "broker_connected": self._link.connected if self._link else None,
            "worker_failures_in_a_row": self._worker.consecutive_failures,
            "waiting_in_memory": self._recorder.waiting,
            "conductors": list(self._facts.conductors),
            "readings": self._last,
            "alarms": [alarm.model_dump(mode="json") for alarm in self.alarms],
            "health": health.model_dump(mode="json"),
        }
        try:
            write_atomic(self._facts.status_dir / STATUS_FILE, json.dumps(page, indent=1), durable=False)
        except OSError as error:
            self._complaints.error(f"{self._facts.status_dir / STATUS_FILE}: {error.strerror}; status is not shown")
        self._notifier.status(self._line(health))

    def _count(self, reading: ReadingHeader) -> None:
        self._made += 1
        validity = reading.quality.validity
        if validity is Validity.INVALID:
            self._invalid += 1
        elif validity is Validity.GOOD:
            self._last_good_at = reading.acquired_at
        before = self._last.get(reading.conductor, {"validity": None, "reasons": []})
        causes = [reason.cause for reason in reading.quality.reasons]
        if (validity, causes) != (before["validity"], [reason["cause"] for reason in before["reasons"]]):
            why = "; ".join(f"{r.cause}: {r.text}" for r in reading.quality.reasons)
            log.info("%s is %s%s", reading.conductor, validity, f" ({why})" if why else "")
        self._last[reading.conductor] = {
            "sequence": reading.sequence,
            "acquired_at": reading.acquired_at.isoformat(),
            "recorded_monotonic_s": time.monotonic(),
            "validity": validity,
            "reasons": [{"cause": r.cause, "text": r.text} for r in reading.quality.reasons],
            **{name: getattr(reading, name) for name in _SHOWN},
        }

    def _health(self, now: datetime, trust: ClockTrust) -> HealthMessage:
        backlog = self._backlog()
        age = (now - backlog.oldest_acquired_at).total_seconds() if backlog.oldest_acquired_at else None
        return HealthMessage(
            at=now,
            uptime_s=round(time.monotonic() - self._started, 1),
            cpu_temperature_c=self._machine.cpu_temperature_c(),
            throttled=self._machine.throttled(),
            memory_available_mb=self._machine.memory_available_mb(),
            disk_free_mb=self._machine.disk_free_mb(self._facts.state_dir),
            camera=self._worker.camera,
            worker_restarts=self._worker.restarts,
            readings_made=self._made,
            readings_invalid=self._invalid,
            last_good_at=self._last_good_at,
            outbox_depth=backlog.depth,
            outbox_oldest_s=None if age is None else max(0.0, age),
            outbox_set_aside=self._link.set_aside if self._link else 0,
            delivery=self._delivery.state(self._link, backlog) if self._link else "ok",
            broker=self._link.state if self._link else "none configured",
            certificate_ends_at=self._link.certificate_ends_at() if self._link else None,
            clock_synced=trust.synced,
            journal=self._recorder.state,
            configuration=self.configuration_note,
            recovery=self._ladder.state if self._ladder else "ok",
            lens=self.lens,
            landmarks=self.landmarks,
            trend=self.trend_note,
        )

    def _backlog(self) -> Backlog:
        try:
            return self._journal.backlog()
        except JournalError as error:
            self._complaints.error(str(error))
            return Backlog(0, None)

    def _line(self, health: HealthMessage) -> str:
        words = [f"{self._made} readings, {self._invalid} invalid"]
        for conductor, last in self._last.items():
            sag, lo, hi = last["sag_m"], last["sag_lo"], last["sag_hi"]
            told = last["validity"] if sag is None else f"{sag:.{decimals(hi - lo)}f} m"
            words.append(f"{conductor} {told}")
        if self._link is not None and not self._link.connected:
            words.append(f"broker {health.broker}, {health.outbox_depth} readings wait")
        if health.delivery != "ok":
            words.append(health.delivery)
        return "; ".join(words)
