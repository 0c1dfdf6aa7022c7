"""``sagnode export``: readings out of the journal for a spreadsheet or a program."""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from sagnode.cli.journal_words import add_filters, journal_path, wanted
from sagnode.daemon.journal_reader import Rows, Stored
from sagnode.errors import SagnodeError
from sagnode.message import QUANTITIES, SEEN
from sagnode.outfile import whole_text

DESCRIPTION = """Write readings of the journal, oldest first. CSV has one row a reading and a column for every value,
its standard uncertainty and its 95 % interval (empty where there is none); JSON lines are the published messages with
their delivery. Works beside the running service and without it."""
EPILOG = "exit codes: 0 fine, 1 no journal, or damaged readings in it were left out, 2 usage or bad configuration"

HEADER = ("sequence", "acquired_at", "utility", "line", "span", "unit", "conductor", "phase")
TRAILER = ("clock_synced", *SEEN, "calibration_id", "configuration_id", "software_version")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which readings, what form, where to."""
    add_filters(parser)
    parser.add_argument("--format", choices=("csv", "jsonl"), default="csv", help="default: csv")
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: standard output")


def run(args: argparse.Namespace) -> int:
    """Write."""
    rows = Rows(journal_path(args), wanted(args, None))
    write = _write_csv if args.format == "csv" else _write_jsonl
    with _opened(args.out) as stream:
        count = write(stream, rows)
    if args.out:
        print(f"wrote {count} readings to {args.out}")
    if rows.damaged:
        print(f"sagnode: warning: {rows.damaged} damaged readings were left out", file=sys.stderr)
    return 1 if rows.damaged else 0


@contextmanager
def _opened(path: Path | None) -> Iterator[TextIO]:
    if path is None:
        yield sys.stdout
        return
    try:
        with whole_text(path) as stream:
            yield stream
    except OSError as error:
        raise SagnodeError(f"cannot write {path}: {error.strerror}", "choose another --out") from None


def columns() -> list[str]:
    """Names of the CSV's columns."""
    quantities = [name for quantity in QUANTITIES for name in quantity.fields]
    return [*HEADER, "validity", "detail_qual", "causes", "test", *quantities, *TRAILER, "delivery", "delivered_at"]


def _flat(stored: Stored) -> dict[str, Any]:
    document = stored.document
    quality = document["quality"]
    return {
        **document,
        "validity": quality["validity"],
        "detail_qual": " ".join(quality["detail_qual"]),
        "causes": " ".join(reason["cause"] for reason in quality["reasons"]),
        "test": quality["test"],
        "delivery": stored.delivery,
        "delivered_at": stored.delivered_at,
    }


def _write_csv(stream: TextIO, rows: Rows) -> int:
    writer = csv.DictWriter(stream, columns(), restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    count = 0
    for count, stored in enumerate(rows, start=1):  # noqa: B007 - the count is what is left of it
        writer.writerow(_flat(stored))
    return count


def _write_jsonl(stream: TextIO, rows: Rows) -> int:
    count = 0
    for count, stored in enumerate(rows, start=1):  # noqa: B007 - the same
        document = {**stored.document, "delivery": stored.delivery, "delivered_at": stored.delivered_at}
        stream.write(json.dumps(document, ensure_ascii=False) + "\n")
    return count
