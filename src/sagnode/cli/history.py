"""``sagnode history``: the last readings, out of the journal."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from sagnode.cli.journal_words import add_filters, journal_path, wanted
from sagnode.cli.numbers import whole
from sagnode.daemon.journal_reader import Rows, Stored
from sagnode.message import QUANTITIES, Estimate

DESCRIPTION = "List the newest readings of the journal, oldest first. Works beside the running service and without it."
EPILOG = "exit codes: 0 fine, 1 no journal, or damaged readings in it were left out, 2 usage or bad configuration"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which readings."""
    add_filters(parser)
    parser.add_argument("--last", type=whole(1, 1_000_000), default=20, metavar="N", help="how many (default: 20)")
    parser.add_argument("--json", action="store_true", help="as JSON, one object with all readings")


def run(args: argparse.Namespace) -> int:
    """Print a table or JSON."""
    rows = Rows(journal_path(args), wanted(args, args.last))
    readings = list(rows)
    if args.json:
        documents = [{**r.document, "delivery": r.delivery, "delivered_at": r.delivered_at} for r in readings]
        print(json.dumps({"schema_version": "sagnode.history/1", "readings": documents}, indent=2, ensure_ascii=False))
    elif readings:
        print(_table(readings))
    else:
        print("no such readings")
    if rows.damaged:
        print(f"sagnode: warning: {rows.damaged} damaged readings were left out", file=sys.stderr)
    return 1 if rows.damaged else 0


def _table(readings: list[Stored]) -> str:
    from sagnode.cli.readings import clearance_text, sag_text

    lines = [("sequence", "acquired (UTC)", "conductor", "sag (95 %)", "clearance (95 %)", "quality", "delivery")]
    for reading in readings:
        document = reading.document
        found = estimates(document)
        causes = ", ".join(reason["cause"] for reason in document["quality"]["reasons"])
        quality = document["quality"]["validity"] + (f" ({causes})" if causes else "")
        lines.append(
            (
                str(document["sequence"]),
                document["acquired_at"][:19].replace("T", " "),
                document["conductor"],
                sag_text(found.get("sag")),
                clearance_text(found),
                quality,
                reading.delivery,
            )
        )
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join("  ".join(f"{c:<{w}}" for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def estimates(document: dict[str, Any]) -> dict[str, Estimate]:
    """The quantities of a published reading that are not null, by stem."""
    found = {}
    for quantity in QUANTITIES:
        values = [document.get(name) for name in quantity.fields]
        known = [float(value) for value in values if value is not None]
        if len(known) == 4:
            found[quantity.stem] = Estimate(*known)
    return found
