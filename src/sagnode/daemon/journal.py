"""The journal: every reading, committed to the disk before anybody hears of it, and the outbox in one.

SQLite with a write-ahead log and ``synchronous=FULL``: what is committed survives a power cut (``NORMAL`` loses it).
All conductors of a burst go in one transaction. Each row bears a checksum, so that a bit that flips on a worn card
makes a row that is set aside and never a wrong number. A damaged file is renamed, what can still be read of it is
carried over, and counting goes on above every number that may have been used.

One process writes; any number may read at the same time. Inside the daemon two threads share one connection and a lock.
Here are opening, counting and the lock; the questions to the table are in :mod:`sagnode.daemon.journal_table`.
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from pathlib import Path

from sagnode.daemon import journal_table as table
from sagnode.daemon.journal_file import is_damage, open_file
from sagnode.daemon.journal_table import Backlog, Found, Row
from sagnode.daemon.removed import Removal
from sagnode.daemon.salvage import KeptLog, put_in_place, start_afresh
from sagnode.daemon.sequence import Ceiling, Marks
from sagnode.daemon.wal import lost_frames
from sagnode.errors import DiskError
from sagnode.message import ReadingHeader

log = logging.getLogger(__name__)

_NEWEST = 500
"""The newest reading of each conductor is looked for among so many last ones."""
_ADOPT_CHUNK = 250
"""Readings in one commit when another journal is taken over: the log does not grow beyond its usual size."""
_RECENT = 20_000
"""A burst that may have been committed without anybody's knowledge is among so many last readings."""


