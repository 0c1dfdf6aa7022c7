"""The package of this very system, built, unpacked and used in a scratch directory: needs neither root nor a container.

    python tests/platform/package_here.py

Ends with 77 and one line, "skipped: needs …", where this machine cannot show it.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "deploy"))
from release import make_wheel  # noqa: E402 - a script's neighbour, not a package
from targets import MACHINES, SUITES  # noqa: E402

SKIPPED = 77
LIMIT_S = 500.0
"""No step takes a tenth of it where nothing else runs."""
SITE = ROOT / "src/sagnode/demo/site"
FRAME = "frames/20260621T120000Z"
INSTALLED_MAX_MB = 300
DEVIATIONS_MAX = 4
"""A reading may be off by so many of its standard uncertainties; that it is honest is shown elsewhere."""
APART_MAX = 0.01
"""So far, in the same unit, may readings with the compiled kernels and without be apart."""


def skip(what: str) -> int:
    """This machine cannot show it; says what is missing."""
    print(f"skipped: needs {what}")
    return SKIPPED


def ran(*words: str | Path, cwd: Path | None = None, native: str = "1") -> subprocess.CompletedProcess[str]:
    """Run to the end, its words kept; ``native`` 0 leaves the compiled kernels out."""
    # What is looked at is the package, and not the source that somebody may have put before it.
    env = {**{name: value for name, value in os.environ.items() if name != "PYTHONPATH"}, "SAGNODE_NATIVE": native}
    return subprocess.run(
        list(map(str, words)), capture_output=True, text=True, check=False, cwd=cwd, timeout=LIMIT_S, env=env
    )


def fail(what: str, said: subprocess.CompletedProcess[str]) -> int:
    """Say what went wrong, with the words of whoever met it."""
    print(f"FAIL  {what}\n{said.stdout[-2000:]}{said.stderr[-2000:]}")
    return 1


def main() -> int:
    """Build, unpack, measure, lint."""
    suite = SUITES.get(platform.freedesktop_os_release().get("VERSION_CODENAME", ""))
    if suite is None or not Path(f"/usr/bin/python{suite.python}").exists():
        return skip("Debian 12 or 13, or Raspberry Pi OS, with its own python3")
    if shutil.which("dpkg-deb") is None or shutil.which("dpkg") is None:
        return skip("dpkg-deb")
    arch = ran("dpkg", "--print-architecture").stdout.strip()
    if arch not in MACHINES:
        return skip(f"a processor of {' or '.join(MACHINES)}, and this is {arch}")
    try:
        with tempfile.TemporaryDirectory() as scratch:
            return _look(Path(scratch), suite.name, arch)
    except subprocess.TimeoutExpired as late:
        return skip(f"a machine that does {Path(late.cmd[1]).name} in {LIMIT_S:.0f} s")


def _look(scratch: Path, suite: str, arch: str) -> int:
    words = (sys.executable, ROOT / "deploy/build_deb.py", "--suite", suite, "--arch", arch, "--out", scratch)
    built = ran(*words)
    if built.returncode and built.stderr.startswith("pip "):
        # An index out of reach, or without these very wheels, is the machine's lack (words: deploy/targets.py).
        last = (built.stderr.strip() or "no word").splitlines()[-1]
        return skip(f"the wheels of deploy/requirements-{suite}.txt from PyPI ({last.strip()[:120]})")
    if built.returncode:
        return fail("no package", built)
    (package,) = scratch.glob("*.deb")
    tree = scratch / "tree"
    ran("dpkg-deb", "-x", package, tree)
    size = sum(file.lstat().st_size for file in tree.rglob("*") if file.is_file()) / 1e6
    print(f"ok    built {package.name}: {package.stat().st_size / 1e6:.0f} MB, unpacked {size:.0f} MB")
    if size > INSTALLED_MAX_MB:
        print(f"FAIL  more than {INSTALLED_MAX_MB} MB")
        return 1
    return (
        _measure(scratch, tree)
        or _compiled(scratch, tree, built.stderr)
        or _same_again(tree, suite, arch)
        or _lint(package)
    )


def _measure(scratch: Path, tree: Path) -> int:
    """A reading of the demonstration's noon by what was unpacked, against the scene's truth."""
    site = scratch / "site"
    shutil.copytree(SITE, site, ignore=shutil.ignore_patterns("*T0*"))
    measured = _reading(scratch, tree)
    if measured.returncode:
        return fail("no reading", measured)
    truth = json.loads((SITE / f"{FRAME}.json").read_text(encoding="utf-8"))["conductors"]
    numbers = [reading for reading in json.loads(measured.stdout)["readings"] if reading["sag_m"] is not None]
    for reading in numbers:
        sag, u, truly = reading["sag_m"], reading["sag_u"], truth[reading["conductor"]]["sag_m"]
        off = abs(sag - truly) > DEVIATIONS_MAX * u
        print(
            f"{'FAIL ' if off else 'ok   '} {reading['conductor']}: sag {sag:.4f} m, u {u:.4f} m, truly {truly:.4f} m"
        )
        if off:
            return 1
    return 0 if numbers else fail("no conductor was measured", measured)


def _reading(scratch: Path, tree: Path, native: str = "1") -> subprocess.CompletedProcess[str]:
    site = scratch / "site"
    words = (tree / "usr/bin/sagnode", "measure", site / f"{FRAME}.jpg", "--config", site, "--json")
    return ran(*words, cwd=scratch, native=native)


def _compiled(scratch: Path, tree: Path, warned: str) -> int:
    """The compiled kernels are in it and in use, and NumPy measures the same."""
    if "WITHOUT COMPILED KERNELS" in warned:
        print(f"skipped: {warned.strip()} (the rest was shown)")
        return 0
    look = "import sys; from sagnode.native import why_not; sys.exit(why_not or 0)"
    said = ran(tree / "usr/lib/sagnode/venv/bin/python", "-c", look, cwd=scratch)
    if said.returncode:
        return fail("the compiled kernels are not in use", said)
    (module,) = tree.rglob("_kernels*.so")
    if shutil.which("readelf"):
        symbols = ran("readelf", "--wide", "--dyn-syms", "--sections", module).stdout
        exported = re.findall(r"(?:FUNC|OBJECT) +(?:GLOBAL|WEAK) +DEFAULT +\d+ (\S+)", symbols)
        if exported != ["PyInit__kernels"] or ".debug" in symbols or ".symtab" in symbols:
            return fail(f"{module.name} is not stripped, or shows more than it has to: {exported}", said)
    readings = [json.loads(_reading(scratch, tree, native).stdout)["readings"] for native in ("1", "0")]
    apart = max(abs(one["sag_m"] - other["sag_m"]) / other["sag_u"] for one, other in zip(*readings, strict=True))
    mark = "ok   " if apart <= APART_MAX else "FAIL "
    print(f"{mark} the compiled kernels are in use; NumPy's sags are within {apart:.5f} u")
    return int(apart > APART_MAX)


def _same_again(tree: Path, suite: str, arch: str) -> int:
    """What is compiled again, elsewhere, is the same to the byte."""
    modules = list(tree.rglob("_kernels*.so"))
    with tempfile.TemporaryDirectory(prefix="another-place-") as elsewhere:
        wheel = make_wheel(SUITES[suite], arch, Path(elsewhere))
        with zipfile.ZipFile(wheel) as content:
            again = [content.read(name) for name in content.namelist() if name.endswith(".so")]
    if [module.read_bytes() for module in modules] != again:
        print("FAIL  what was compiled twice is not the same")
        return 1
    print("ok    compiled again in another place: the same to the byte")
    return 0


def _lint(package: Path) -> int:
    if shutil.which("lintian") is None:
        print("skipped: needs lintian (the rest was shown)")
        return 0
    said = ran("lintian", "--allow-root", "--fail-on", "error", package)
    if said.returncode:
        return fail("lintian", said)
    print("ok    lintian finds no error")
    return 0


if __name__ == "__main__":
    sys.exit(main())
