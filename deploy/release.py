"""Lays out one release of sagnode as a tree that can be put anywhere: a virtual environment without pip.

    python deploy/release.py SUITE ARCH DIRECTORY

Nothing of it is run while it is made, and what is compiled is compiled for the other machine (compiler.py), so that a
release for a Raspberry Pi is made on any machine. It is relocatable: its Python is the system's, found by pyvenv.cfg
beside it, and its command is a shell script that finds itself.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import zipfile
from pathlib import Path

import compiler
from targets import MACHINES, ROOT, SUITES, Suite, pip, platform_words

BUILD_TOOLS = ("setuptools==", "packaging==")
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
        lock.write_text(_part(suite, build_tools=False), encoding="utf-8")
        own = make_wheel(suite, arch, Path(scratch))
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


def make_wheel(suite: Suite, arch: str, scratch: Path) -> Path:
    """Sagnode itself for a processor, in ``scratch``; says on standard error where nothing could be compiled."""
    tools, lock = scratch / "tools", scratch / "tools.txt"
    lock.write_text(_part(suite, build_tools=True), encoding="utf-8")
    pip("install", "--quiet", "--no-deps", "--target", tools, "--require-hashes", "--requirement", lock)
    environment = {"PYTHONPATH": str(tools)}
    lacking = ""
    try:
        environment |= compiler.environment(arch, scratch)
    except compiler.NoCompilerError as error:
        lacking = str(error)
        # Whatever compiles for this machine here would not do for the other one.
        environment["CC"] = environment["LDSHARED"] = "false"
    platform = f"manylinux_{compiler.GLIBC.replace('.', '_')}_{MACHINES[arch]}"
    words = ("--verbose", "--no-deps", "--no-build-isolation", "--wheel-dir", scratch)
    option = f"--config-settings=--build-option=--plat-name={platform}"
    said = pip("wheel", *words, option, _clean_source(scratch), environment=environment)
    (own,) = scratch.glob("sagnode-*.whl")
    if not any(name.endswith(".so") for name in zipfile.ZipFile(own).namelist()):
        lacking = lacking or "; ".join(line.strip() for line in said.splitlines() if "error: " in line)
        print(f"WARNING: {arch} WITHOUT COMPILED KERNELS, it will work and be slow: {lacking}", file=sys.stderr)
    return own


def _clean_source(scratch: Path) -> Path:
    """A copy of what the package is made of: building leaves nothing in the checkout, nor takes leftovers from it."""
    source = scratch / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info", "*.so")
    shutil.copytree(ROOT / "src", source / "src", ignore=ignored)
    return source


def _part(suite: Suite, *, build_tools: bool) -> str:
    """Of the lock, what builds sagnode, or what a release that is built runs with."""
    entries = suite.lock.read_text(encoding="utf-8").replace(" \\\n", " \\\0").splitlines()
    chosen = [entry for entry in entries if entry.startswith(BUILD_TOOLS) is build_tools]
    return "\n".join(entry.replace("\0", "\n") for entry in chosen) + "\n"


def main(words: list[str]) -> int:
    """Make one."""
    if len(words) != 3 or words[0] not in SUITES or words[1] not in MACHINES:
        print(f"usage: release.py {'|'.join(SUITES)} {'|'.join(MACHINES)} DIRECTORY", file=sys.stderr)
        return 2
    make_release(SUITES[words[0]], words[1], Path(words[2]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
