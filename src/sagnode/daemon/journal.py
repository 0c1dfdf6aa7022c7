"""The journal: every reading, committed to the disk before anybody hears of it, and the outbox in one.

SQLite with a write-ahead log and ``synchronous=FULL``: what is committed survives a power cut (``NORMAL`` loses it).
All conductors of a burst go in one transaction. Each row bears a checksum, so that a bit that flips on a worn card
makes a row that is set aside and never a wrong number. A damaged file is renamed, what can still be read of it is
carried over, and counting goes on above every number that may have been used.

One process writes; any number may read at the same time. Inside the daemon two threads share one connection and a lock.
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from sagnode.daemon.journal_file import (
    COLUMNS,
    INSERT,
    checksum,
    forget_old_quarantine,
    is_damage,
    open_file,
    set_aside,
    transaction,
)
from sagnode.daemon.salvage import is_sound, raw_rows, salvage
from sagnode.daemon.sequence import Ceiling, Marks
from sagnode.daemon.wal import lost_frames
from sagnode.errors import DiskError
from sagnode.message import ReadingHeader

log = logging.getLogger(__name__)

_DELETE_CHUNK = 500
_NEWEST = 500
"""The newest reading of each conductor is looked for among so many last ones."""
_ADOPT_CHUNK = 250
"""Readings in one commit when another journal is taken over: the log does not grow beyond its usual size."""
_RECENT = 20_000
"""A burst that may have been committed without anybody's knowledge is among so many last readings."""


@dataclass(frozen=True)
class Row:
    """One reading as it lies in the journal."""

    sequence: int
    conductor: str
    json: str


@dataclass(frozen=True)
class Backlog:
    """What is owed to the broker."""

    depth: int
    oldest_acquired_at: datetime | None


