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
import shutil
import sqlite3
import threading
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from sagnode.daemon.sequence import Ceiling
from sagnode.daemon.wal import lost_frames
from sagnode.errors import JournalError
from sagnode.message import ReadingHeader

log = logging.getLogger(__name__)

SCHEMA_VERSION = 1
_MIGRATIONS: dict[int, str] = {
    # user_version 0 is an empty file.
    0: """
    CREATE TABLE readings (
        sequence INTEGER PRIMARY KEY,
        acquired_at TEXT NOT NULL,
        conductor TEXT NOT NULL,
        validity TEXT NOT NULL,
        json TEXT NOT NULL,
        crc INTEGER NOT NULL,
        -- pending: owed to the broker; delivered: PUBACK came; local: no broker is configured; damaged: fails its crc
        fate TEXT NOT NULL CHECK (fate IN ('pending', 'delivered', 'local', 'damaged')),
        delivered_at TEXT
    );
    CREATE INDEX pending ON readings (sequence) WHERE fate = 'pending';
    """,
}
_COLUMNS = "sequence, acquired_at, conductor, validity, json, crc, fate, delivered_at"
_INSERT = f"INSERT INTO readings ({_COLUMNS}) VALUES (?,?,?,?,?,?,?,?)"  # noqa: S608 - fixed words
_DELETE_CHUNK = 500
_SALVAGE_CHUNK = 5
_NEWEST = 500
"""The newest reading of each conductor is looked for among so many last ones."""


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

    Raises:
        JournalError: the directory cannot be written or the file is of a later version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.note = "ok"
        """What health says of the journal."""
        self._lock = threading.RLock()
        self._suspect = False
        self._open_or_mend()

    def _open_or_mend(self) -> None:
        self._ceiling = Ceiling(self.path.with_name("sequence"))
        trusted = self.path.exists()
        if lost_frames(self.path.with_name(self.path.name + "-wal")):
            trusted = False
            self._remark(f"{self.path.name}-wal was damaged; sequence numbers leave a gap")
        try:
            self._db = _open(self.path)
        except sqlite3.DatabaseError as error:
            if not _is_damage(error):
                raise _cannot(self.path, error) from error
            trusted = False
            self._db = self._start_afresh(str(error))
        newest = self._newest()
        self._next = self._ceiling.next_after(newest, trusted=trusted)
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
            JournalError: the disk refuses; nothing was written, and the burst can be tried again.
        """
        with self._lock:
            try:
                if self._suspect:
                    self._reopen()
                numbered = [
                    reading.model_copy(update={"sequence": self._next + offset})
                    for offset, reading in enumerate(readings)
                ]
                self._ceiling.cover(self._next + len(numbered) - 1)
                with _transaction(self._db):
                    self._db.executemany(_INSERT, [_values(reading, owed=owed) for reading in numbered])
            except (OSError, sqlite3.Error) as error:
                # Whatever is not a mere lack of space may mean that file or disk are not what they were.
                self._suspect = getattr(error, "sqlite_errorcode", 0) & 0xFF != sqlite3.SQLITE_FULL
                raise _cannot(self.path, error) from error
            self._next += len(numbered)
            self._latest.update({reading.conductor: reading.sequence for reading in numbered})
        return numbered

    def mark_delivered(self, sequences: Iterable[int], at: datetime) -> None:
        """Remember that the broker acknowledged these.

        Raises:
            JournalError: the disk refuses; they stay owed, and may be repeated after a restart.
        """
        rows = [(_utc_text(at), sequence) for sequence in sequences]
        with self._lock:
            try:
                with _transaction(self._db):
                    self._db.executemany(
                        "UPDATE readings SET fate = 'delivered', delivered_at = ? WHERE sequence = ?", rows
                    )
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
            JournalError: the disk refuses.
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
        with self._lock, contextlib.suppress(sqlite3.Error):
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self._db.close()

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
        if _crc(sequence, conductor, text) == crc:
            return Row(sequence, conductor, text)
        self._remark(f"reading {sequence} is damaged on the disk; set aside")
        with _transaction(self._db):
            self._db.execute("UPDATE readings SET fate = 'damaged' WHERE sequence = ?", (sequence,))
        return None

    def _delete(self, condition: str, values: tuple[str, ...] = ()) -> int:
        with _transaction(self._db):
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
        aside = _set_aside(self.path)
        self._remark(f"damaged ({damage}); kept as {aside.name}, a new one was started")
        try:
            db = _open(self.path)
            rows = list(_salvage(aside, self._ceiling.value))
            with _transaction(db):
                db.executemany(_INSERT, rows)
        except (OSError, sqlite3.Error) as error:
            raise _cannot(self.path, error) from error
        log.warning("journal: %d readings carried over from %s", len(rows), aside.name)
        return db

    def _remark(self, text: str) -> None:
        log.error("journal: %s", text)
        self.note = text


def _open(path: Path) -> sqlite3.Connection:
    """Open, check and migrate; raises sqlite3.DatabaseError on damage, JournalError on a later version."""
    db = sqlite3.connect(path, timeout=10.0, isolation_level=None, check_same_thread=False)
    db.text_factory = _text
    try:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")
        db.execute("PRAGMA wal_autocheckpoint = 256")
        db.execute("PRAGMA journal_size_limit = 2000000")
        verdict = db.execute("PRAGMA quick_check(1)").fetchone()[0]
        if verdict != "ok":
            raise sqlite3.DatabaseError(f"malformed: {verdict}")
        _migrate(db, path)
        # quick_check does not compare an index with its table; a reading that the index forgot would never be sent.
        db.execute("REINDEX pending")
    except BaseException:
        db.close()
        raise
    return db


def _migrate(db: sqlite3.Connection, path: Path) -> None:
    version = db.execute("PRAGMA user_version").fetchone()[0]
    if version > SCHEMA_VERSION:
        raise JournalError(
            f"{path} was written by a later sagnode (schema {version}, this one knows {SCHEMA_VERSION})",
            "install that version again, or move the file away",
        )
    for step in range(version, SCHEMA_VERSION):
        # One transaction a step: a power cut leaves the old or the new schema, never half of one.
        db.executescript(f"BEGIN IMMEDIATE; {_MIGRATIONS[step]} PRAGMA user_version = {step + 1}; COMMIT;")


@contextlib.contextmanager
def _transaction(db: sqlite3.Connection) -> Iterator[None]:
    db.execute("BEGIN IMMEDIATE")
    try:
        yield
        db.execute("COMMIT")
    except BaseException:
        # After some disk errors SQLite has rolled back already; a second rollback is then an error of its own.
        if db.in_transaction:
            db.execute("ROLLBACK")
        raise


def _is_damage(error: sqlite3.DatabaseError) -> bool:
    """Whether this error means a damaged file, not a full or forbidden disk."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is not None:
        return (code & 0xFF) in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR}
    return "malformed" in str(error) or "not a database" in str(error)


