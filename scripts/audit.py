#!/usr/bin/env python3
"""Holds the pinned packages against the Python packaging authority's advisories, without the network.

    scripts/audit.py DATABASE [REQUIREMENTS...]

DATABASE is a checkout of https://github.com/pypa/advisory-database. REQUIREMENTS are requirements files of pip with
exact versions (default: what units get, deploy/requirements-*.txt). Exit code 1 when a pinned version is affected.
Where PyPI can be reached, pip-audit asks for the same with today's advisories:

    pip-audit --disable-pip --require-hashes -r deploy/requirements-trixie.txt
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

ROOT = Path(__file__).parents[1]
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


def main() -> int:
    """Look everything up, and print one line a file and one a finding."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("database", type=Path, metavar="DATABASE")
    parser.add_argument("requirements", type=Path, nargs="*", metavar="REQUIREMENTS")
    args = parser.parse_args()
    if not (args.database / "vulns").is_dir():
        parser.error(f"{args.database} is no checkout of the advisory database: it has no directory vulns")
    files = args.requirements or sorted((ROOT / "deploy").glob("requirements-*.txt"))
    found = 0
    for file in files:
        pinned, known = pins(file), 0
        for package, version in pinned.items():
            for advisory in advisories(args.database, package):
                known += 1
                if affects(advisory, package, version):
                    found += 1
                    print(f"{package} {version}: {advisory['id']} {', '.join(advisory.get('aliases', []))}")
        print(f"{file.name}: {len(pinned)} packages, {known} advisories about them")
    print(f"{found} of the pinned versions' advisories apply; the database is of {_date(args.database)}")
    return 1 if found else 0


def _date(database: Path) -> str:
    words = ["git", "-C", str(database), "log", "-1", "--format=%cs"]
    said = subprocess.run(words, capture_output=True, text=True, check=False)
    return said.stdout.strip() or "an unknown date"


if __name__ == "__main__":
    sys.exit(main())
