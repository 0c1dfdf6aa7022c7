"""``sagnode doctor``: is this node fit for work, and if not, what is to be done?"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from sagnode.daemon.places import SERVICE_CONFIG
from sagnode.errors import ConfigError

if TYPE_CHECKING:
    from sagnode.doctor.findings import Finding

DESCRIPTION = """Look a node over before it is trusted, or when it does not do what it should: configuration, state
directory and journal, calibration, reference picture, camera and a reading through it, the broker step by step, clock,
watchdogs, service, compiled kernels, versions. It changes nothing, publishes nothing, and may run beside the daemon:
the camera and the broker's log-in are then the daemon's, and what it says of them counts."""
EPILOG = """exit codes: 0 no fault (there may be warnings), 1 a check failed, 2 usage or bad configuration;
a bundle contains host names, the survey, logs and pictures, but no passwords and no keys: look before you send it"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which node, what to leave out, and where to put the bundle."""
    parser.add_argument(
        "--config", type=Path, metavar="PATH", help=f"node file or its directory (default: {SERVICE_CONFIG})"
    )
    parser.add_argument("--json", action="store_true", help="everything, as JSON")
    parser.add_argument("--bundle", type=Path, metavar="FILE", help="also pack findings, logs and pictures (.tar.gz)")
    parser.add_argument(
        "--skip", action="append", default=[], choices=["camera", "broker", "system"], help="leave out; may be repeated"
    )


def run(args: argparse.Namespace) -> int:
    """Look, show, pack."""
    from sagnode.doctor import examine as round_
    from sagnode.doctor.findings import faults

    config = args.config or SERVICE_CONFIG
    if not config.exists():
        raise ConfigError(f"{config}: no such file or directory", "name the node file with --config")
    made = []
    for finding in round_.examine(config, args.skip):
        made.append(finding)
        if not args.json:
            _show(finding)
    document = round_.document(config, made)
    if args.json:
        print(json.dumps(document, indent=2, ensure_ascii=False))
    else:
        counts = ", ".join(f"{number} {level}" for level, number in document["count"].items() if number)
        print(f"\n{document['verdict']}: {counts}")
    if args.bundle is not None:
        from sagnode.doctor.bundle import write_bundle

        size = write_bundle(args.bundle, document, config, round_.state_dir_of(config))
        print(f"wrote {args.bundle}, {size / 1e6:.1f} MB", file=sys.stderr if args.json else sys.stdout)
    failed = faults(made)
    if any(finding.check == round_.CONFIGURATION for finding in failed):
        return 2
    return 1 if failed else 0


def _show(finding: Finding) -> None:
    print(f"{finding.level:<8} {finding.check}: {finding.text}", flush=True)
    if finding.remedy and finding.level in {"warning", "fault"}:
        print(f"{'':<8} remedy: {finding.remedy}", flush=True)