def _set_aside(path: Path) -> Path:
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    aside = path.with_name(f"{path.stem}-damaged-{stamp}{path.suffix}")
    number = 1
    while aside.exists():
        number += 1
        aside = path.with_name(f"{path.stem}-damaged-{stamp}-{number}{path.suffix}")
    for suffix in ("-wal", "-shm", ""):
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.rename(aside.with_name(aside.name + suffix))
    return aside


def _salvage(path: Path, up_to: int) -> Iterator[tuple[object, ...]]:
    """Rows that can still be read and pass their checksum, few at a time so that damage costs only its neighbours.

    Args:
        path: the damaged file, with its log beside it.
        up_to: no number above this one was ever used.
    """
    seen: set[int] = set()
    patched = path.with_name(path.name + ".salvage")
    with contextlib.suppress(OSError):
        shutil.copyfile(path, patched)
        with patched.open("r+b") as stream:
            # A file that was cut short is refused as a whole, unless its header does not vouch for the length
            # ("version-valid-for number", https://www.sqlite.org/fileformat2.html#database_header).
            stream.seek(92)
            stream.write(bytes(4))
    for file in (path, patched):
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(file, isolation_level=None)) as db:
            db.text_factory = _text
            for start in range(0, up_to, _SALVAGE_CHUNK):
                for row in _readable(db, start):
                    sequence, _, conductor, _, text, crc, fate, _ = row
                    sound = _crc(sequence, conductor, text) == crc and fate in {"pending", "delivered", "local"}
                    if sound and isinstance(sequence, int) and sequence not in seen:
                        seen.add(sequence)
                        yield row
    for suffix in ("-wal", "-shm", ""):
        patched.with_name(patched.name + suffix).unlink(missing_ok=True)


def _readable(db: sqlite3.Connection, after: int) -> list[tuple[object, ...]]:
    query = f"SELECT {_COLUMNS} FROM readings WHERE sequence > ? AND sequence <= ?"  # noqa: S608 - fixed words
    with contextlib.suppress(sqlite3.Error):
        return db.execute(query, (after, after + _SALVAGE_CHUNK)).fetchall()
    return []


def _cannot(path: Path, error: Exception) -> JournalError:
    return JournalError(f"journal {path}: {error}", "check the disk's space, mount and owner (df, mount, ls -l)")


def _values(reading: ReadingHeader, *, owed: bool) -> tuple[object, ...]:
    text = reading.model_dump_json()
    return (
        reading.sequence,
        _utc_text(reading.acquired_at),
        reading.conductor,
        str(reading.quality.validity),
        text,
        _crc(reading.sequence, reading.conductor, text),
        "pending" if owed else "local",
        None,
    )


def _text(data: bytes) -> str:
    """Damaged text is text all the same; its checksum tells."""
    return data.decode(errors="replace")


def _crc(sequence: object, conductor: object, text: object) -> int:
    """Over all that a consumer will see; whatever a damaged row holds instead of text is covered as well."""
    return zlib.crc32(f"{sequence}\n{conductor}\n{text}".encode(errors="replace"))


def _utc_text(instant: datetime) -> str:
    return instant.astimezone(UTC).isoformat(timespec="microseconds")
