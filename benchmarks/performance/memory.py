"""Resident memory of the methods and of the processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from performance.frames import NAMES, shot
from performance.node import write_node
from performance.plan import Plan
from performance.process import peak_kb, resident_kb
from performance.running import ask, running_worker
from sagnode.config.load import LoadedNode

HERE = Path(__file__).parent
METHODS = ("literal", "anchored", "reading", "burst")


def measure(plan: Plan) -> dict[str, Any]:
    """All of it."""
    nodes = {name: write_node(shot(name, plan.folder), plan.folder / f"node-{name}") for name in NAMES}
    return {
        "methods": {name: {m: _child(m, nodes[name].path) for m in METHODS} for name in NAMES},
        "worker": {name: worker_peak(nodes[name]) for name in NAMES},
        "worker_burst": worker_peak(write_node(shot("field", plan.folder), plan.folder / "node-field-8", burst=8)),
    }


def _child(method: str, node: Path) -> dict[str, int]:
    words = [sys.executable, str(HERE / "child.py"), method, str(node)]
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True, text=True)
    return dict(json.loads(done.stdout))


def worker_peak(loaded: LoadedNode) -> dict[str, float]:
    """The real worker's memory over three readings, decoding included, kB."""
    with running_worker(loaded) as worker:
        assert worker.hello is not None
        pid = worker.hello.pid
        ready = resident_kb(pid)
        elapsed = [ask(worker).elapsed_s for _ in range(3)]
        return {"ready_kb": ready, "peak_kb": peak_kb(pid), "after_kb": resident_kb(pid), "elapsed_s": min(elapsed)}
