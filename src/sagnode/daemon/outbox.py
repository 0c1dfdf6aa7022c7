"""What is sent next: the newest reading of each conductor at once, old ones in order, at a bounded rate.

Pure bookkeeping between the journal and the link; it knows no network. A reading leaves it for good only when the
broker's acknowledgement is in the journal. A reading that the broker refuses, or that makes it hang up again and
again, is set aside for a while and blocks nobody.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from sagnode.daemon.journal import Journal
from sagnode.daemon.journal_table import Row

log = logging.getLogger(__name__)

STRIKES_MAX = 3
"""A reading that was alone on the wire when the broker hung up so often is set aside."""
SET_ASIDE_S = 3600.0
_PAGE = 200


@dataclass(frozen=True)
class Outgoing:
    """One reading to hand to the broker."""

    sequence: int
    conductor: str
    payload: bytes
    backfill: bool
    """Sent late: not retained, so that it does not stand before a newer one."""
    expires_in_s: float | None
    """What is left of its time as the newest one; None for backfill, which is history and does not go stale."""


class Outbox:
    """Chooses readings to send, and remembers which are on their way.

    Args:
        journal: where they lie.
        inflight: so many may wait for their acknowledgement at once.
        backlog_per_s: greatest rate of old readings.
        expiry_s: a newest reading older than this is sent as an old one.
        now: time of day, for ``published_at``.
        monotonic: seconds for rates and waits.
    """

    def __init__(
        self,
        journal: Journal,
        *,
        inflight: int,
        backlog_per_s: float,
        expiry_s: float,
        now: Callable[[], datetime],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._journal = journal
        self._configured_inflight = inflight
        self._inflight = inflight
        self._rate = backlog_per_s
        self._expiry = timedelta(seconds=expiry_s)
        self._now = now
        self._monotonic = monotonic
        self._on_the_wire: set[int] = set()
        self._acknowledged: set[int] = set()
        self._strikes: dict[int, int] = {}
        self._aside_until: dict[int, float] = {}
        self._refusal = ""
        self._cursor = 0
        self._page: dict[int, Row] = {}
        self._exhausted_at = 0
        self._passed: dict[int, Row] = {}  # newest ones, left to be sent as such; they may age into old ones
        self._allowance = 1.0
        self._allowance_at = monotonic()

    @property
    def on_the_wire(self) -> int:
        """Readings handed over and not yet acknowledged."""
        return len(self._on_the_wire)

    @property
    def set_aside(self) -> int:
        """Readings that the broker would not take."""
        return len(self._aside_until)

    @property
    def refusal(self) -> str:
        """Why the last of them was not taken."""
        return self._refusal

    @property
    def unwritten(self) -> int:
        """Acknowledgements that are not in the journal yet."""
        return len(self._acknowledged)

    def limit(self, receive_maximum: int) -> None:
        """The broker will bear no more than so many unacknowledged readings (MQTT 5, receive maximum)."""
        self._inflight = max(1, min(self._configured_inflight, receive_maximum))

    def take(self) -> list[Outgoing]:
        """Readings to hand over now; they count as on the wire from here on.

        Raises:
            JournalError: the journal cannot be read.
        """
        taken: list[Outgoing] = []
        room = self._room()
        for newest in self._journal.latest_pending():
            if len(taken) < room and self._free(newest.sequence):
                taken.append(self._outgoing(newest, latest=True))
        self._earn()
        while len(taken) < room and self._allowance >= 1.0 and (row := self._next_old()) is not None:
            self._allowance -= 1.0
            taken.append(self._outgoing(row, latest=False))
        return taken

    def acknowledged(self, sequence: int) -> None:
        """The broker has it; :meth:`settle` writes that down."""
        self._on_the_wire.discard(sequence)
        self._strikes.pop(sequence, None)
        self._page.pop(sequence, None)
        self._passed.pop(sequence, None)
        self._acknowledged.add(sequence)

    def settle(self) -> None:
        """Write the acknowledgements to the journal, many in one commit.

        Raises:
            JournalError: the disk refuses; they are kept for the next attempt.
        """
        if self._acknowledged:
            self._journal.mark_delivered(self._acknowledged, self._now())
            for sequence in self._acknowledged:  # read from the journal between the acknowledgement and now
                self._page.pop(sequence, None)
                self._passed.pop(sequence, None)
            self._acknowledged.clear()

    def refused(self, sequence: int, why: str) -> None:
        """The broker answered that it will not take this one."""
        self._on_the_wire.discard(sequence)
        self._put_aside(sequence, why)

    def link_lost(self, *, by_broker: bool) -> None:
        """Everything on the wire is owed again, from the start of the backlog.

        Args:
            by_broker: the broker hung up; a reading that was alone on the wire is under suspicion then.
        """
        if by_broker:
            for sequence in self._on_the_wire:
                self._strikes[sequence] = self._strikes.get(sequence, 0) + 1
            if len(self._on_the_wire) == 1 and self._strikes[min(self._on_the_wire)] >= STRIKES_MAX:
                self._put_aside(min(self._on_the_wire), "the broker hangs up on it")
        self._on_the_wire.clear()
        self._from_the_start()

    def look_again(self) -> None:
        """Readings that were delivered are owed once more: go through the journal from its start."""
        self._from_the_start()

    def drained(self) -> bool:
        """Whether nothing is owed that could be sent.

        Raises:
            JournalError: the journal cannot be read.
        """
        if self._on_the_wire or self._acknowledged:
            return False
        return self._journal.backlog().depth <= len(self._aside_until)

    def wait_s(self) -> float:
        """Seconds until :meth:`take` may have something that it has not now."""
        if self._exhausted or self._room() <= 0:
            return 1.0
        return min(1.0, max(0.0, (1.0 - self._allowance) / self._rate))

    # -- within

    def _room(self) -> int:
        # Readings under suspicion go one at a time, so that it shows which of them the broker cannot bear.
        limit = 1 if any(count >= STRIKES_MAX - 1 for count in self._strikes.values()) else self._inflight
        return limit - len(self._on_the_wire)

    def _free(self, sequence: int) -> bool:
        if sequence in self._aside_until:
            if self._monotonic() < self._aside_until[sequence]:
                return False
            del self._aside_until[sequence]
        return sequence not in self._on_the_wire and sequence not in self._acknowledged

    def _next_old(self) -> Row | None:
        for row in list(self._passed.values()):
            if not self._journal.is_latest(row.conductor, row.sequence):
                del self._passed[row.sequence]
                if self._free(row.sequence):
                    return row
        if self._exhausted and (due := [s for s, until in self._aside_until.items() if until <= self._monotonic()]):
            for sequence in due:  # some may have left the journal since
                del self._aside_until[sequence]
            self._from_the_start()
        while not self._exhausted:
            if not self._page:
                following = self._journal.next_sequence
                rows = self._journal.pending(self._cursor, _PAGE)
                self._page = {row.sequence: row for row in rows}
                if not rows:
                    self._exhausted_at = following
                continue
            row = self._page.pop(next(iter(self._page)))
            self._cursor = row.sequence
            if self._journal.is_latest(row.conductor, row.sequence):
                self._passed[row.sequence] = row
            elif self._free(row.sequence):
                return row
        return None

    @property
    def _exhausted(self) -> bool:
        """Whether all that is in the journal was looked at; anything new revokes it."""
        return self._exhausted_at == self._journal.next_sequence

    def _from_the_start(self) -> None:
        self._cursor = 0
        self._exhausted_at = 0
        self._page.clear()
        self._passed.clear()

    def _earn(self) -> None:
        now = self._monotonic()
        burst = max(1.0, 0.2 * self._rate)
        self._allowance = min(burst, self._allowance + self._rate * (now - self._allowance_at))
        self._allowance_at = now

    def _put_aside(self, sequence: int, why: str) -> None:
        log.error("reading %d set aside for %.0f s: %s", sequence, SET_ASIDE_S, why)
        self._refusal = why
        self._strikes.pop(sequence, None)
        self._aside_until[sequence] = self._monotonic() + SET_ASIDE_S

    def _outgoing(self, row: Row, *, latest: bool) -> Outgoing:
        message = json.loads(row.json)
        now = self._now()
        age = now - datetime.fromisoformat(message["acquired_at"])
        backfill = not latest or age > self._expiry
        message["published_at"] = now.isoformat().replace("+00:00", "Z")  # as the message's other times
        message["backfill"] = backfill
        self._on_the_wire.add(row.sequence)
        return Outgoing(
            row.sequence,
            row.conductor,
            json.dumps(message, separators=(",", ":")).encode(),
            backfill,
            None if backfill else min(self._expiry, self._expiry - age).total_seconds(),
        )
