"""Between the loop and the journal: what a disk refuses waits, in memory and in a spool, and is tried again."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Sequence
from datetime import datetime, timedelta

from sagnode.config.node import KEEP_DAYS_MAX
from sagnode.daemon.journal import Journal
from sagnode.daemon.logs import Seldom
from sagnode.daemon.spool import Spool
from sagnode.errors import JournalError
from sagnode.message import ReadingHeader

log = logging.getLogger(__name__)

WAITING_MAX = 2000
"""Bursts that wait in memory for a disk; about 20 MB."""
_PRUNE_EVERY_S = 3600.0


class Recorder:
    """Commits bursts in order, and keeps the journal within its limits.

    Args:
        journal: where to.
        owed: whether readings have to be delivered to a broker.
        keep_days: age limit of what is not owed.
        keep_mb: size limit.
        spool: where bursts that wait outlive the process; what it holds is recorded first.
    """

    def __init__(
        self, journal: Journal, *, owed: bool, keep_days: float, keep_mb: float, spool: Spool | None = None
    ) -> None:
        self._journal = journal
        self._owed = owed
        self._keep = timedelta(days=min(keep_days, KEEP_DAYS_MAX))
        self._keep_bytes = keep_mb * 1e6
        self._waiting: deque[list[ReadingHeader]] = deque()
        self._dropped = 0
        self._trouble = ""
        self._pruned_at = float("-inf")
        self._complaints = Seldom(log)
        self._spool = spool
        self._unspooled = 0
        self._refused_since: float | None = None
        self._waiting.extend(spool.load() if spool else ())
        self._inherited = len(self._waiting)
        """So many at the head were left by an earlier process, which may have committed some of them."""
        if self._waiting:
            log.warning("%d bursts were left by an earlier process; they are recorded now", self._inherited)
            self.retry()

    @property
    def state(self) -> str:
        """One line for health: ``ok`` or what is wrong with the disk."""
        if not self._waiting:
            return (
                self._journal.note if not self._dropped else f"{self._dropped} bursts were lost while {self._trouble}"
            )
        lost = f", {self._dropped} were lost" if self._dropped else ""
        return f"{self._trouble}; {len(self._waiting)} bursts wait in memory{lost}"

    @property
    def waiting(self) -> int:
        """Bursts that are not on the disk yet."""
        return len(self._waiting)

    @property
    def refused_s(self) -> float:
        """For so long the disk has refused everything; 0 when it takes what it is given."""
        return 0.0 if self._refused_since is None else time.monotonic() - self._refused_since

    def record(self, readings: Sequence[ReadingHeader]) -> list[ReadingHeader]:
        """Commit a burst, and before it what still waits.

        Returns:
            The burst with its numbers, or as it was given when the disk refused it.
        """
        if len(self._waiting) >= WAITING_MAX:
            self._drop_first()
            self._dropped += 1
        self._waiting.append(list(readings))
        numbered = self.retry()
        if not numbered and (self._spool is None or not self._spool.keep(readings)):
            self._unspooled += 1
        return numbered or list(readings)

    def retry(self) -> list[ReadingHeader]:
        """Commit what waits; returns the last burst if all went well, else nothing."""
        numbered: list[ReadingHeader] = []
        spooled = self._inherited > 0 or self._refused_since is not None
        while self._waiting:
            burst = self._waiting[0]
            try:
                known = self._journal.find(burst) if self._inherited else None
                numbered = known or self._journal.append(burst, owed=self._owed)
            except JournalError as error:
                self._trouble = str(error)
                self._complaints.error(self._trouble)
                if self._refused_since is None:
                    self._refused_since = time.monotonic()
                return []
            self._drop_first()
        if spooled:
            self._unspooled = 0
            self._refused_since = None
            self._complaints.forget()
            if self._spool is not None:
                self._spool.clear()
        return numbered

    def _drop_first(self) -> None:
        self._waiting.popleft()
        self._inherited = max(0, self._inherited - 1)

    def finish(self) -> None:
        """Last attempt at the end of the process; says what is lost with it."""
        self.retry()
        if self._waiting and self._unspooled:
            log.critical(
                "%d bursts of readings are lost with this process: %s",
                min(self._unspooled, len(self._waiting)),
                self._trouble,
            )
        elif self._waiting:
            log.error("%d bursts of readings wait in the spool for the next start", len(self._waiting))

    def prune(self, now: datetime, *, clock_synced: bool) -> None:
        """Once an hour hold the journal to its limits; ages count only by a clock that can be trusted."""
        if time.monotonic() - self._pruned_at < _PRUNE_EVERY_S:
            return
        self._pruned_at = time.monotonic()
        try:
            self._journal.prune(max_bytes=self._keep_bytes, older_than=now - self._keep if clock_synced else None)
        except JournalError as error:
            self._complaints.error(str(error))
