"""The C compiler that releases are built with: one for every processor, from PyPI, by its hash.

Imported by the scripts beside it; not part of the package. It goes into build/compiler-<version> (400 MB), once. A
compiler of the machine's own would be another one on every machine, and would build for that machine alone.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import shutil
import sys
import sysconfig
import tempfile
import threading
from pathlib import Path

from targets import HERE, MACHINES, ROOT, pip

LOCK = HERE / "requirements-compiler.txt"
GLIBC = "2.28"
"""The oldest C library that a release runs on: that of the wheels beside it, and of Depends in debian/control."""
# What Debian asks of its own compiled files; no path, name or time of the machine that builds.
CFLAGS = "-g0 -DNDEBUG -fPIC -fstack-protector-strong -D_FORTIFY_SOURCE=2"
LDFLAGS = "-shared -s -Wl,-z,relro,-z,now"
_INSTALLING = threading.Lock()


class NoCompilerError(Exception):
    """Nothing can be compiled on this machine; the text says why, and what to do."""


def install() -> Path:
    """The directory with the package ziglang; made where there is none.

    Raises:
        NoCompilerError: pip could not install it.
    """
    version = re.findall(r"^ziglang==(\S+)", LOCK.read_text(encoding="utf-8"), re.MULTILINE)
    directory = ROOT / "build" / "-".join(["compiler", *version])
    with _INSTALLING:
        if not directory.is_dir():
            _download(directory)
    return directory


def _download(directory: Path) -> None:
    """Made beside its place and then moved there: one that was interrupted is not taken for a whole one."""
    directory.parent.mkdir(exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f".{directory.name}-", dir=directory.parent))
    try:
        words = ("--quiet", "--no-deps", "--only-binary=:all:", "--no-compile", "--target", scratch)
        pip("install", *words, "--require-hashes", "--requirement", LOCK)
        scratch.chmod(0o755)
        # Another build may have been quicker.
        with contextlib.suppress(OSError):
            scratch.rename(directory)
    except SystemExit as failed:
        raise NoCompilerError(str(failed)) from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def headers(scratch: Path) -> Path:
    """A copy of Python's headers that does for any of the processors; made in ``scratch``.

    The stable interface is the same on all of them, and so are the sizes of C's numbers on 64 bits. Debian's own
    pyconfig.h, however, asks for a file that is there for the machine's own processor alone.

    Raises:
        NoCompilerError: they are not on this machine.
    """
    there = Path(sysconfig.get_path("include"))
    if not (there / "Python.h").is_file():
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise NoCompilerError(
            f"no {there}/Python.h: apt install python{version}-dev, or build with a Python that has its headers"
        )
    copied = scratch / "include"
    shutil.copytree(there, copied, ignore=shutil.ignore_patterns("numpy", "internal"))
    own = there.parent / (sysconfig.get_config_var("MULTIARCH") or "") / there.name / "pyconfig.h"
    if own.is_file():
        shutil.copy(own, copied)
    return copied


def environment(arch: str, scratch: Path) -> dict[str, str]:
    """What makes setuptools compile for a processor of ``targets.MACHINES``; installs the compiler where it is not.

    Raises:
        NoCompilerError: it cannot be had here.
    """
    include = headers(scratch)
    directory = install()
    target = f"{MACHINES[arch]}-linux-gnu.{GLIBC}"
    command = f"{shlex.quote(str(directory / 'ziglang' / 'zig'))} cc -target {target}"
    cache = str(directory / "cache")
    return {
        "CC": command,
        "CFLAGS": f"{CFLAGS} -I{shlex.quote(str(include))}",
        "LDSHARED": f"{command} {LDFLAGS}",
        "LDFLAGS": "",
        "CPPFLAGS": "",
        "ZIG_GLOBAL_CACHE_DIR": cache,
        "ZIG_LOCAL_CACHE_DIR": cache,
    }