class Journal:
    """Opens, mends if it must, and keeps the journal.

    Args:
        path: the SQLite file; its directory must exist.
        boot_id: of this boot of the machine, to tell a power cut from a killed process; empty when it is not known.
        counted_elsewhere: another file that keeps the count, for the day on which this disk is missing.

    Raises:
        DiskError: the directory cannot be written.
        JournalError: the file is of a later version.
    """

    def __init__(self, path: Path, boot_id: str = "", counted_elsewhere: Path | None = None) -> None:
        self.path = path
        self._counted_elsewhere = counted_elsewhere
        self._removal = Removal(path)
        self._marks = Marks(path.with_name("open"), boot_id)
        self.note = "ok"
        """What health says of the journal."""
        self._lock = threading.RLock()
        self._suspect = False
        self._next = 1
        self._device: int | None = None
        self._open_or_mend()

    # -- opening and closing

    def _open_or_mend(self) -> None:
        with self._held():
            self._look_at_the_disk()
            self._ceiling = Ceiling(self.path.with_name("sequence"), self._counted_elsewhere)
            if (aside := put_in_place(self.path)) is not None:
                self._ceiling.distrust()
                self._remark(f"was damaged; kept as {aside.name}, a new one was started")
            if self._removal.put_back():
                self._remark("was removed while it was in use, and was put back")
            log_file = self.path.with_name(self.path.name + "-wal")
            kept_log = KeptLog(log_file)
            if torn := lost_frames(log_file):
                self._remark(f"{log_file.name} was damaged; sequence numbers leave a gap")
            if torn or self._marks.power_failed or not self.path.exists():
                self._ceiling.distrust()
                kept_log.keep()  # opening the journal discards what lies behind a damage
            try:
                self._db = open_file(self.path)
            except sqlite3.DatabaseError as error:
                if not is_damage(error):
                    raise
                self._start_afresh(str(error))
            self._removal.opened()
            self._take_back(kept_log)
            self._bring_back()
            self._count_on()
            self._marks.opened()

    def _look_at_the_disk(self) -> None:
        """An empty mount point is not the disk that was there: counting would begin anew on it."""
        device = self.path.parent.stat().st_dev
        if self._device not in {None, device}:
            raise DiskError(f"journal {self.path}: another disk is mounted there now", "mount the node's own again")
        self._device = device

    def _start_afresh(self, damage: str) -> None:
        up_to = self._ceiling.value
        self._ceiling.distrust()
        self._db, aside, count = start_afresh(self.path, up_to)
        self._remark(f"damaged ({damage}); kept as {aside.name}, a new one was started")
        log.warning("journal: %d readings carried over from %s", count, aside.name)

    def _take_back(self, kept: KeptLog) -> None:
        """Readings that only the damaged part of the log held."""
        rows = kept.rows()
        if rows and (count := table.insert_missing(self._db, rows.values())) > 0:
            log.warning("journal: %d readings taken back from the damaged log", count)
        kept.forget()

    def _bring_back(self) -> None:
        """What a journal held that was replaced by another file while it was open."""
        found = 0
        for rows in self._removal.rows(_ADOPT_CHUNK):
            self._ceiling.cover(max((row[0] for row in rows), default=0))
            table.adopt(self._db, rows)
            found += len(rows)
        if found:
            self._removal.forget()
            self._remark(f"was replaced by another file while it was in use; {found} readings were brought back")

    def _count_on(self) -> None:
        newest = table.newest(self._db)
        self._next = max(self._next, self._ceiling.next_after(newest))
        self._latest = table.newest_by_conductor(self._db, (newest or 0) - _NEWEST)

    def _reopen(self) -> None:
        with contextlib.suppress(sqlite3.Error):
            self._db.close()
        self._open_or_mend()
        self._suspect = False

    def close(self) -> None:
        """Fold the log into the file and close it."""
        with self._lock:
            try:
                if self._removal.happened():
                    self._removal.save(self._db)
                    self._db.close()
                    self._removal.put_back()
            except (OSError, sqlite3.Error) as error:
                log.critical("journal %s was removed, and what it held is lost: %s", self.path, error)
            folded = False
            with contextlib.suppress(sqlite3.Error):
                self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
                folded = True
            with contextlib.suppress(sqlite3.Error):
                self._db.close()  # in any case: an open file would keep a broken disk from being unmounted
            if folded:
                self._marks.closed()

    # -- writing

    @property
    def next_sequence(self) -> int:
        """The number that the next reading must bear."""
        return self._next

    def append(self, readings: Sequence[ReadingHeader], *, owed: bool) -> list[ReadingHeader]:
        """Commit the readings of one burst, all or none.

        Args:
            readings: the burst; their ``sequence`` is replaced by the next numbers.
            owed: whether they have to be delivered to a broker.

        Returns:
            The readings as committed, with their numbers.

        Raises:
            DiskError: the disk refuses; nothing was written, and the burst can be tried again.
        """
        with self._held():
            if self._removal.happened():
                self._removal.save(self._db)
                self._suspect = True
            if self._suspect:
                self._reopen()
                # A commit that ended with an error may be found committed after all.
                if (found := self.find(readings)) is not None:
                    return found
            numbered = [
                reading.model_copy(update={"sequence": self._next + offset}) for offset, reading in enumerate(readings)
            ]
            try:
                self._ceiling.cover(self._next + len(numbered) - 1)
                table.insert(self._db, numbered, owed=owed)
            except (OSError, sqlite3.Error) as error:
                # Whatever is not a mere lack of space may mean that file or disk are not what they were.
                self._suspect = getattr(error, "sqlite_errorcode", 0) & 0xFF != sqlite3.SQLITE_FULL
                raise
            self._next += len(numbered)
            self._latest.update({reading.conductor: reading.sequence for reading in numbered})
        return numbered

    def find(self, readings: Sequence[ReadingHeader]) -> list[ReadingHeader] | None:
        """The burst as it was committed earlier, with its numbers; None when it never was.

        Raises:
            DiskError: the disk refuses.
        """
        found: list[ReadingHeader] = []
        with self._held():
            for reading in readings:
                match = table.committed(self._db, reading, self._next - _RECENT)
                if match is None:
                    return None
                found.append(match)
        return found

    def adopt(self, other: Path) -> int:
        """Take over the readings of another journal with their numbers, which must be none of this one's.

        Args:
            other: its file, used by nobody.

        Returns:
            How many there were.

        Raises:
            DiskError: the disk refuses; a part of them may be here, and all can be taken over again.
        """
        count = 0
        with self._held():
            with contextlib.closing(sqlite3.connect(other, isolation_level=None)) as db:
                for rows in table.sound_rows(db, _ADOPT_CHUNK):
                    self._ceiling.cover(max((row[0] for row in rows), default=0))
                    table.adopt(self._db, rows)
                    count += len(rows)
            self._count_on()
        return count

    def mark_delivered(self, sequences: Iterable[int], at: datetime) -> None:
        """Remember that the broker acknowledged these.

        Raises:
            DiskError: the disk refuses; they stay owed, and may be repeated after a restart.
        """
        with self._held():
            table.deliver(self._db, sequences, at)

    def owe_again(self, first: int, last: int) -> int:
        """Readings from ``first`` to ``last`` are owed to the broker once more; returns how many were not.

        Raises:
            DiskError: the disk refuses; nothing was changed.
        """
        with self._held():
            return table.owe_again(self._db, first, last)

    def prune(self, *, max_bytes: float, older_than: datetime | None) -> int:
        """Delete old readings; the newest of all is always kept, because it carries the count.

        By age only what is not owed goes. By size what is not owed goes first, oldest first, and what is owed only when
        that was not enough; :attr:`note` then says so.

        Args:
            max_bytes: limit of the content (the file itself does not shrink, its free pages are used again).
            older_than: delete what was acquired before; None skips this, as when the clock is not to be trusted.

        Returns:
            How many owed readings were lost to the limit.

        Raises:
            DiskError: the disk refuses.
        """
        with self._held():
            if older_than is not None:
                table.delete_before(self._db, older_than)
            table.shrink(self._db, max_bytes, owed=False)
            lost = table.shrink(self._db, max_bytes, owed=True)
        if lost:
            self._remark(f"storage.keep_mb reached: {lost} undelivered readings deleted")
        return lost

    # -- reading

    def latest_pending(self) -> list[Row]:
        """Of each conductor its newest reading, where that is still owed.

        Raises:
            DiskError: the journal cannot be read.
        """
        with self._held():
            return self._sound(found for number in self._latest.values() for found in table.owed_one(self._db, number))

    def is_latest(self, conductor: str, sequence: int) -> bool:
        """Whether no newer reading of this conductor exists."""
        return self._latest.get(conductor) == sequence

    def pending(self, after: int, limit: int) -> list[Row]:
        """Owed readings with a higher number than ``after``, oldest first.

        Raises:
            DiskError: the journal cannot be read.
        """
        with self._held():
            return self._sound(table.owed(self._db, after, limit))

    def recent(self, limit: int) -> list[Row]:
        """The newest readings, delivered or not, oldest first.

        Raises:
            DiskError: the journal cannot be read.
        """
        with self._held():
            return self._sound(table.last(self._db, limit))

    def backlog(self) -> Backlog:
        """How much is owed, and how old the oldest is.

        Raises:
            DiskError: the journal cannot be read.
        """
        with self._held():
            return table.backlog(self._db)

    # -- within

    @contextlib.contextmanager
    def _held(self) -> Iterator[None]:
        """For this thread alone; what the disk or SQLite says inside becomes a :class:`DiskError`."""
        with self._lock:
            try:
                yield
            except (OSError, sqlite3.Error) as error:
                raise DiskError(
                    f"journal {self.path}: {error}", "check the disk's space, mount and owner (df, mount, ls -l)"
                ) from error

    def _sound(self, found: Iterable[Found]) -> list[Row]:
        """The readings that pass their checksum; the others are set aside."""
        rows: list[Row] = []
        for one in found:
            row = table.sound(one) or table.restored(self._db, one)
            if row is None:
                self._remark(f"reading {one[0]} is damaged on the disk; set aside")
                table.set_damaged_aside(self._db, one[0])
            else:
                rows.append(row)
        return rows

    def _remark(self, text: str) -> None:
        log.error("journal: %s", text)
        self.note = text
