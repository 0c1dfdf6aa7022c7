"""``sagnode config``: write, check and show the configuration."""

from __future__ import annotations

import argparse
import json
import sys
from importlib import resources
from pathlib import Path
from typing import Any

from sagnode.daemon.places import SERVICE_CONFIG, configuration
from sagnode.errors import ConfigError, SagnodeError

DESCRIPTION = "Write, check and show the configuration."
EPILOG = "exit codes: 0 fine (or warnings only), 1 a file cannot be written, 2 usage or bad configuration"

TEMPLATES = ("node.toml", "span.toml")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``init``, ``check`` and ``show``."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="{init,check,show}")
    init = _action(actions, "init", "write a commented node.toml and span.toml to start from")
    init.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="directory to write into (default: here)")
    init.add_argument("--force", action="store_true", help="write over files that are there")
    check = _action(actions, "check", "explain every fault and everything odd in one go")
    _add_config(check)
    check.add_argument("--json", action="store_true", help="as JSON")
    show = _action(actions, "show", "the configuration in effect, defaults included")
    _add_config(show)
    show.add_argument("--changed", action="store_true", help="only what differs from the defaults")
    show.add_argument("--json", action="store_true", help="as JSON")


def _action(actions: Any, name: str, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = actions.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    return parser


def _add_config(parser: argparse.ArgumentParser) -> None:
    text = f"node file, span file, or the directory of node.toml (default: {SERVICE_CONFIG})"
    parser.add_argument("--config", type=Path, metavar="PATH", help=text)


def run(args: argparse.Namespace) -> int:
    """Run the action."""
    if args.action == "init":
        return _init(args.out, args.force)
    config = configuration(args.config)
    if args.action == "check":
        return _check(config, args.json)
    return _show(config, args.changed, args.json)


def _init(directory: Path, force: bool) -> int:
    there = [str(directory / name) for name in TEMPLATES if (directory / name).exists()]
    if there and not force:
        raise ConfigError(f"already there: {', '.join(there)}", "give another directory with --out, or --force")
    templates = resources.files("sagnode.config") / "templates"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name in TEMPLATES:
            (directory / name).write_text((templates / name).read_text(encoding="utf-8"), encoding="utf-8")
            print(f"wrote {directory / name}")
    except OSError as error:
        what = f"cannot write {error.filename or directory}: {error.strerror}"
        raise SagnodeError(what, "choose another directory with --out") from None
    print("Fill in both, put the camera's calibration beside them (sagnode calibrate), click the landmarks in a")
    print("picture of it (sagnode capture), then look them over:")
    print(f"  sagnode config check --config {directory / 'node.toml'}")
    return 0


def _check(path: Path, as_json: bool) -> int:
    from sagnode.check.configuration import check

    report = check(path)
    if as_json:
        kinds = (("fault", report.faults), ("warning", report.warnings))
        document = {
            "schema_version": "sagnode.config-check/1",
            "ok": not report.faults,
            "configuration_id": report.loaded.configuration_id if report.loaded else None,
            "findings": [
                {"kind": kind, "file": str(f.path), "line": f.line, "key": f.key, "text": f.text}
                for kind, found in kinds
                for f in found
            ],
        }
        print(json.dumps(document, indent=2, ensure_ascii=False))
        return 2 if report.faults else 0
    for kind, found in (("fault", report.faults), ("warning", report.warnings)):
        for one in found:
            print(f"{kind}: {one}")
    print(_verdict(path, len(report.faults), len(report.warnings)))
    return 2 if report.faults else 0


def _verdict(path: Path, faults: int, warnings: int) -> str:
    if faults:
        return f"{path} cannot be used: {_count(faults, 'fault')}"
    return f"{path} can be used" + (f", with {_count(warnings, 'warning')}" if warnings else "")


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _show(path: Path, changed: bool, as_json: bool) -> int:
    from sagnode.config.load import load_any
    from sagnode.config.show import as_document, as_toml

    loaded = load_any(path)
    if as_json:
        print(json.dumps(as_document(loaded, changed=changed), indent=2, ensure_ascii=False))
    else:
        sys.stdout.write(as_toml(loaded, changed=changed))
    return 0
