"""Runs the lanes that need whole machines, and writes what they showed into docs/platform.md.

    python tests/platform/lanes.py [LANE ...]      all of them, or those that are named; --list names them
    python tests/platform/lanes.py --possible LANE ...    those that this machine can run; for continuous integration

A lane that lacks something is told with what to install and counts as failed: nothing is passed over in silence. What a
lane showed last is kept in build/platform, so that one lane may be run alone. With --possible such a lane is told as
"skipped: needs ..." and does not count, and the document is left alone.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).parents[2]
HERE = Path("tests/platform")
WORK = Path(os.environ.get("WORK", "/var/tmp/sagnode-roots"))  # noqa: S108 - told in the scripts; removed by nobody else
KEPT = ROOT / "build" / "platform"
DOCUMENT = ROOT / "docs" / "platform.md"
SKIPPED = 77
"""How a command says that this machine cannot show it; its last line says what is missing."""
BEGIN, END = "<!-- made by tests/platform/lanes.py -->", "<!-- end -->"


@dataclass(frozen=True)
class Lane:
    """One lane: what it shows, its commands in turn, and the programs that it cannot do without."""

    name: str
    shows: str
    commands: tuple[tuple[str, ...], ...]
    programs: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()
    root: bool = True


def _bare(suite: str, *steps: str, arch: str = "") -> tuple[tuple[str, ...], ...]:
    """Steps in a bare root, which is made first where there is none."""
    name = WORK / (f"{suite}-{arch}" if arch else suite)
    make = () if name.is_dir() else (("bash", f"{HERE}/bare_root.sh", suite, "root"),)
    return (*make, ("bash", f"{HERE}/bare_root.sh", suite, *steps))


def lanes() -> tuple[Lane, ...]:
    """All of them, in the order of their dependence."""
    container = ("mmdebstrap", "systemd-nspawn", "dpkg-deb")
    emulated = (*container, "qemu-aarch64-static", "arch-test")
    machine = (*container, "qemu-system-x86_64", "busybox", "cpio", "mke2fs")
    arm = (("ARCH", "arm64"),)
    made = (() if (WORK / "trixie").is_dir() else _bare("trixie", "root")) + (
        () if (WORK / "trixie-vm").is_dir() else (("bash", f"{HERE}/vm.sh", "root"),)
    )
    boot = "cold boot to the first reading, hardware watchdog, doctor; a stalled camera; V4L2 on vivid and v4l2loopback"
    lint = "lintian --fail-on error,warning build/sagnode_*.deb"
    return (
        Lane(
            "packages",
            "Debian packages for both systems and both processors, lintian without errors or warnings",
            ((sys.executable, "deploy/build_deb.py"), ("sh", "-c", lint)),
            ("dpkg-deb", "lintian"),
            root=False,
        ),
        Lane(
            "package-here",
            "the package of this very system unpacked: its size, a reading, lintian",
            ((sys.executable, f"{HERE}/package_here.py"),),
            (),
            root=False,
        ),
        *(
            Lane(f"package-{suite}", f"the package on a bare {suite.title()}", _bare(suite, "deb"), container)
            for suite in ("bookworm", "trixie")
        ),
        *(
            Lane(
                f"package-{suite}-arm64",
                f"the package on a bare {suite.title()}, Cortex-A76 emulated",
                _bare(suite, "deb", arch="arm64"),
                emulated,
                arm,
            )
            for suite in ("bookworm", "trixie")
        ),
        *(
            Lane(
                f"booted-{suite}",
                f"{suite.title()} booted: the service, its watchdog, updates and the way back",
                _bare(suite, "boot"),
                container,
            )
            for suite in ("bookworm", "trixie")
        ),
        # Not Trixie: its systemd 257 starts nothing under QEMU 7.2's emulation of single programs.
        Lane(
            "booted-bookworm-arm64",
            "Bookworm booted, Cortex-A76 emulated: the package's service comes up, measures, is stopped",
            _bare("bookworm", "boot-package", arch="arm64"),
            emulated,
            arm,
        ),
        Lane(
            "picamera2", "the real Picamera2 over libcamera's virtual cameras", _bare("trixie", "picamera2"), container
        ),
        Lane(
            "vm",
            boot,
            (
                *made,
                ("bash", f"{HERE}/vm.sh", "image"),
                ("bash", f"{HERE}/vm.sh", "run", "vm_boot.sh", "vm_stall.sh", "vm_v4l2.py"),
            ),
            machine,
        ),
    )


PACKAGES = {
    "systemd-nspawn": "systemd-container",
    "qemu-aarch64-static": "qemu-user-static",
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "mke2fs": "e2fsprogs",
    "dpkg-deb": "dpkg",
}


def lacking(lane: Lane) -> str:
    """What the lane cannot do without and has not; empty when it can run."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    missing = [program for program in lane.programs if shutil.which(program, path=path) is None]
    words = []
    if missing:
        names = " ".join(sorted({PACKAGES.get(program, program) for program in missing}))
        words.append(f"apt install {names}")
    if lane.root and os.geteuid() != 0:
        words.append("root")
    return "; ".join(words)


