#!/usr/bin/env python3
"""Holds the pinned packages against the known advisories about them.

    scripts/audit.py [--database CHECKOUT] [REQUIREMENTS...]

With today's advisories, by pip-audit, which asks PyPI (it is installed into build/audit the first time); or, without
the network, with those in a checkout of https://github.com/pypa/advisory-database. REQUIREMENTS are requirements files
of pip with exact versions (default: what units get and packages are built with, deploy/requirements-*.txt). Exit code 1
when a pinned version is affected, 2 when that could not be found out for every one of them.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import venv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

ROOT = Path(__file__).parents[1]
TOOL = ROOT / "build" / "audit"
_LIMIT_S = 600.0
_OFFLINE = "with a checkout of https://github.com/pypa/advisory-database: make audit DATABASE=DIRECTORY"
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)", re.MULTILINE)


def pins(file: Path) -> dict[str, Version]:
    """Package names, normalised, and their exact versions."""
    return {canonicalize_name(name): Version(version) for name, version in _PIN.findall(file.read_text())}


def advisories(database: Path, package: str) -> Iterator[dict[str, Any]]:
    """Every advisory about a package that was not withdrawn."""
    for file in sorted((database / "vulns" / package).glob("*.yaml")):
        advisory = yaml.safe_load(file.read_text(encoding="utf-8"))
        if not advisory.get("withdrawn"):
            yield advisory


def affects(advisory: dict[str, Any], package: str, version: Version) -> bool:
    """Whether a version is listed, or lies between an introduction and the next fix (OSV schema, evaluation)."""
    for affected in advisory.get("affected", []):
        if canonicalize_name(affected["package"]["name"]) != package:
            continue
        if str(version) in affected.get("versions", []):
            return True
        for span in affected.get("ranges", []):
            if span["type"] == "ECOSYSTEM" and _within(span["events"], version):
                return True
    return False


def _within(events: list[dict[str, str]], version: Version) -> bool:
    inside = False
    for event in events:
        (kind, text), *_ = event.items()
        try:
            reached = text == "0" or version >= Version(text)
            beyond = kind == "last_affected" and version > Version(text)
        except InvalidVersion:
            continue
        if kind == "introduced" and reached:
            inside = True
        elif (kind == "fixed" and reached) or beyond:
            inside = False
    return inside


def audit_offline(database: Path, files: list[Path]) -> int:
    """Look everything up in a checkout; one line a file and one a finding."""
    found = 0
    for file in files:
        pinned, known = pins(file), 0
        for package, version in pinned.items():
            for advisory in advisories(database, package):
                known += 1
                if affects(advisory, package, version):
                    found += 1
                    print(f"{package} {version}: {advisory['id']} {', '.join(advisory.get('aliases', []))}")
        print(f"{file.name}: {len(pinned)} packages, {known} advisories about them")
    print(f"{found} of the pinned versions' advisories apply; the database is of {_date(database)}")
    return 1 if found else 0


def audit_online(files: list[Path]) -> int:
    """Have pip-audit ask for every file."""
    worst = 0
    for file in files:
        words = [
            _pip_audit(),
            "--progress-spinner=off",
            "--format=json",
            "--disable-pip",
            "--require-hashes",
            "-r",
            file,
        ]
        said = subprocess.run(words, capture_output=True, text=True, check=False, timeout=_LIMIT_S)
        try:
            report = json.loads(said.stdout)
        except json.JSONDecodeError:
            last = (said.stderr.strip() or "no word").splitlines()[-1]
            print(_unknown(f"{file.name}: pip-audit gave no answer: {last}"), file=sys.stderr)
            return 2
        worst = max(worst, judge(file.name, report, set(pins(file))))
    return worst


def judge(name: str, report: dict[str, Any], asked: set[str]) -> int:
    """What a report of pip-audit comes to: 0, 1 for a finding, 2 where a package was not looked up.

    pip-audit ends with 0 where it could not find a package at all, and calls that no known vulnerability.
    """
    looked_up = {canonicalize_name(one["name"]): one for one in report["dependencies"] if "skip_reason" not in one}
    found = [(one, hole) for one in looked_up.values() for hole in one["vulns"]]
    for one, hole in found:
        print(f"{one['name']} {one['version']}: {hole['id']} {', '.join(hole.get('aliases', []))}")
    missed = sorted(asked - set(looked_up))
    if missed:
        print(_unknown(f"{name}: no answer about {', '.join(missed)}"), file=sys.stderr)
        return 2
    print(f"{name}: {len(looked_up)} packages looked up with PyPI's advisories of today, {len(found)} apply")
    return 1 if found else 0


def _unknown(what: str) -> str:
    return f"audit: {what}\n       PyPI's advisories are out of reach from here; {_OFFLINE}"


def _pip_audit() -> Path:
    """The program, in an environment of its own: it brings packages that the project has no other use for."""
    program = TOOL / "bin" / "pip-audit"
    if not program.exists():
        venv.create(TOOL, with_pip=True, clear=True)
        words = [TOOL / "bin" / "pip", "install", "--quiet", "--disable-pip-version-check", "pip-audit"]
        said = subprocess.run(words, capture_output=True, text=True, check=False, timeout=_LIMIT_S)
        if said.returncode:
            last = (said.stderr.strip() or "no word").splitlines()[-1]
            sys.exit(_unknown(f"pip could not install pip-audit: {last}"))
    return program


def main() -> int:
    """Look everything up."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--database", type=Path, metavar="CHECKOUT", help="of the advisory database, instead of PyPI")
    parser.add_argument("requirements", type=Path, nargs="*", metavar="REQUIREMENTS")
    args = parser.parse_args()
    files = args.requirements or sorted((ROOT / "deploy").glob("requirements-*.txt"))
    if args.database is None:
        return audit_online(files)
    if not (args.database / "vulns").is_dir():
        parser.error(f"{args.database} is no checkout of the advisory database: it has no directory vulns")
    return audit_offline(args.database, files)


def _date(database: Path) -> str:
    words = ["git", "-C", str(database), "log", "-1", "--format=%cs"]
    said = subprocess.run(words, capture_output=True, text=True, check=False)
    return said.stdout.strip() or "an unknown date"


if __name__ == "__main__":
    sys.exit(main())
