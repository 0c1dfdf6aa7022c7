"""Readings out of a journal for whoever asks: read-only, beside a running daemon, in a process of its own."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sagnode.daemon.journal_file import checksum, text_of
from sagnode.errors import JournalError


@dataclass(frozen=True)
class Stored:
    """One reading of the journal."""

    document: dict[str, Any]
    """As it is published (:class:`sagnode.message.Reading`)."""
    delivery: str
    """pending, delivered, or local (no broker is configured)."""
    delivered_at: str | None


@dataclass(frozen=True)
class Wanted:
    """Which readings; None is no restriction."""

    conductor: str | None = None
    validity: str | None = None
    since: datetime | None = None
    until: datetime | None = None
    last: int | None = None
    """Only so many, the newest."""


class Rows:
    """The readings that are wanted, oldest first; :attr:`damaged` counts those left out, when the iteration is over."""

    def __init__(self, path: Path, wanted: Wanted) -> None:
        self._path = path
        self._wanted = wanted
        self.damaged = 0

    def __iter__(self) -> Iterator[Stored]:
        """Read.

        Raises:
            JournalError: the journal cannot be opened or read.
        """
        with contextlib.closing(_open(self._path)) as db:
            try:
                for sequence, conductor, text, crc, fate, delivered_at in db.execute(*_query(self._wanted)):
                    if fate != "damaged" and checksum(sequence, conductor, text) == crc:
                        yield Stored(json.loads(text), fate, delivered_at)
                    else:
                        self.damaged += 1
            except sqlite3.Error as error:
                raise JournalError(f"journal {self._path}: {error}", "the service mends it when it starts") from None


def _open(path: Path) -> sqlite3.Connection:
    try:
        db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=10.0)
        db.text_factory = text_of
        db.execute("SELECT 1 FROM readings LIMIT 1")
    except sqlite3.Error as error:
        remedy = "run this as the service's user (sudo -u sagnode sagnode ...), or let the service start and mend it"
        raise JournalError(f"journal {path}: {error}", remedy) from None
    return db


def _query(wanted: Wanted) -> tuple[str, list[object]]:
    conditions: list[str] = ["1"]
    values: list[object] = []
    for condition, value in (
        ("conductor = ?", wanted.conductor),
        ("validity = ?", wanted.validity),
        ("acquired_at >= ?", _stamp(wanted.since)),
        ("acquired_at <= ?", _stamp(wanted.until)),
    ):
        if value is not None:
            conditions.append(condition)
            values.append(value)
    columns = "sequence, conductor, json, crc, fate, delivered_at"
    query = f"SELECT {columns} FROM readings WHERE {' AND '.join(conditions)} ORDER BY sequence"  # noqa: S608 - fixed words
    if wanted.last is not None:
        query = f"SELECT * FROM ({query} DESC LIMIT ?) ORDER BY sequence"  # noqa: S608 - the same words
        values.append(wanted.last)
    return query, values


def _stamp(time: datetime | None) -> str | None:
    """As the journal writes times, so that text order is time order."""
    return time.isoformat(timespec="microseconds") if time else None
