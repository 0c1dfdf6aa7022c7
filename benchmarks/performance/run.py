"""Speed, memory and idle cost, sagnode beside the paper's methods; writes ``docs/performance.md`` and its plot.

    python benchmarks/performance/run.py [--thorough] [--only accuracy speed memory soak idle profile] [--out docs]

Without --thorough it takes a few minutes; ``--thorough --only soak`` sends 10 000 readings through the daemon and as
many through the real worker, each in a quarter of an hour at most. What was measured lies in
``out/performance/*.json``, one file a part, so that one part can be measured again; the report says when and of which
version each part was measured. Run as root it mounts a file system in a file for a while, to count what really reaches
a disk; otherwise it goes by the kernel's account of the process alone.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the folder of this package

from performance import plan as plans
from performance.stages import NameGone

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "out" / "performance"
PARTS = {name: name for name in ("accuracy", "speed", "memory", "soak", "idle")} | {"profile": "hotspots"}
"""And the module that measures each; ``profile`` is a module of the standard library."""
LIMITS = {"OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
"""What the daemon gives its worker, too."""


def main() -> int:
    options = _options()
    if any(os.environ.get(name) != value for name, value in LIMITS.items()):
        # the linear algebra reads this when it is loaded, the allocator when the process starts
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | LIMITS)  # noqa: S606 - this very program
    WORK.mkdir(parents=True, exist_ok=True)
    make = plans.thorough if options.thorough else plans.quick
    plan = make(WORK / "frames")
    plan.folder.mkdir(exist_ok=True)
    plans.announce(plan)
    began = time.monotonic()
    for part in options.only:
        print(f"{time.monotonic() - began:6.0f} s  {part}", file=sys.stderr, flush=True)
        try:
            version = _version()  # the tree may move on while it is measured
            _store(part, plan, version, _measure(part)(plan))
        except NameGone as gone:
            print(f"{part}: {gone}", file=sys.stderr)
            return 1
    from performance.report import write_report

    written = write_report(_load, options.out)
    print(f"{time.monotonic() - began:6.0f} s  wrote {', '.join(str(p) for p in written)}", file=sys.stderr)
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="speed, memory and idle cost")
    parser.add_argument("--thorough", action="store_true", help="more repeats, longer soaks: an hour")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS), help="parts; none: the report again")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the report")
    return parser.parse_args()


def _measure(part: str) -> Callable[[plans.Plan], dict[str, Any]]:
    # imported when asked for: pytest and OpenCV are not needed by all
    return importlib.import_module(f"performance.{PARTS[part]}").measure


def _store(part: str, plan: plans.Plan, version: str, results: dict[str, Any]) -> None:
    about = {
        "measured_at": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": version,
        "machine": _machine(),
        "thorough": plan.thorough,
        "load": os.getloadavg()[0],
    }
    text = json.dumps(about | {"results": results}, indent=1)
    (WORK / f"{part}.json").write_text(text + "\n", encoding="utf-8")


def _load(part: str) -> dict[str, Any] | None:
    file = WORK / f"{part}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


def _version() -> str:
    """The commit that was measured, marked where the tree differs from it."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return described.stdout.strip() or "unknown"


def _machine() -> dict[str, str]:
    import cv2
    import numpy as np

    model = ""
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith(("model name", "Model")):
            model = line.partition(":")[2].strip()
    return {
        "processor": model or platform.machine(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "kernel": platform.release().split("-")[0],
    }


if __name__ == "__main__":
    sys.exit(main())
