#!/usr/bin/env python3
"""Runs the tests of the compiled kernels with every access to memory and every conversion watched.

    scripts/sanitize.py [PYTEST WORDS...]        (default: tests/native)

Builds the module anew with gcc's address and undefined-behaviour sanitizers, in a copy of the source that is removed
again. Exit code 1 when a test fails or a sanitizer stops one, 77 and one line, "skipped: needs …", where there is no
gcc with its sanitizers.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
SKIPPED = 77
# A number that does not fit is no part of "undefined" for gcc: what a cast of it gives differs between processors.
WATCHED = "-fsanitize=address,undefined,float-cast-overflow"
FLAGS = ("-O1", "-g", WATCHED, "-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-fPIC", "-shared", "-Werror")


def modules() -> list[dict[str, Any]]:
    """The compiled modules, as pyproject.toml describes them to setuptools."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    found: list[dict[str, Any]] = project["tool"]["setuptools"]["ext-modules"]
    return found


def build(module: dict[str, Any], source: Path) -> None:
    """Compile one module within ``source``, a copy of src; gcc's words go to standard error."""
    to = source.joinpath(*module["name"].split(".")).with_suffix(".abi3.so")
    own = [word for word in module["extra-compile-args"] if word != "-O3"]
    macros = [f"-D{name}={value}" for name, value in module["define-macros"]]
    files = [source.parent / file for file in module["sources"]]
    include = sysconfig.get_path("include")
    subprocess.run(["gcc", *own, *FLAGS, *macros, f"-I{include}", "-o", to, *files, "-lm"], check=True)


def lacking() -> str:
    """What this machine has not that is needed; empty when it has all."""
    if shutil.which("gcc") is None:
        return "gcc"
    if not Path(_library("libasan.so")).is_absolute() or not Path(_library("libubsan.so")).is_absolute():
        return "gcc's sanitizers (libasan, libubsan)"
    if not Path(sysconfig.get_path("include"), "Python.h").is_file():
        return "Python's headers (apt install python3-dev)"
    return ""


def _library(name: str) -> str:
    """Its path; just its name where gcc has none."""
    return subprocess.run(
        ["gcc", f"-print-file-name={name}"], capture_output=True, text=True, check=True
    ).stdout.strip()


def main(words: list[str]) -> int:
    """Build, and run the tests."""
    if missing := lacking():
        print(f"skipped: needs {missing}")
        return SKIPPED
    with tempfile.TemporaryDirectory() as scratch:
        source = Path(scratch) / "src"
        shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__", "*.so", "*.egg-info"))
        try:
            for module in modules():
                build(module, source)
        except subprocess.CalledProcessError:
            print("FAIL  the kernels cannot be built with sanitizers (gcc's words are above)")
            return 1
        environment = {
            **os.environ,
            "PYTHONPATH": str(source),
            "SAGNODE_NATIVE": "1",
            # The interpreter was not built with it, so that it has to be there first; it keeps much until its end.
            "LD_PRELOAD": _library("libasan.so"),
            "ASAN_OPTIONS": "detect_leaks=0",
            "UBSAN_OPTIONS": "print_stacktrace=1",
            # Each of Python's objects an allocation of its own, with watched bytes around it.
            "PYTHONMALLOC": "malloc",
            "OPENBLAS_NUM_THREADS": "1",
        }
        look = "import sys; from sagnode import native; sys.exit(native.why_not or 0)"
        if subprocess.run([sys.executable, "-c", look], env=environment, check=False).returncode:
            print("FAIL  what was built with sanitizers cannot be loaded (why is above)")
            return 1
        tests = words or [str(ROOT / "tests/native")]
        ran = subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *tests], env=environment, check=False, cwd=ROOT
        )
    print("ok    no access out of bounds, nothing undefined" if ran.returncode == 0 else "FAIL  see above")
    return int(ran.returncode != 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
