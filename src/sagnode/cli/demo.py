"""``sagnode demo``: a simulated day of one span, by the real daemon."""

from __future__ import annotations

import argparse
from pathlib import Path

DESCRIPTION = """Replays a day of rendered frames of a 110 kV span with three conductors through the real daemon, on a
clock that skips idle time, and prints every reading as it arrives at a subscriber. Where the configuration names no
broker one is brought along (mosquitto if installed, else amqtt). Afterwards there is a plot of the day against the
simulated truth, and an overlay of one frame."""
EPILOG = "exit codes: 0 every reading arrived, 1 readings were lost or the daemon failed, 2 usage or bad configuration"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Where to write, and which site."""
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), metavar="DIR", help="for all that is made (default: out/demo)"
    )
    site = parser.add_mutually_exclusive_group()
    site.add_argument("--site", type=Path, metavar="DIR", help="another site: a directory with node.toml")
    site.add_argument("--config", type=Path, metavar="PATH", help="another node file; its [mqtt], if any, is used")
    parser.add_argument(
        "--broker", choices=("mosquitto", "amqtt"), help="insist on one where the configuration names none"
    )


def run(args: argparse.Namespace) -> int:
    """Run the day."""
    from importlib.resources import files

    from sagnode.demo.driver import demonstrate

    config = args.config or args.site or Path(str(files("sagnode.demo") / "site"))
    return demonstrate(config, args.out, args.broker)
