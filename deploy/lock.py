"""Writes requirements-<suite>.txt: every package with its version and the hashes of its wheels for both machines.

    python deploy/lock.py [bookworm] [trixie] [compiler]

What is resolved: the dependencies of pyproject.toml within constraints-<suite>.txt, and for compiler the C compiler
that packages are built with (compiler.py). Run it to take up newer versions, look at the difference, run the tests.
"""

from __future__ import annotations

import json
import sys
import tempfile
import tomllib
from pathlib import Path

from compiler import LOCK as COMPILER_LOCK
from targets import MACHINES, ROOT, SUITES, Suite, pip, platform_words

BUILD = ("setuptools>=77", "packaging>=24.2")
"""What builds sagnode itself where it is installed from a checkout; taken away again afterwards. setuptools brings the
second one along, and takes Bookworm's, which is too old for it, where that is installed."""
COMPILER = "ziglang>=0.17,<0.18"
"""Clang, a linker and the C libraries of both machines in one wheel that needs neither root nor apt. Nothing that it
builds needs it afterwards. Held to one line of versions, since another makes other instructions of the same source."""


def lock(suite: Suite) -> str:
    """The text of the lock file of a system."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    head = (
        f"# Debian {suite.number}, Raspberry Pi OS {suite.name.title()}, Python {suite.python}, x86_64 and aarch64.",
        f"# Made by deploy/lock.py from pyproject.toml and {suite.constraints.name}, where the reasons are.",
    )
    return _text(head, suite, [*project["dependencies"], *BUILD])


def lock_compiler() -> str:
    """The text of the lock file of the compiler, for machines that build packages."""
    head = (
        "# The C compiler that packages are built with, on x86_64 and aarch64; see deploy/compiler.py.",
        "# Made by deploy/lock.py, where the reasons are.",
    )
    # A wheel for any Python: that of the newest system does for all.
    return _text(head, list(SUITES.values())[-1], [COMPILER])


def _text(head: tuple[str, ...], suite: Suite, wanted: list[str]) -> str:
    found: dict[str, dict[str, str]] = {}
    for arch in MACHINES:
        for name, version, sha256 in _resolved(suite, arch, wanted):
            found.setdefault(f"{name}=={version}", {})[arch] = sha256
    partly = [pin for pin, hashes in found.items() if set(hashes) != set(MACHINES)]
    if partly:
        sys.exit(f"{suite.name}: not the same version for all machines: {', '.join(sorted(partly))}")
    lines = list(head)
    for pin in sorted(found):
        lines.append(f"{pin} \\")
        lines += [f"    --hash=sha256:{sha256} \\" for sha256 in sorted(set(found[pin].values()))]
        lines[-1] = lines[-1].removesuffix(" \\")
    return "\n".join(lines) + "\n"


def _resolved(suite: Suite, arch: str, wanted: list[str]) -> list[tuple[str, str, str]]:
    """Name, version and SHA-256 of every wheel that pip would install."""
    with tempfile.TemporaryDirectory() as scratch:
        report = Path(scratch) / "report.json"
        words = ["--dry-run", "--ignore-installed", "--target", scratch, "--report", report]
        pip("install", *words, *platform_words(suite, arch), "--constraint", suite.constraints, *wanted)
        entries = json.loads(report.read_text(encoding="utf-8"))["install"]
    return [
        (
            entry["metadata"]["name"].lower().replace("_", "-"),
            entry["metadata"]["version"],
            entry["download_info"]["archive_info"]["hashes"]["sha256"],
        )
        for entry in entries
    ]


def main(names: list[str]) -> int:
    """Lock the suites and the compiler, those that are named or all."""
    for name in names or [*SUITES, "compiler"]:
        file, text = (COMPILER_LOCK, lock_compiler()) if name == "compiler" else (SUITES[name].lock, lock(SUITES[name]))
        file.write_text(text, encoding="utf-8")
        print(f"wrote {file.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
