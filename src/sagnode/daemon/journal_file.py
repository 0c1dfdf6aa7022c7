"""The journal's file: its schema, its checks at opening, and what is done with a damaged one."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from sagnode.errors import JournalError

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
COLUMNS = "sequence, acquired_at, conductor, validity, json, crc, fate, delivered_at"
INSERT = f"INSERT INTO readings ({COLUMNS}) VALUES (?,?,?,?,?,?,?,?)"  # noqa: S608 - fixed words
QUARANTINE_MAX = 3
"""So many damaged files are kept; they must not fill the card."""


def open_file(path: Path) -> sqlite3.Connection:
    """Open, check and migrate; raises sqlite3.DatabaseError on damage, JournalError on a later version."""
    db = sqlite3.connect(path, timeout=10.0, isolation_level=None, check_same_thread=False)
    db.text_factory = text_of
    with contextlib.ExitStack() as undo:
        undo.callback(db.close)
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
        undo.pop_all()
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
def transaction(db: sqlite3.Connection) -> Iterator[None]:
    """All or nothing."""
    db.execute("BEGIN IMMEDIATE")
    try:
        yield
        db.execute("COMMIT")
    finally:
        # After some disk errors SQLite has rolled back already; a second rollback is then an error of its own.
        if db.in_transaction:
            db.execute("ROLLBACK")


def is_damage(error: sqlite3.DatabaseError) -> bool:
    """Whether this error means a damaged file, not a full or forbidden disk."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is not None:
        # A sector that can be read no more is damage as well: renamed and read around, it costs its neighbours only.
        unreadable = {sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_SHORT_READ, sqlite3.SQLITE_IOERR_CORRUPTFS}
        return code in unreadable or (code & 0xFF) in {
            sqlite3.SQLITE_CORRUPT,
            sqlite3.SQLITE_NOTADB,
            sqlite3.SQLITE_ERROR,
        }
    return "malformed" in str(error) or "not a database" in str(error)


def set_aside(path: Path) -> Path:
    """Rename a damaged file and its companions; returns the new name."""
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


def remove(path: Path) -> None:
    """Delete a database with its companions, as far as they are there.

    Raises:
        OSError: the disk refuses.
    """
    for suffix in ("-wal", "-shm", ""):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def forget_old_quarantine(path: Path) -> None:
    """Keep the newest damaged files only."""
    kept = sorted(path.parent.glob(f"{path.stem}-damaged-*{path.suffix}"), key=lambda file: file.stat().st_mtime)
    for file in kept[:-QUARANTINE_MAX]:
        remove(file)


def text_of(data: bytes) -> str:
    """Damaged text is text all the same; its checksum tells."""
    return data.decode(errors="replace")


def checksum(sequence: object, conductor: object, text: object) -> int:
    """Over all that a consumer will see; whatever a damaged row holds instead of text is covered as well."""
    return zlib.crc32(f"{sequence}\n{conductor}\n{text}".encode(errors="replace"))


def described(text: str) -> tuple[int, str, str, str]:
    """The columns before the text, out of the text: number, time of acquisition, conductor, validity.

    Raises:
        ValueError, KeyError, TypeError: it is no reading.
    """
    reading = json.loads(text)
    acquired_at = datetime.fromisoformat(reading["acquired_at"]).astimezone(UTC).isoformat(timespec="microseconds")
    return reading["sequence"], acquired_at, reading["conductor"], reading["quality"]["validity"]


def is_sound(row: tuple[object, ...]) -> bool:
    """Whether a row, with the columns of COLUMNS, holds what was once written."""
    sequence, _, conductor, _, text, crc, fate, _ = row
    return checksum(sequence, conductor, text) == crc and fate != "damaged"
