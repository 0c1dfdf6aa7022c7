"""Builds the Debian package: sagnode_<version>+deb<N>_<arch>.deb.

    python deploy/build_deb.py [--suite bookworm|trixie ...] [--arch arm64|amd64 ...] [--out build]

Needs dpkg-deb and the network; neither root nor a compiler, and no machine of the kind it is for. The same commit gives
the same package: all times in it are the commit's. DEBFULLNAME and DEBEMAIL say who answers for it (Maintainer); set
them for packages that are handed on.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from email.utils import format_datetime
from pathlib import Path

from release import make_release
from targets import HERE, MACHINES, ROOT, SUITES, Suite

DEBIAN = HERE / "debian"
PREFIX = "usr/lib/sagnode"
NOBODY = "sagnode@packages.invalid"
"""An address that cannot be (RFC 2606): nobody has said yet who answers for packages that are handed on."""
SCRIPTS = ("postinst", "prerm", "postrm")


def build(suite: Suite, arch: str, out: Path) -> Path:
    """Build one package; returns its file."""
    number = f"{_version()}+deb{suite.number}"
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tree"
        tree.mkdir()
        make_release(suite, arch, tree / PREFIX / "venv")
        _add_files(tree, suite, number)
        _add_control(tree, suite, arch, number)
        _settle(tree)
        file = out / f"sagnode_{number}_{arch}.deb"
        out.mkdir(parents=True, exist_ok=True)
        words = ["dpkg-deb", "--root-owner-group", "-Zxz", "-z1", "--build", str(tree), str(file)]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "SOURCE_DATE_EPOCH": _epoch()})
    return file


def _add_files(tree: Path, suite: Suite, number: str) -> None:
    """Units, command, documentation, examples."""
    units = tree / suite.units
    units.mkdir(parents=True)
    for unit in (ROOT / "systemd").iterdir():
        text = unit.read_text(encoding="utf-8").replace("/usr/local/bin/sagnode", "/usr/bin/sagnode")
        text = text.replace("/opt/sagnode/current/README.md", "/usr/share/doc/sagnode/README.md")
        (units / unit.name).write_text(text, encoding="utf-8")
    command = tree / "usr/bin/sagnode"
    command.parent.mkdir(parents=True)
    command.symlink_to("../lib/sagnode/venv/bin/sagnode")
    enrol = tree / "usr/sbin/sagnode-enrol"
    enrol.parent.mkdir(parents=True)
    shutil.copy(HERE / "certificates" / "sagnode-enrol", enrol)
    # For install.sh --from; where apt installed the package, apt renews it.
    (tree / PREFIX).mkdir(parents=True, exist_ok=True)
    shutil.copy(HERE / "update.py", tree / PREFIX)
    doc = tree / "usr/share/doc/sagnode"
    (doc / "examples").mkdir(parents=True)
    for template in ("node.toml", "span.toml"):
        shutil.copy(ROOT / "src/sagnode/config/templates" / template, doc / "examples")
    shutil.copy(ROOT / "README.md", doc)
    shutil.copy(DEBIAN / "copyright", doc)
    _gzip(doc / "changelog.gz", _debian_changelog(number))
    _gzip(doc / "NEWS.gz", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    for page in DEBIAN.glob("*.[18]"):
        manual = tree / "usr/share/man" / f"man{page.suffix[1:]}"
        manual.mkdir(parents=True)
        _gzip(manual / f"{page.name}.gz", page.read_text(encoding="utf-8"))
    overrides = tree / "usr/share/lintian/overrides/sagnode"
    overrides.parent.mkdir(parents=True)
    shutil.copy(DEBIAN / "lintian-overrides", overrides)


def _add_control(tree: Path, suite: Suite, arch: str, number: str) -> None:
    control = tree / "DEBIAN"
    control.mkdir()
    major, minor = suite.python.split(".")
    fields = {
        "@VERSION@": number,
        "@ARCH@": arch,
        "@MAINTAINER@": _maintainer(),
        "@PYTHON@": f"python3 (>= {suite.python}), python3 (<< {major}.{int(minor) + 1})",
        "@SIZE@": str(sum(file.lstat().st_size for file in tree.rglob("*") if not file.is_dir()) // 1024),
    }
    text = (DEBIAN / "control").read_text(encoding="utf-8")
    for mark, value in fields.items():
        text = text.replace(mark, value)
    (control / "control").write_text(text, encoding="utf-8")
    for name in SCRIPTS:
        shutil.copy(DEBIAN / name, control / name)
        (control / name).chmod(0o755)
    files = sorted(file for file in tree.rglob("*") if file.is_file() and not file.is_symlink())
    lines = [
        f"{hashlib.md5(file.read_bytes(), usedforsecurity=False).hexdigest()}  {file.relative_to(tree)}\n"
        for file in files
        if control not in file.parents
    ]
    (control / "md5sums").write_text("".join(lines), encoding="utf-8")


def _settle(tree: Path) -> None:
    """One mode and one time for everything, whatever the umask and the clock of this machine."""
    epoch = int(_epoch())
    for path in [*tree.rglob("*"), tree]:
        if not path.is_symlink():
            runs = path.is_dir() or path.parent.name in {"bin", "sbin"} or path.name in SCRIPTS
            path.chmod(0o755 if runs else 0o644)
        os.utime(path, (epoch, epoch), follow_symlinks=False)


def _version() -> str:
    text = (ROOT / "src/sagnode/__init__.py").read_text(encoding="utf-8")
    found = re.search(r'^__version__ = "([^"]+)"$', text, re.MULTILINE)
    if found is None:
        sys.exit("no __version__ in src/sagnode/__init__.py")
    # 1.0.0.dev1 and 1.0.0rc1 come before 1.0.0, which Debian writes with a tilde.
    return re.sub(r"\.?(dev|a|b|rc)(\d+)", r"~\1\2", found[1])


def _epoch() -> str:
    """Seconds since 1970 of the commit, or of now where this is no clone."""
    words = ["git", "-C", str(ROOT), "log", "-1", "--format=%ct"]
    said = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
    return os.environ.get("SOURCE_DATE_EPOCH") or said or str(int(datetime.now(UTC).timestamp()))


def _debian_changelog(number: str) -> str:
    when = format_datetime(datetime.fromtimestamp(int(_epoch()), UTC))
    what = "  * See NEWS.gz in this directory."
    return f"sagnode ({number}) stable; urgency=medium\n\n{what}\n\n -- {_maintainer()}  {when}\n"


def _maintainer() -> str:
    """Who answers for the package: whoever builds it, as Debian's tools ask for it."""
    name, address = os.environ.get("DEBFULLNAME") or "The sagnode authors", os.environ.get("DEBEMAIL") or NOBODY
    return f"{name} <{address}>"


def _gzip(file: Path, text: str) -> None:
    with file.open("wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as stream:
        stream.write(text.encode())


def main() -> int:
    """Build what was asked for; prints the files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--suite", action="append", choices=list(SUITES), help="default: all")
    parser.add_argument("--arch", action="append", choices=list(MACHINES), help="default: all")
    parser.add_argument("--out", type=Path, default=ROOT / "build", help="directory (default: build)")
    args = parser.parse_args()
    if shutil.which("dpkg-deb") is None:
        sys.exit("dpkg-deb is not on this machine: build on Debian, or apt install dpkg")
    os.umask(0o022)
    wanted = [(SUITES[name], arch) for name in args.suite or SUITES for arch in args.arch or MACHINES]
    # pip and dpkg-deb do the work, each on one processor.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for file in pool.map(lambda one: build(*one, args.out), wanted):
            print(f"{file}: {file.stat().st_size / 1e6:.0f} MB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