class Journal:
    """Opens, mends if it must, and keeps the journal.

    Args:
        path: the SQLite file; its directory must exist.
        boot_id: of this boot of the machine, to tell a power cut from a killed process; empty when it is not known.

    Raises:
        DiskError: the directory cannot be written.
        JournalError: the file is of a later version.
    """

    def __init__(self, path: Path, boot_id: str = "") -> None:
        self.path = path
        self._marks = Marks(path.with_name("open"), boot_id)
        self.note = "ok"
        """What health says of the journal."""
        self._lock = threading.RLock()
        self._suspect = False
        self._next = 1
        self._device: int | None = None
        self._open_or_mend()

    def _open_or_mend(self) -> None:
        self._look_at_the_disk()
        self._ceiling = Ceiling(self.path.with_name("sequence"))
        trusted = self.path.exists() and not self._marks.power_failed
        log_file = self.path.with_name(self.path.name + "-wal")
        behind_the_damage: dict[int, tuple[object, ...]] = {}
        if lost_frames(log_file):
            trusted = False
            self._remark(f"{self.path.name}-wal was damaged; sequence numbers leave a gap")
        if not trusted:
            behind_the_damage = raw_rows([log_file])  # opening the file discards them
        try:
            self._db = open_file(self.path)
        except sqlite3.DatabaseError as error:
            if not is_damage(error):
                raise _cannot(self.path, error) from error
            trusted = False
            self._db = self._start_afresh(str(error))
        self._take_back(behind_the_damage)
        self._count_on(self._newest(), trusted=trusted)
        self._marks.opened()

    def _take_back(self, rows: dict[int, tuple[object, ...]]) -> None:
        """Readings that only the damaged part of the log held."""
        if rows:
            try:
                with transaction(self._db):
                    count = self._db.executemany(
                        f"INSERT OR IGNORE{INSERT.removeprefix('INSERT')}", rows.values()
                    ).rowcount
            except sqlite3.Error as error:
                raise _cannot(self.path, error) from error
            if count > 0:
                log.warning("journal: %d readings taken back from the damaged log", count)

    def _look_at_the_disk(self) -> None:
        """An empty mount point is not the disk that was there: counting would begin anew on it."""
        try:
            device = self.path.parent.stat().st_dev
        except OSError as error:
            raise _cannot(self.path, error) from error
        if self._device not in {None, device}:
            raise DiskError(f"journal {self.path}: another disk is mounted there now", "mount the node's own again")
        self._device = device

    def _count_on(self, newest: int | None, *, trusted: bool) -> None:
        self._next = max(self._next, self._ceiling.next_after(newest, trusted=trusted))
        self._latest: dict[str, int] = dict(
            self._db.execute(
                "SELECT conductor, max(sequence) FROM readings WHERE sequence > ? GROUP BY conductor",
                ((newest or 0) - _NEWEST,),
            )
        )

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
        with self._lock:
            try:
                if self._suspect:
                    self._reopen()
                    # A commit that ended with an error may be found committed after all.
                    if (found := self.find(readings)) is not None:
                        return found
                numbered = [
                    reading.model_copy(update={"sequence": self._next + offset})
                    for offset, reading in enumerate(readings)
                ]
                self._ceiling.cover(self._next + len(numbered) - 1)
                with transaction(self._db):
                    self._db.executemany(INSERT, [_values(reading, owed=owed) for reading in numbered])
            except (OSError, sqlite3.Error) as error:
                # Whatever is not a mere lack of space may mean that file or disk are not what they were.
                self._suspect = getattr(error, "sqlite_errorcode", 0) & 0xFF != sqlite3.SQLITE_FULL
                raise _cannot(self.path, error) from error
            self._next += len(numbered)
            self._latest.update({reading.conductor: reading.sequence for reading in numbered})
        return numbered

    def find(self, readings: Sequence[ReadingHeader]) -> list[ReadingHeader] | None:
        """The burst as it was committed earlier, with its numbers; None when it never was.

        Raises:
            DiskError: the disk refuses.
        """
        query = "SELECT sequence, json FROM readings WHERE sequence > ? AND acquired_at = ? AND conductor = ?"
        found: list[ReadingHeader] = []
        with self._lock:
            for reading in readings:
                try:
                    wanted = (self._next - _RECENT, _utc_text(reading.acquired_at), reading.conductor)
                    rows = self._db.execute(query, wanted).fetchall()
                except sqlite3.Error as error:
                    raise _cannot(self.path, error) from error
                same = (reading.model_copy(update={"sequence": sequence}) for sequence, _ in rows)
                texts = {text for _, text in rows}
                match = next((copy for copy in same if copy.model_dump_json() in texts), None)
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
        query = f"SELECT {COLUMNS} FROM readings ORDER BY sequence"  # noqa: S608 - fixed words
        # At a second attempt some are here as they were then, and may have been delivered from there since.
        insert = (
            f"{INSERT} ON CONFLICT (sequence) DO UPDATE SET fate = excluded.fate, delivered_at = excluded.delivered_at"
            " WHERE excluded.fate = 'delivered' AND json = excluded.json"
        )
        count = 0
        with self._lock:
            try:
                with contextlib.closing(sqlite3.connect(other, isolation_level=None)) as db:
                    found = db.execute(query)
                    while chunk := found.fetchmany(_ADOPT_CHUNK):
                        rows = [row for row in chunk if is_sound(row)]
                        self._ceiling.cover(max((row[0] for row in rows), default=0))
                        with transaction(self._db):
                            self._db.executemany(insert, rows)
                        count += len(rows)
            except (OSError, sqlite3.Error) as error:
                raise _cannot(self.path, error) from error
            self._count_on(self._newest(), trusted=True)
        return count

    def mark_delivered(self, sequences: Iterable[int], at: datetime) -> None:
        """Remember that the broker acknowledged these.

        Raises:
            DiskError: the disk refuses; they stay owed, and may be repeated after a restart.
        """
        rows = [(_utc_text(at), sequence) for sequence in sequences]
        with self._lock:
            try:
                with transaction(self._db):
                    self._db.executemany(
                        "UPDATE readings SET fate = 'delivered', delivered_at = ? WHERE sequence = ?", rows
                    )
            except sqlite3.Error as error:
                raise _cannot(self.path, error) from error

    def owe_again(self, first: int, last: int) -> int:
        """Readings from ``first`` to ``last`` are owed to the broker once more; returns how many were not.

        Raises:
            JournalError: the disk refuses; nothing was changed.
        """
        with self._lock:
            try:
                with transaction(self._db):
                    return self._db.execute(
                        "UPDATE readings SET fate = 'pending', delivered_at = NULL"
                        " WHERE sequence BETWEEN ? AND ? AND fate IN ('delivered', 'local')",
                        (first, last),
                    ).rowcount
            except sqlite3.Error as error:
                raise _cannot(self.path, error) from error

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
        lost = 0
        with self._lock:
            try:
                if older_than is not None:
                    self._delete("fate <> 'pending' AND acquired_at < ?", (_utc_text(older_than),))
                while self._used_bytes() > max_bytes and self._delete("fate <> 'pending'"):
                    pass
                while self._used_bytes() > max_bytes and (deleted := self._delete("fate = 'pending'")):
                    lost += deleted
            except sqlite3.Error as error:
                raise _cannot(self.path, error) from error
        if lost:
            self._remark(f"storage.keep_mb reached: {lost} undelivered readings deleted")
        return lost

    def close(self) -> None:
        """Fold the log into the file and close it."""
        with self._lock:
            folded = False
            with contextlib.suppress(sqlite3.Error):
                self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
                folded = True
            with contextlib.suppress(sqlite3.Error):
                self._db.close()  # in any case: an open file would keep a broken disk from being unmounted
            if folded:
                self._marks.closed()

    # -- reading

    def latest_pending(self) -> list[Row]:
        """Of each conductor its newest reading, where that is still owed."""
        with self._lock:
            newest = list(self._latest.values())
            rows = [self._row(sequence) for sequence in newest]
        return [row for row in rows if row is not None]

    def is_latest(self, conductor: str, sequence: int) -> bool:
        """Whether no newer reading of this conductor exists."""
        return self._latest.get(conductor) == sequence

    def pending(self, after: int, limit: int) -> list[Row]:
        """Owed readings with a higher number than ``after``, oldest first."""
        query = (
            "SELECT sequence, conductor, json, crc FROM readings WHERE fate = 'pending' AND sequence > ?"
            " ORDER BY sequence LIMIT ?"
        )
        with self._lock:
            try:
                found = self._db.execute(query, (after, limit)).fetchall()
                return [row for row in map(self._checked, found) if row is not None]
            except sqlite3.Error as error:
                raise _cannot(self.path, error) from error

    def recent(self, limit: int) -> list[Row]:
        """The newest readings, delivered or not, oldest first.

        Raises:
            JournalError: the journal cannot be read.
        """
        query = (
            "SELECT sequence, conductor, json, crc FROM readings WHERE fate <> 'damaged' ORDER BY sequence DESC LIMIT ?"
        )
        with self._lock:
            try:
                found = self._db.execute(query, (limit,)).fetchall()
                return [row for row in map(self._checked, reversed(found)) if row is not None]
            except sqlite3.Error as error:
                raise _cannot(self.path, error) from error

    def backlog(self) -> Backlog:
        """How much is owed, and how old the oldest is."""
        with self._lock:
            try:
                depth = self._db.execute("SELECT count(*) FROM readings WHERE fate = 'pending'").fetchone()[0]
                oldest = self._db.execute(
                    "SELECT acquired_at FROM readings WHERE fate = 'pending' ORDER BY sequence LIMIT 1"
                ).fetchone()
            except sqlite3.Error as error:
                raise _cannot(self.path, error) from error
        return Backlog(depth, datetime.fromisoformat(oldest[0]) if oldest else None)

    # -- within

    def _reopen(self) -> None:
        with contextlib.suppress(sqlite3.Error):
            self._db.close()
        self._open_or_mend()
        self._suspect = False

    def _row(self, sequence: int) -> Row | None:
        query = "SELECT sequence, conductor, json, crc FROM readings WHERE fate = 'pending' AND sequence = ?"
        try:
            found = self._db.execute(query, (sequence,)).fetchone()
            return self._checked(found) if found else None
        except sqlite3.Error as error:
            raise _cannot(self.path, error) from error

    def _checked(self, found: tuple[int, str, str, int]) -> Row | None:
        sequence, conductor, text, crc = found
        if checksum(sequence, conductor, text) == crc:
            return Row(sequence, conductor, text)
        self._remark(f"reading {sequence} is damaged on the disk; set aside")
        with transaction(self._db):
            self._db.execute("UPDATE readings SET fate = 'damaged' WHERE sequence = ?", (sequence,))
        return None

    def _delete(self, condition: str, values: tuple[str, ...] = ()) -> int:
        with transaction(self._db):
            return self._db.execute(
                "DELETE FROM readings WHERE sequence IN (SELECT sequence FROM readings"  # noqa: S608 - fixed words
                f" WHERE {condition} AND sequence < (SELECT max(sequence) FROM readings) ORDER BY sequence LIMIT ?)",
                (*values, _DELETE_CHUNK),
            ).rowcount

    def _used_bytes(self) -> int:
        page, count, free = (
            self._db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_size", "page_count", "freelist_count")
        )
        return int(page * (count - free))

    def _newest(self) -> int | None:
        newest = self._db.execute("SELECT max(sequence) FROM readings").fetchone()[0]
        return None if newest is None else int(newest)

    def _start_afresh(self, damage: str) -> sqlite3.Connection:
        """Set the damaged file aside under a name of its own and carry over what can be read of it."""
        try:
            aside = set_aside(self.path)
            self._remark(f"damaged ({damage}); kept as {aside.name}, a new one was started")
            db = open_file(self.path)
            with transaction(db):
                count = db.executemany(INSERT, salvage(aside, self._ceiling.value)).rowcount
            forget_old_quarantine(self.path)
        except (OSError, sqlite3.Error) as error:
            raise _cannot(self.path, error) from error
        log.warning("journal: %d readings carried over from %s", max(0, count), aside.name)
        return db

    def _remark(self, text: str) -> None:
        log.error("journal: %s", text)
        self.note = text


def _cannot(path: Path, error: Exception) -> DiskError:
    return DiskError(f"journal {path}: {error}", "check the disk's space, mount and owner (df, mount, ls -l)")


def _values(reading: ReadingHeader, *, owed: bool) -> tuple[object, ...]:
    text = reading.model_dump_json()
    return (
        reading.sequence,
        _utc_text(reading.acquired_at),
        reading.conductor,
        str(reading.quality.validity),
        text,
        checksum(reading.sequence, reading.conductor, text),
        "pending" if owed else "local",
        None,
    )


def _utc_text(instant: datetime) -> str:
    return instant.astimezone(UTC).isoformat(timespec="microseconds")
