"""Alarms: raised when readings show it often enough, held, and cleared when readings show the contrary.

An alarm honours the uncertainty: clearance is held against its limit by ``clearance_lo``, sag by ``sag_hi``. It needs
some readings in a row to be raised and some to be cleared (debounce), and clears only beyond the limit by a margin
(hysteresis). Readings without a number show nothing either way. What a reading is marked for by the temporal model
raises an alarm and does not clear one. Alarms survive a restart in a small file; the journal is not asked.
"""

from __future__ import annotations

import json
import logging
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

from pydantic import ValidationError

from sagnode.daemon.files import write_atomic
from sagnode.daemon.logs import Seldom
from sagnode.daemon.rules import Evidence, Rule
from sagnode.exchange import AlarmKind, AlarmMessage
from sagnode.message import Identity, ReadingHeader
from sagnode.quality import Validity

log = logging.getLogger(__name__)

ALARMS_FILE = "alarms.json"
_STEPPED_S = 60.0
"""A time of day that says so much else than the time that has passed was set meanwhile."""


@dataclass(frozen=True)
class Debounce:
    """So many readings in a row raise an alarm, and so many clear it; staleness waits for neither."""

    raise_after: int
    clear_after: int


@dataclass
class _Watch:
    """One conductor and one kind."""

    rule: Rule
    alarm: AlarmMessage | None = None
    against: int = 0
    """Readings in a row that contradict the present state."""
    first_at: datetime | None = None
    """Acquisition of the first of them."""


@dataclass(frozen=True)
class _Usable:
    """A reading with a number, or the start of this process where there was none yet."""

    at: datetime
    """By the clock of then, which may have been wrong."""
    passed_s: float
    """When it was, by the time that has passed; of a reading of an earlier boot: when it was remembered."""
    earlier: bool = False
    """Whether it is of an earlier boot: how long ago it was is known by the time of day alone."""

    def age(self, now: datetime, passed_s: float) -> tuple[datetime, float]:
        """Since when, by the present time of day, and for how many seconds there was none."""
        by_the_clock_s = (now - self.at).total_seconds()
        age_s = max(0.0, passed_s - self.passed_s)
        if self.earlier:  # at least as long ago as it was remembered, should it bear a time that is still to come
            age_s = max(age_s, by_the_clock_s)
        return (self.at if abs(by_the_clock_s - age_s) < _STEPPED_S else now - timedelta(seconds=age_s)), age_s


@dataclass
class News:
    """What became of the alarms by a look at readings or the clock."""

    raised: list[AlarmMessage] = field(default_factory=list)
    cleared: list[AlarmMessage] = field(default_factory=list)


