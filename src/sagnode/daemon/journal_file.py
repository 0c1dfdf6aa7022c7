"""The journal's file: its schema, its checks at opening, and what is done with a damaged one."""

from __future__ import annotations

import contextlib
import shutil
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
_SALVAGE_CHUNK = 5


def open_file(path: Path) -> sqlite3.Connection:
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
def transaction(db: sqlite3.Connection) -> Iterator[None]:
    """All or nothing."""
    db.execute("BEGIN IMMEDIATE")
    try:
        yield
        db.execute("COMMIT")
    except BaseException:
        # After some disk errors SQLite has rolled back already; a second rollback is then an error of its own.
        if db.in_transaction:
            db.execute("ROLLBACK")
        raise


def is_damage(error: sqlite3.DatabaseError) -> bool:
    """Whether this error means a damaged file, not a full or forbidden disk."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is not None:
        return (code & 0xFF) in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR}
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


def salvage(path: Path, up_to: int) -> Iterator[tuple[object, ...]]:
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
                    sound = checksum(sequence, conductor, text) == crc and fate in {"pending", "delivered", "local"}
                    if sound and isinstance(sequence, int) and sequence not in seen:
                        seen.add(sequence)
                        yield row
    for suffix in ("-wal", "-shm", ""):
        patched.with_name(patched.name + suffix).unlink(missing_ok=True)


def _readable(db: sqlite3.Connection, after: int) -> list[tuple[object, ...]]:
    query = f"SELECT {COLUMNS} FROM readings WHERE sequence > ? AND sequence <= ?"  # noqa: S608 - fixed words
    with contextlib.suppress(sqlite3.Error):
        return db.execute(query, (after, after + _SALVAGE_CHUNK)).fetchall()
    return []


def _text(data: bytes) -> str:
    """Damaged text is text all the same; its checksum tells."""
    return data.decode(errors="replace")


def checksum(sequence: object, conductor: object, text: object) -> int:
    """Over all that a consumer will see; whatever a damaged row holds instead of text is covered as well."""
    return zlib.crc32(f"{sequence}\n{conductor}\n{text}".encode(errors="replace"))
