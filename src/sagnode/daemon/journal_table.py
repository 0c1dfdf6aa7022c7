"""What is asked of the journal's table of readings, on an open connection.

Nothing here locks, counts or mends: :mod:`sagnode.daemon.journal` does. Every function raises :class:`sqlite3.Error`
when the disk refuses; what writes does it in one transaction, all or nothing.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sagnode.daemon.journal_file import COLUMNS, INSERT, checksum, described, is_sound, transaction
from sagnode.message import ReadingHeader

_DELETE_CHUNK = 500
_ROW = "SELECT sequence, conductor, json, crc FROM readings"

Found = tuple[int, str, str, int]
"""Number, conductor, JSON and checksum, as the file has them."""


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
    oldest_sequence: int | None = None


# -- writing


def insert(db: sqlite3.Connection, readings: Sequence[ReadingHeader], *, owed: bool) -> None:
    """Add numbered readings."""
    with transaction(db):
        db.executemany(INSERT, [_values(reading, owed=owed) for reading in readings])


def insert_missing(db: sqlite3.Connection, rows: Iterable[Sequence[object]]) -> int:
    """Add whole rows, as in COLUMNS, whose numbers are not there; returns how many there were."""
    with transaction(db):
        return db.executemany(f"INSERT OR IGNORE{INSERT.removeprefix('INSERT')}", rows).rowcount


def adopt(db: sqlite3.Connection, rows: Iterable[Sequence[object]]) -> None:
    """Add whole rows of another journal.

    At a second attempt some are here as they were then, and may have been delivered from there since.
    """
    with transaction(db):
        db.executemany(
            f"{INSERT} ON CONFLICT (sequence) DO UPDATE SET fate = excluded.fate, delivered_at = excluded.delivered_at"
            " WHERE excluded.fate = 'delivered' AND json = excluded.json",
            rows,
        )


def deliver(db: sqlite3.Connection, sequences: Iterable[int], at: datetime) -> None:
    """The broker acknowledged these."""
    rows = [(_utc_text(at), sequence) for sequence in sequences]
    with transaction(db):
        db.executemany("UPDATE readings SET fate = 'delivered', delivered_at = ? WHERE sequence = ?", rows)


def owe_again(db: sqlite3.Connection, first: int, last: int) -> int:
    """Owe the readings from ``first`` to ``last`` once more; returns how many were not owed."""
    with transaction(db):
        return db.execute(
            "UPDATE readings SET fate = 'pending', delivered_at = NULL"
            " WHERE sequence BETWEEN ? AND ? AND fate IN ('delivered', 'local')",
            (first, last),
        ).rowcount


def set_damaged_aside(db: sqlite3.Connection, sequence: int) -> None:
    """Keep a row that fails its checksum, but hand it out no more."""
    with transaction(db):
        db.execute("UPDATE readings SET fate = 'damaged' WHERE sequence = ?", (sequence,))


def delete_before(db: sqlite3.Connection, acquired_at: datetime) -> None:
    """Delete some of what is not owed and older, oldest first."""
    _delete(db, "fate <> 'pending' AND acquired_at < ?", (_utc_text(acquired_at),))


def shrink(db: sqlite3.Connection, max_bytes: float, *, owed: bool) -> int:
    """Delete what is owed, or what is not, oldest first, until the content is small enough; returns how many.

    The newest reading of all stays, because it carries the count.
    """
    condition = "fate = 'pending'" if owed else "fate <> 'pending'"
    count = 0
    while used_bytes(db) > max_bytes and (deleted := _delete(db, condition)):
        count += deleted
    return count


def _delete(db: sqlite3.Connection, condition: str, values: tuple[str, ...] = ()) -> int:
    with transaction(db):
        return db.execute(
            "DELETE FROM readings WHERE sequence IN (SELECT sequence FROM readings"  # noqa: S608 - fixed words
            f" WHERE {condition} AND sequence < (SELECT max(sequence) FROM readings) ORDER BY sequence LIMIT ?)",
            (*values, _DELETE_CHUNK),
        ).rowcount


# -- reading


def newest(db: sqlite3.Connection) -> int | None:
    """The highest number; None in an empty table."""
    found = db.execute("SELECT max(sequence) FROM readings").fetchone()[0]
    return None if found is None else int(found)


def newest_by_conductor(db: sqlite3.Connection, after: int) -> dict[str, int]:
    """Of each conductor its highest number above ``after``."""
    return dict(
        db.execute("SELECT conductor, max(sequence) FROM readings WHERE sequence > ? GROUP BY conductor", (after,))
    )


def committed(db: sqlite3.Connection, reading: ReadingHeader, after: int) -> ReadingHeader | None:
    """This reading as it was committed under a number above ``after``; None when it never was."""
    rows = db.execute(
        "SELECT sequence, json FROM readings WHERE sequence > ? AND acquired_at = ? AND conductor = ?",
        (after, _utc_text(reading.acquired_at), reading.conductor),
    ).fetchall()
    same = (reading.model_copy(update={"sequence": sequence}) for sequence, _ in rows)
    texts = {text for _, text in rows}
    return next((copy for copy in same if copy.model_dump_json() in texts), None)


def owed(db: sqlite3.Connection, after: int, limit: int) -> list[Found]:
    """What is owed with a higher number than ``after``, oldest first."""
    query = f"{_ROW} WHERE fate = 'pending' AND sequence > ? ORDER BY sequence LIMIT ?"
    return db.execute(query, (after, limit)).fetchall()


def owed_one(db: sqlite3.Connection, sequence: int) -> list[Found]:
    """The reading of this number, if it is owed."""
    return db.execute(f"{_ROW} WHERE fate = 'pending' AND sequence = ?", (sequence,)).fetchall()


def last(db: sqlite3.Connection, limit: int) -> list[Found]:
    """The newest readings, owed or not, oldest first."""
    query = f"{_ROW} WHERE fate <> 'damaged' ORDER BY sequence DESC LIMIT ?"
    return db.execute(query, (limit,)).fetchall()[::-1]


def sound_rows(db: sqlite3.Connection, chunk: int) -> Iterator[list[tuple[Any, ...]]]:
    """Whole rows, as in COLUMNS, that pass their checksums, in their order and so many at a time."""
    found = db.execute(f"SELECT {COLUMNS} FROM readings ORDER BY sequence")  # noqa: S608 - fixed words
    while rows := found.fetchmany(chunk):
        yield [row for row in rows if is_sound(row)]


def sound(found: Found) -> Row | None:
    """The reading, None when it fails its checksum."""
    sequence, conductor, text, crc = found
    return Row(sequence, conductor, text) if checksum(sequence, conductor, text) == crc else None


def restored(db: sqlite3.Connection, found: Found) -> Row | None:
    """A reading that fails its checksum because another column than its text is damaged, written anew from its text."""
    sequence, _, text, crc = found
    try:
        number, acquired_at, conductor, validity = described(text)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    if number != sequence or checksum(sequence, conductor, text) != crc:
        return None
    with transaction(db):
        db.execute(
            "UPDATE readings SET acquired_at = ?, conductor = ?, validity = ? WHERE sequence = ?",
            (acquired_at, conductor, validity, sequence),
        )
    return Row(sequence, conductor, text)


def backlog(db: sqlite3.Connection) -> Backlog:
    """How much is owed, and how old the oldest is."""
    depth = db.execute("SELECT count(*) FROM readings WHERE fate = 'pending'").fetchone()[0]
    first = "SELECT acquired_at, sequence FROM readings WHERE fate = 'pending' ORDER BY sequence LIMIT 1"
    oldest = db.execute(first).fetchone()
    return Backlog(depth, datetime.fromisoformat(oldest[0]), oldest[1]) if oldest else Backlog(depth, None)


def used_bytes(db: sqlite3.Connection) -> int:
    """Size of the content; the file itself does not shrink, its free pages are used again."""
    page, count, free = (
        db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_size", "page_count", "freelist_count")
    )
    return int(page * (count - free))


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