def run(lane: Lane) -> dict[str, object]:
    """Run one lane and keep what it showed."""
    began, lines = time.monotonic(), []
    missing = lacking(lane)
    result = f"not run: needs {missing}" if missing else "fine"
    if not missing:
        environment = {**os.environ, **dict(lane.environment)}
        for command in lane.commands:
            said = _tee(command, environment, KEPT / f"{lane.name}.log")
            lines += list(_shown(said[1]))
            if said[0] == SKIPPED and said[1]:
                missing = said[1][-1].removeprefix("skipped: needs ")
                result = f"not run: needs {missing}"
            elif said[0]:
                result = "FAILED"
            if said[0]:
                break
    return {
        "lane": lane.name,
        "shows": lane.shows,
        "result": result,
        "took_s": round(time.monotonic() - began),
        "at": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": _commit(),
        "lines": lines,
    }


def _tee(command: tuple[str, ...], environment: dict[str, str], log: Path) -> tuple[int, list[str]]:
    """Run a command, its output to the terminal and to a file; returns its exit status and its lines."""
    said = []
    pipe = subprocess.PIPE
    with (
        log.open("a", encoding="utf-8") as file,
        subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=pipe, stderr=subprocess.STDOUT, text=True, errors="replace"
        ) as child,
    ):
        for line in child.stdout or ():
            sys.stdout.write(line)
            file.write(line)
            said.append(line.rstrip())
    return child.returncode, said


def _shown(lines: list[str]) -> Iterator[str]:
    """The lines that say something: a lane's own findings, and not those of doctor, which have a column more."""
    for line in lines:
        if re.match(r"(ok    \S|FAIL  )", line):
            yield re.sub(r"\s+", " ", line.removeprefix("ok    "))
        elif re.match(r"systemd \d+, Python|.*\.deb: \d+ MB|readings of|stalled:|reopened|scenes:|→ Overall", line):
            yield line.replace(f"{ROOT}/", "").strip()


def _commit() -> str:
    words = ["git", "-C", str(ROOT), "log", "-1", "--format=%h"]
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()


def write_document() -> None:
    """The table, and below it what each lane said, between the marks of docs/platform.md."""
    found = [json.loads(file.read_text()) for lane in lanes() if (file := KEPT / f"{lane.name}.json").exists()]
    rows = ["| lane | shows | result | s | on | commit |", "|---|---|---|---|---|---|"]
    columns = ("lane", "shows", "result", "took_s", "at", "commit")
    rows += ["| " + " | ".join(str(one[column]) for column in columns) + " |" for one in found]
    machine = f"Linux {platform.release().split('-')[0]} on {platform.machine()}, {os.cpu_count()} processors, {_os()}"
    text = [f"Run on {machine}, shared with other work: the times are upper bounds.", "", *rows]
    for one in found:
        if one["lines"]:
            text += ["", f"**{one['lane']}**", "", *(f"- {line}" for line in one["lines"])]
    document = DOCUMENT.read_text(encoding="utf-8")
    before, _, rest = document.partition(BEGIN)
    after = rest.partition(END)[2]
    DOCUMENT.write_text(f"{before}{BEGIN}\n" + "\n".join(text) + f"\n{END}{after}", encoding="utf-8")


def _os() -> str:
    return platform.freedesktop_os_release().get("PRETTY_NAME", "?")


def main(names: list[str]) -> int:
    """Run, keep, write."""
    every = {lane.name: lane for lane in lanes()}
    possible = names[:1] == ["--possible"]
    names = names[possible:]
    if names == ["--list"]:
        for lane in every.values():
            print(f"{lane.name:24} {lane.shows}")
            if missing := lacking(lane):
                print(f"{'':24} cannot run here: needs {missing}")
        return 0
    if unknown := set(names) - set(every):
        print(f"no lane {', '.join(sorted(unknown))}; there are: {', '.join(every)}", file=sys.stderr)
        return 2
    KEPT.mkdir(parents=True, exist_ok=True)
    results = []
    for name in names or every:
        print(f"--- lane {name}: {every[name].shows}", flush=True)
        (KEPT / f"{name}.log").unlink(missing_ok=True)
        result = run({lane.name: lane for lane in lanes()}[name])
        if possible and str(result["result"]).startswith("not run: "):
            print(f"--- lane {name}: skipped: {str(result['result']).removeprefix('not run: ')}\n", flush=True)
            continue
        results.append(result)
        if not possible:
            (KEPT / f"{name}.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
            write_document()
        print(f"--- lane {name}: {result['result']}, {result['took_s']} s\n", flush=True)
    bad = [result for result in results if result["result"] != "fine"]
    for result in bad:
        print(f"{result['lane']}: {result['result']}")
    print(f"{len(results) - len(bad)} passed, {len(bad)} failed")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
