"""Between the loop and the journal: what a disk refuses is kept in memory and tried again, within bounds."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Sequence
from datetime import datetime, timedelta

from sagnode.daemon.journal import Journal
from sagnode.daemon.logs import Seldom
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
    """

    def __init__(self, journal: Journal, *, owed: bool, keep_days: float, keep_mb: float) -> None:
        self._journal = journal
        self._owed = owed
        self._keep = timedelta(days=keep_days)
        self._keep_bytes = keep_mb * 1e6
        self._waiting: deque[list[ReadingHeader]] = deque()
        self._dropped = 0
        self._trouble = ""
        self._pruned_at = float("-inf")
        self._complaints = Seldom(log)

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

    def record(self, readings: Sequence[ReadingHeader]) -> list[ReadingHeader]:
        """Commit a burst, and before it what still waits.

        Returns:
            The burst with its numbers, or as it was given when the disk refused it.
        """
        if len(self._waiting) >= WAITING_MAX:
            self._waiting.popleft()
            self._dropped += 1
        self._waiting.append(list(readings))
        numbered = self.retry()
        return numbered or list(readings)

    def retry(self) -> list[ReadingHeader]:
        """Commit what waits; returns the last burst if all went well, else nothing."""
        numbered: list[ReadingHeader] = []
        while self._waiting:
            try:
                numbered = self._journal.append(self._waiting[0], owed=self._owed)
            except JournalError as error:
                self._trouble = str(error)
                self._complaints.error(self._trouble)
                return []
            self._waiting.popleft()
        self._complaints.forget()
        return numbered

    def prune(self, now: datetime, *, clock_synced: bool) -> None:
        """Once an hour hold the journal to its limits; ages count only by a clock that can be trusted."""
        if time.monotonic() - self._pruned_at < _PRUNE_EVERY_S:
            return
        self._pruned_at = time.monotonic()
        try:
            self._journal.prune(max_bytes=self._keep_bytes, older_than=now - self._keep if clock_synced else None)
        except JournalError as error:
            self._complaints.error(str(error))
