"""Readings out of the journal for ``sagnode history`` and ``sagnode export``: read-only, beside a running daemon."""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import sqlite3
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from sagnode.daemon.places import state_directory
from sagnode.errors import JournalError

JOURNAL = "journal.sqlite"
SERVICE_STATE = Path("/var/lib/sagnode")
"""Where the installed service keeps its state; looked at when the user has none of his own."""
_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}


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
                    # The checksum that the journal gives every row (sagnode.daemon.journal).
                    if fate != "damaged" and zlib.crc32(f"{sequence}\n{conductor}\n{text}".encode()) == crc:
                        yield Stored(json.loads(text), fate, delivered_at)
                    else:
                        self.damaged += 1
            except sqlite3.Error as error:
                raise JournalError(f"journal {self._path}: {error}", "the service mends it when it starts") from None


def add_filters(parser: argparse.ArgumentParser) -> None:
    """Arguments that say which journal and which readings."""
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--config", type=Path, metavar="PATH", help="node file, for its state directory")
    place.add_argument("--state-dir", type=Path, metavar="DIR", help="the state directory itself")
    parser.add_argument("--conductor", metavar="ID", help="only this one")
    parser.add_argument("--validity", choices=("good", "questionable", "invalid"), help="only these")
    text = "a time such as 2026-06-21T04:00Z, or an age such as 90m, 24h, 7d, 2w"
    parser.add_argument("--since", type=moment, metavar="TIME", help=text)
    parser.add_argument("--until", type=moment, metavar="TIME", help="the same")


def wanted(args: argparse.Namespace, last: int | None) -> Wanted:
    """The filters of a command line."""
    return Wanted(args.conductor, args.validity, args.since, args.until, last)


def journal_path(args: argparse.Namespace) -> Path:
    """The journal that the command line means.

    Raises:
        ConfigError: the node file cannot be used.
        JournalError: there is no journal.
    """
    if args.config:
        from sagnode.config.load import load_node

        directory = state_directory(load_node(args.config).node.storage.state_dir)
    else:
        directory = args.state_dir or state_directory(None)
        if args.state_dir is None and not (directory / JOURNAL).exists() and (SERVICE_STATE / JOURNAL).exists():
            directory = SERVICE_STATE
    path: Path = directory / JOURNAL
    if not path.exists():
        remedy = "name the node's directory with --state-dir, or its file with --config; sagnode run makes the journal"
        raise JournalError(f"there is no journal at {path}", remedy)
    return path


def moment(text: str, now: datetime | None = None) -> datetime:
    """A time with its zone, or an age before now.

    >>> moment("2h", datetime(2026, 6, 21, 12, tzinfo=UTC)).isoformat()
    '2026-06-21T10:00:00+00:00'

    Raises:
        argparse.ArgumentTypeError: it is neither.
    """
    age = re.fullmatch(r"(\d{1,6})([mhdw])", text)
    try:
        if age:
            return (now or datetime.now(UTC)) - timedelta(**{_UNITS[age[2]]: int(age[1])})
        time = datetime.fromisoformat(text)
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(
            f"'{text}' is no time such as 2026-06-21T04:00Z and no age such as 24h"
        ) from None
    # Without a zone it is UTC, as everything that sagnode prints.
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def _open(path: Path) -> sqlite3.Connection:
    try:
        db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=10.0)
        db.text_factory = _text
        db.execute("SELECT 1 FROM readings LIMIT 1")
    except sqlite3.Error as error:
        remedy = "run this as the service's user (sudo -u sagnode sagnode ...), or let the service start and mend it"
        raise JournalError(f"journal {path}: {error}", remedy) from None
    return db


def _text(data: bytes) -> str:
    """Damaged text is text all the same; its checksum tells."""
    return data.decode(errors="replace")


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
