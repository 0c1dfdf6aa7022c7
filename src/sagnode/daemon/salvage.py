"""What can still be read of a damaged journal.

First SQLite is asked, range by range, so that damage costs only its neighbours. Whatever it does not find any more,
because the way there led through a damaged page, is then looked for in the raw bytes: a reading's JSON is stored in one
piece with its checksum behind it. Only what passes its checksum is believed.
"""

from __future__ import annotations

import contextlib
import heapq
import json
import mmap
import os
import re
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from sagnode.daemon.files import sync_directory
from sagnode.daemon.journal_file import (
    COLUMNS,
    INSERT,
    checksum,
    described,
    forget_old_quarantine,
    is_sound,
    open_file,
    remove,
    set_aside,
    text_of,
    transaction,
)

_CHUNK = 5
"""Where so few numbers in a row cannot be read, they are given up."""
_FAILURES_MAX = 500
"""So often SQLite is asked in vain; what it does not give by then is looked for in the bytes."""
_JSON_MAX = 65536
_BEGUN, _MENDED = ".begun", ".mended"
"""A new journal beside the damaged one while it is filled, and when it is whole."""
_BEGIN = re.compile(rb'\{"schema_version":"sagnode\.reading/')
_FATES = {"pending", "delivered", "local"}
_CRC_BYTES = (4, 6, 8, 3, 2, 1)
"""Sizes of a whole number in SQLite's record format (https://www.sqlite.org/fileformat2.html#record_format)."""

Row = tuple[object, ...]


def start_afresh(path: Path, up_to: int) -> tuple[sqlite3.Connection, Path, int]:
    """Begin a new journal with what can be read of a damaged one, and set that one aside under a name of its own.

    It can be cut short anywhere, by a kill or with the power, and begun again.

    Args:
        path: the damaged file, with its log beside it.
        up_to: no number above this one was ever used.

    Returns:
        The new journal, the damaged one's new name, and how many readings were carried over.

    Raises:
        OSError: the disk refuses.
        sqlite3.Error: the same, said by SQLite.
    """
    begun = _beside(path, _BEGUN)
    remove(begun)  # of an attempt that was cut short
    with contextlib.ExitStack() as undo:
        undo.callback(remove, begun)
        db = open_file(begun)
        undo.callback(db.close)
        with transaction(db):
            count = db.executemany(INSERT, salvage(path, up_to)).rowcount
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        db.close()
        begun.rename(_beside(path, _MENDED))
        undo.pop_all()
    sync_directory(path.parent)
    aside = put_in_place(path)
    if aside is None:
        raise FileNotFoundError(f"{_beside(path, _MENDED)} was taken away")
    forget_old_quarantine(path)
    return open_file(path), aside, max(0, count)


def put_in_place(path: Path) -> Path | None:
    """The second half of :func:`start_afresh`, also for one that was cut short between the two.

    Until the new journal is whole the damaged one stays where it is, and untouched; from then on it goes aside first.

    Returns:
        The damaged one's new name; None when there is no new one that waits.

    Raises:
        OSError: the disk refuses.
    """
    mended = _beside(path, _MENDED)
    if not mended.exists():
        return None
    aside = set_aside(path)
    # A damaged log beside the new journal would be taken for its own.
    sync_directory(path.parent)
    mended.rename(path)
    sync_directory(path.parent)
    return aside


class KeptLog:
    """A copy of a damaged write-ahead log, for as long as not all of its readings are back in the journal.

    Args:
        log_file: the log.
    """

    def __init__(self, log_file: Path) -> None:
        self._log_file = log_file
        self._path = _beside(log_file, ".kept")

    def keep(self) -> None:
        """Copy it if it is there, behind what is kept of an earlier one.

        Raises:
            OSError: the disk refuses.
        """
        if not self._log_file.exists():
            return
        log_now = self._log_file.read_bytes()
        if self._path.exists() and self._path.read_bytes().endswith(log_now):
            return  # a journal that cannot be opened is tried every minute
        with self._path.open("ab") as copy:
            copy.write(log_now)
            copy.flush()
            os.fsync(copy.fileno())
        sync_directory(self._path.parent)

    def rows(self) -> dict[int, Row]:
        """Every reading that is whole in it."""
        return raw_rows([self._path])

    def forget(self) -> None:
        """All of them are in the journal."""
        self._path.unlink(missing_ok=True)


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


