"""The systems that sagnode is installed on, and how pip is told to fetch for them from any machine.

Imported by the scripts beside it; not part of the package.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent


@dataclass(frozen=True)
class Suite:
    """One Debian, and Raspberry Pi OS that is made from it."""

    name: str
    number: int
    python: str
    """The system's own Python, whose picamera2 is to be seen."""
    units: str
    """Where packages put systemd units: Bookworm's tools know the old place only."""

    @property
    def constraints(self) -> Path:
        """Versions that were chosen by hand, with their reasons."""
        return HERE / f"constraints-{self.name}.txt"

    @property
    def lock(self) -> Path:
        """Every package with version and hashes."""
        return HERE / f"requirements-{self.name}.txt"


SUITES = {
    "bookworm": Suite("bookworm", 12, "3.11", "lib/systemd/system"),
    "trixie": Suite("trixie", 13, "3.13", "usr/lib/systemd/system"),
}
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
"""Debian's names and pip's."""


def pip(*words: str | Path, environment: Mapping[str, str] | None = None) -> str:
    """Run pip, quietly, with more in its environment; its words, which on failure are the message."""
    command = [sys.executable, "-m", "pip", *map(str, words)]
    env = {**os.environ, "PIP_NO_INPUT": "1", **(environment or {})}
    ran = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
    if ran.returncode:
        sys.exit(f"pip {words[0]} failed:\n{ran.stderr.strip()}")
    return ran.stdout + ran.stderr


def platform_words(suite: Suite, arch: str) -> list[str]:
    """What makes pip choose wheels, and wheels only, of another machine and Python."""
    words = ["--only-binary=:all:", "--python-version", suite.python, "--implementation", "cp"]
    # Both Debians have a later glibc than 2.28; a wheel may be marked with an older one.
    for tag in ("manylinux_2_28", "manylinux_2_27", "manylinux_2_17", "manylinux2014"):
        words += ["--platform", f"{tag}_{MACHINES[arch]}"]
    return words