class Alarms:
    """All alarms of a node.

    Args:
        identity: of the unit.
        rules: what is watched, by conductor.
        debounce: how many readings it takes.
        file: where they survive a restart.
        publish: called with the topic below the prefix and the retained payload (empty: no alarm).
        test: whether the unit is being commissioned.
        new_id: makes event ids.
        passed_s: seconds by which ages are measured; no step of the time of day is among them.
    """

    def __init__(
        self,
        identity: Identity,
        rules: Mapping[str, Sequence[Rule]],
        debounce: Debounce,
        *,
        file: Path,
        publish: Callable[[str, bytes], None],
        test: bool = False,
        new_id: Callable[[], str] = lambda: str(uuid.uuid4()),
        passed_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._identity = identity
        self._debounce = debounce
        self._file = file
        self._publish = publish
        self._test = test
        self._new_id = new_id
        self._passed_s = passed_s
        self._complaints = Seldom(log)
        self._watches = {(c, rule.kind): _Watch(rule) for c, some in rules.items() for rule in some}
        self._usable: dict[str, _Usable] = {}
        """Each conductor's last reading with a number; by the node's clock, whatever old files it replays."""
        self._started: _Usable | None = None
        self._kept: dict[tuple[str, AlarmKind], tuple[int, str | None]] = {}
        self._restore()

    @property
    def active(self) -> list[AlarmMessage]:
        """Alarms in force, the oldest first."""
        found = [watch.alarm for watch in self._watches.values() if watch.alarm is not None]
        return sorted(found, key=lambda alarm: alarm.since)

    def remember(self, readings: Iterable[ReadingHeader], boot_id: str = "") -> None:
        """At a start: readings of the journal, so that staleness counts from the last that has a number.

        Args:
            readings: of the journal, oldest first.
            boot_id: of this boot, where ``passed_s`` counts from it.
        """
        for reading in readings:
            of_this_boot = bool(boot_id) and reading.boot_id == boot_id
            passed_s = reading.monotonic_s if of_this_boot else self._passed_s()
            self._note_usable(reading, _Usable(reading.acquired_at, passed_s, earlier=not of_this_boot))

    def look(self, readings: Sequence[ReadingHeader], now: datetime) -> News:
        """Judge a burst (or only the time, when it is empty); publish what is in force."""
        news = News()
        passed_s = self._passed_s()
        self._started = self._started or _Usable(now, passed_s)
        for reading in readings:
            self._note_usable(reading, _Usable(now, passed_s))
        for (conductor, kind), watch in self._watches.items():
            if kind is AlarmKind.STALE:
                since, age_s = self._usable.get(conductor, self._started).age(now, passed_s)
                self._weigh(watch, conductor, watch.rule.of_age(since, age_s), now, None, news)
                continue
            for reading in readings:
                if reading.conductor == conductor:
                    evidence = watch.rule.of_reading(reading, active=watch.alarm is not None)
                    self._weigh(watch, conductor, evidence, reading.acquired_at, reading, news)
        for alarm in news.raised:
            log.warning("alarm %s of %s raised: %s", alarm.kind, alarm.conductor, alarm.text)
        for alarm in news.cleared:
            log.warning("alarm %s of %s cleared; it was raised %s", alarm.kind, alarm.conductor, alarm.since)
        self._keep()
        return news

    def show(self) -> None:
        """Publish every state, empty messages where there is no alarm: the broker may hold one of another life."""
        for (conductor, kind), watch in self._watches.items():
            payload = watch.alarm.model_dump_json().encode() if watch.alarm else b""
            self._publish(f"alarm/{conductor}/{kind}", payload)

    # -- within

    def _note_usable(self, reading: ReadingHeader, usable: _Usable) -> None:
        if reading.quality.validity is not Validity.INVALID:
            self._usable[reading.conductor] = usable

    def _weigh(
        self, watch: _Watch, conductor: str, evidence: Evidence, at: datetime, reading: ReadingHeader | None, news: News
    ) -> None:
        """Count evidence for and against the present state, and change it when there is enough."""
        if evidence.shows is None:
            return
        if evidence.shows == (watch.alarm is not None):
            watch.against, watch.first_at = 0, None
        else:
            watch.against, watch.first_at = watch.against + 1, watch.first_at or at
        needed = self._debounce.raise_after if evidence.shows else self._debounce.clear_after
        enough = watch.against >= (1 if reading is None else needed)
        topic = f"alarm/{conductor}/{watch.rule.kind}"
        if watch.alarm is None and evidence.shows and enough:
            since = evidence.since or watch.first_at or at
            watch.alarm = self._message(watch, conductor, evidence, at, reading, since)
            news.raised.append(watch.alarm)
        elif watch.alarm is not None and not evidence.shows and enough:
            news.cleared.append(watch.alarm)
            watch.alarm = None
            self._publish(topic, b"")
        elif watch.alarm is not None:
            watch.alarm = self._message(watch, conductor, evidence, at, reading, watch.alarm.since)
        else:
            return
        if enough and evidence.shows == (watch.alarm is not None):
            watch.against, watch.first_at = 0, None
        if watch.alarm is not None:
            self._publish(topic, watch.alarm.model_dump_json().encode())

    def _message(
        self,
        watch: _Watch,
        conductor: str,
        evidence: Evidence,
        at: datetime,
        reading: ReadingHeader | None,
        since: datetime,
    ) -> AlarmMessage:
        before = watch.alarm
        estimate = evidence.estimate
        worst, worst_at = (before.worst, before.worst_at) if before else (None, None)
        if evidence.measure is not None and (worst is None or watch.rule.worse(evidence.measure, worst)):
            worst, worst_at = evidence.measure, at
        return AlarmMessage(
            **self._identity.model_dump(),
            conductor=conductor,
            kind=watch.rule.kind,
            event_id=before.event_id if before else self._new_id(),
            since=since,
            updated_at=at,
            sequence=reading.sequence if reading else None,
            quantity=watch.rule.quantity,
            limit=watch.rule.limit,
            value=estimate.value if estimate else None,
            u=estimate.u if estimate else None,
            lo=estimate.lo if estimate else None,
            hi=estimate.hi if estimate else None,
            worst=worst,
            worst_at=worst_at,
            test=self._test,
            text=evidence.text,
        )

    # -- across restarts

    def _keep(self) -> None:
        """Write down what must survive; a disk that refuses costs only that."""
        kept = {key: watch for key, watch in self._watches.items() if watch.alarm is not None or watch.against}
        # Values change with every reading and are not worth a write: the next reading brings them anyway.
        essence = {key: (watch.against, watch.alarm.event_id if watch.alarm else None) for key, watch in kept.items()}
        if essence == self._kept:
            return
        states = [
            {
                "conductor": conductor,
                "kind": kind,
                "against": watch.against,
                "first_at": watch.first_at.isoformat() if watch.first_at else None,
                "alarm": watch.alarm.model_dump(mode="json") if watch.alarm else None,
            }
            for (conductor, kind), watch in kept.items()
        ]
        try:
            write_atomic(self._file, json.dumps(states, indent=1))
        except OSError as error:
            self._complaints.error(f"{self._file}: {error.strerror}; alarms would not survive a restart")
        else:
            self._kept = essence

    def _restore(self) -> None:
        for state in _states(self._file):
            try:
                conductor, kind = str(state["conductor"]), AlarmKind(str(state["kind"]))
                alarm = AlarmMessage.model_validate(state["alarm"]) if state["alarm"] else None
                first_at = datetime.fromisoformat(str(state["first_at"])) if state["first_at"] else None
                against = int(str(state["against"]))
            except (KeyError, ValueError, ValidationError) as error:
                log.error("%s: an entry is not understood (%s); left out", self._file, error)
                continue
            watch = self._watches.get((conductor, kind))
            if watch is not None:
                watch.alarm, watch.against, watch.first_at = alarm, against, first_at
            elif alarm is not None:  # no longer configured: the broker must not show it for ever
                self._publish(f"alarm/{conductor}/{kind}", b"")


def _states(file: Path) -> Iterator[dict[str, object]]:
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        log.error("%s cannot be read (%s); alarms begin anew", file, error)
        return
    if isinstance(document, list):
        yield from (entry for entry in document if isinstance(entry, dict))
