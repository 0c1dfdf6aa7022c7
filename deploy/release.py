"""Lays out one release of sagnode as a tree that can be put anywhere: a virtual environment without pip.

    python deploy/release.py SUITE ARCH DIRECTORY

Nothing of it is compiled or run while it is made, so that a release for a Raspberry Pi is made on any machine. It is
relocatable: its Python is the system's, found by pyvenv.cfg beside it, and its command is a shell script that finds
itself.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from targets import MACHINES, ROOT, SUITES, Suite, pip, platform_words

COMMAND = """\
#!/bin/sh
# Neither the directory that it is called in nor a user's own packages count: what was released runs, and nothing else.
here=$(dirname "$(readlink -f "$0")")
PYTHONSAFEPATH=1 PYTHONNOUSERSITE=1 exec "$here/python" -m sagnode "$@"
"""


def make_release(suite: Suite, arch: str, directory: Path) -> None:
    """Fill ``directory`` (made; must not exist)."""
    python = f"python{suite.python}"
    site = directory / "lib" / python / "site-packages"
    site.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as scratch:
        lock = Path(scratch) / "lock.txt"
        lock.write_text(_without_build_tools(suite.lock.read_text(encoding="utf-8")), encoding="utf-8")
        pip("wheel", "--no-deps", "--wheel-dir", scratch, _clean_source(Path(scratch)))
        (own,) = Path(scratch).glob("sagnode-*.whl")
        words = ["--quiet", "--no-deps", "--no-compile", "--target", site, *platform_words(suite, arch)]
        # Debian 12's pip holds what a package says of its Python against the one that runs pip. The lock was resolved
        # for the system that the release is for, and the wheels' own tags say that too.
        words.append("--ignore-requires-python")
        pip("install", *words, "--require-hashes", "--requirement", lock)
        pip("install", *words, own)
    # Commands of other packages; theirs is the Python that ran pip here.
    shutil.rmtree(site / "bin", ignore_errors=True)
    for record in site.glob("*.dist-info/direct_url.json"):
        record.unlink()
    for tests in (*site.glob("numpy/**/tests"), *site.glob("apscheduler/**/tests")):
        shutil.rmtree(tests)
    bin_ = directory / "bin"
    bin_.mkdir()
    (bin_ / "python3").symlink_to(f"/usr/bin/{python}")
    (bin_ / "python").symlink_to("python3")
    (bin_ / "sagnode").write_text(COMMAND, encoding="utf-8")
    (bin_ / "sagnode").chmod(0o755)
    # The system's packages are seen for picamera2, which is bound to the system's libcamera.
    (directory / "pyvenv.cfg").write_text(
        f"home = /usr/bin\ninclude-system-site-packages = true\nversion = {suite.python}\n", encoding="utf-8"
    )


def _clean_source(scratch: Path) -> Path:
    """A copy of what the package is made of: building leaves nothing in the checkout, nor takes leftovers from it."""
    source = scratch / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(ROOT / "src", source / "src", ignore=ignored)
    return source


def _without_build_tools(lock: str) -> str:
    """The lock without setuptools, which a release that is built already does not need."""
    entries = lock.replace(" \\\n", " \\\0").splitlines()
    return "\n".join(e.replace("\0", "\n") for e in entries if not e.startswith("setuptools==")) + "\n"


def main(words: list[str]) -> int:
    """Make one."""
    if len(words) != 3 or words[0] not in SUITES or words[1] not in MACHINES:
        print(f"usage: release.py {'|'.join(SUITES)} {'|'.join(MACHINES)} DIRECTORY", file=sys.stderr)
        return 2
    make_release(SUITES[words[0]], words[1], Path(words[2]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
