"""Runs the timed cases in this process and gathers what pytest-benchmark noted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from performance import compiled
from performance.plan import Plan

CASES = Path(__file__).with_name("cases.py")
KEPT = ("min", "median", "max", "rounds")


def measure(plan: Plan) -> dict[str, Any]:
    """Every case: what it is, and its CPU seconds; and what the compiled kernels do for it."""
    raw = plan.folder.parent / "pytest-benchmark.json"
    # a configuration of its own: the tests' limits and plugins are not for benchmarks
    configuration = plan.folder.parent / "pytest.ini"
    configuration.write_text("[pytest]\n", encoding="utf-8")
    words = [str(CASES), "-q", "-c", str(configuration), f"--rootdir={CASES.parent}", "-p", "no:cacheprovider"]
    words += ["-p", "no:randomly", "-p", "no:timeout", f"--benchmark-json={raw}", "--benchmark-quiet", "-x"]
    status = pytest.main(words)
    if status != 0:
        raise SystemExit(f"a benchmark failed (pytest: {status}); its traceback is above")
    rows = json.loads(raw.read_text(encoding="utf-8"))["benchmarks"]
    cases = [row["extra_info"] | {k: row["stats"][k] for k in KEPT} for row in rows]
    return {"cases": cases, "native": compiled.measure(plan)}
