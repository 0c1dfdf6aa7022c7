"""``sagnode run``: the daemon."""

from __future__ import annotations

import argparse
import logging
import os
from pathlib import Path

DESCRIPTION = """Measure on schedule, keep every reading in the journal, publish to the broker. SIGTERM stops it,
SIGHUP has it read its configuration anew (a bad one is refused and the old one stays in force)."""
EPILOG = "exit codes: 0 stopped or replay ended, 1 the state directory cannot be used, 2 usage or bad configuration"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The configuration."""
    parser.add_argument(
        "--config", type=Path, required=True, metavar="PATH", help="node file, or the directory that holds node.toml"
    )


def run(args: argparse.Namespace) -> int:
    """Load, then run until told otherwise."""
    from sagnode.config.guard import exposures
    from sagnode.config.load import load_node
    from sagnode.daemon import logs, node

    os.umask(os.umask(0o077) | 0o027)  # what it writes is its user's and group's, whoever started it
    loaded = load_node(args.config)
    logs.set_up(loaded.node.log_level)
    for _, _, text in exposures(loaded):
        logging.getLogger(__name__).warning("%s", text)
    return node.run(loaded)
