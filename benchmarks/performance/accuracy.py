"""The errors of exactly the code that is timed: the scene suite over a few worlds of each group."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from performance.plan import Plan

SUITE = Path(__file__).resolve().parents[1] / "run.py"


def measure(plan: Plan) -> dict[str, Any]:
    """The suite's own summary; it also stands on the terminal as it comes.

    Raises:
        subprocess.CalledProcessError: the suite has failed; its words are above.
    """
    folder = plan.folder.parent / "accuracy"
    options = ["--worlds", str(plan.worlds), "--no-paper"]
    words = [sys.executable, str(SUITE), *options, "--out", str(folder), "--csv", str(folder / "readings.csv")]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    print(done.stdout, flush=True)
    return {
        "command": " ".join(["python benchmarks/run.py", *options]),
        "worlds": plan.worlds,
        "summary": done.stdout.partition("\n\n")[0],
    }
