"""Which journal, and which of its readings: the words that ``sagnode history`` and ``sagnode export`` share."""

from __future__ import annotations

import argparse
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sagnode.daemon.journal_reader import Wanted
from sagnode.daemon.places import JOURNAL, SERVICE_STATE, state_directory
from sagnode.errors import JournalError

_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}


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
    try:
        found = path.exists()
    except OSError as error:
        remedy = "run this as the service's user: sudo -u sagnode sagnode ..."
        raise JournalError(f"journal {path}: {error.strerror}", remedy) from None
    if not found:
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
        # Without a zone it is UTC, as everything that sagnode prints.
        return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(
            f"'{text}' is no time such as 2026-06-21T04:00Z and no age such as 24h"
        ) from None