def salvage(path: Path, up_to: int) -> Iterator[Row]:
    """Rows that can still be read and pass their checksum, each once.

    Args:
        path: the damaged file, with its log beside it.
        up_to: no number above this one was ever used.
    """
    seen: set[int] = set()
    patched = _beside(path, ".salvage")
    found = raw_rows([path, _beside(path, "-wal")])
    with contextlib.suppress(OSError):
        shutil.copyfile(path, patched)
        with patched.open("r+b") as stream:
            # A file that was cut short is refused as a whole, unless its header does not vouch for the length
            # ("version-valid-for number", https://www.sqlite.org/fileformat2.html#database_header).
            stream.seek(92)
            stream.write(bytes(4))
    for file in (path, patched):
        # Read-only: SQLite must not fold the damaged log into the file, which may have to be read again.
        uri = f"{file.absolute().as_uri()}?mode=ro"
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(uri, uri=True)) as db:
            db.text_factory = text_of
            for row in _readable(db, up_to):
                sequence = row[0]
                if isinstance(sequence, int) and sequence not in seen and is_sound(row):
                    seen.add(sequence)
                    yield _owed_if_unsure(row)
    for sequence in sorted(found.keys() - seen):
        if sequence <= up_to:
            yield found[sequence]
    remove(patched)


def _owed_if_unsure(row: Row) -> Row:
    """A reading whose fate cannot be read is sent again rather than never."""
    text, crc, fate, delivered_at = row[4:]
    return row if fate in _FATES else (*described(str(text)), text, crc, "pending", delivered_at)


def _readable(db: sqlite3.Connection, up_to: int) -> Iterator[Row]:
    """Every row that comes without an error: a range of numbers that gives one is halved, the largest ranges first."""
    query = f"SELECT {COLUMNS} FROM readings WHERE sequence > ? AND sequence <= ? ORDER BY sequence"  # noqa: S608 - fixed words
    ranges = [(-up_to, 0)]  # a heap of (minus length, start)
    failures = 0
    while ranges and failures < _FAILURES_MAX:
        length, start = heapq.heappop(ranges)
        end, reached = start - length, start
        try:
            for row in db.execute(query, (start, end)):
                reached = row[0] if isinstance(row[0], int) else reached
                yield row
        except sqlite3.Error:
            failures += 1
            left = end - reached
            if left > _CHUNK:
                half = left // 2
                heapq.heappush(ranges, (-half, reached))
                heapq.heappush(ranges, (half - left, reached + half))


def raw_rows(files: list[Path]) -> dict[int, Row]:
    """Rows by their bytes alone; of several versions of one row the delivered one, for that is the later."""
    found: dict[int, Row] = {}
    for file in files:
        with (
            contextlib.suppress(OSError, ValueError),  # ValueError: an empty file
            file.open("rb") as stream,
            mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data,
        ):
            for match in _BEGIN.finditer(data):
                row = _row_at(data[match.start() : match.start() + _JSON_MAX])
                if row is not None and isinstance(row[0], int) and not _is_later(found.get(row[0]), row):
                    found[row[0]] = row
    return found


def _is_later(known: Row | None, row: Row) -> bool:
    return known is not None and known[6] == "delivered" and row[6] != "delivered"


def _row_at(data: bytes) -> Row | None:
    """The row whose JSON begins here, None when it is not whole."""
    try:
        # As latin-1 a character is a byte, so that the end that JSON finds is an offset into the bytes.
        _, end = json.JSONDecoder().raw_decode(data.decode("latin-1"))
        text = data[:end].decode()
        before = described(text)
    except (ValueError, KeyError, TypeError):
        return None
    for size in _CRC_BYTES:
        crc = int.from_bytes(data[end : end + size], "big", signed=True)
        if crc == checksum(before[0], before[2], text):
            behind = data[end + size :]
            fate = next((name for name in _FATES if behind.startswith(name.encode())), "pending")
            return (*before, text, crc, fate, None)
    return None
