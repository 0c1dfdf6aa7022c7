"""Growth of the processes' memory over many readings, and what ``sagnode status`` takes on the journal they left."""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

from performance.frames import shot
from performance.node import write_node
from performance.plan import Plan
from performance.process import resident_kb, slope
from performance.running import ask, broker_table, in_memory, journalled, running_worker, stand_in_daemon
from sagnode.config.load import LoadedNode
from sagnode.demo.broker import EmbeddedBroker

STATUS_RUNS = 9


def measure(plan: Plan) -> dict[str, Any]:
    """The daemon first: its journal is what ``sagnode status`` reads."""
    daemon = daemon_soak(plan, plan.daemon_readings)
    status = status_cost(plan)
    lab = write_node(shot("lab", plan.folder), plan.folder / "node-lab")
    return {"daemon": daemon, "worker": worker_soak(lab, plan.worker_readings, plan.soak_s), "status": status}


def worker_soak(loaded: LoadedNode, readings: int, most_s: float) -> dict[str, Any]:
    """The real worker's resident memory over many readings of a small frame, for ``most_s`` seconds at most."""
    steps: list[float] = []
    resident: list[float] = []
    with running_worker(loaded) as worker:
        assert worker.hello is not None
        end = time.monotonic() + most_s
        while len(steps) < readings and time.monotonic() < end:
            ask(worker)
            steps.append(len(steps) + 1)
            resident.append(resident_kb(worker.hello.pid))
    return _told(steps, resident)


def daemon_soak(plan: Plan, readings: int) -> dict[str, Any]:
    """Resident memory of the daemon with journal and broker, readings as fast as they go; all conductors are one."""
    state = plan.folder / "soak-state"
    _empty(state)
    conductors = len(shot("tower", plan.folder).alone(9).conductors)
    steps: list[float] = []
    resident: list[float] = []
    with (
        EmbeddedBroker(plan.folder / "broker") as broker,
        stand_in_daemon(plan, state, readings, broker_table(broker)) as (process, _),
    ):
        end = time.monotonic() + plan.soak_s
        while process.poll() is None and time.monotonic() < end:
            # the process ends between two looks
            with contextlib.suppress(FileNotFoundError, ValueError, ProcessLookupError):
                done, kb = journalled(state) / conductors, resident_kb(process.pid)
                if done > 0:
                    steps.append(done)
                    resident.append(kb)
            time.sleep(0.1)
        if process.returncode:
            raise RuntimeError(f"the daemon ended with {process.returncode}; see {plan.folder / 'daemon.log'}")
    return _told(steps, resident) | {"peak_kb": max(resident)}


def _told(steps: list[float], resident: list[float]) -> dict[str, Any]:
    found = {"readings": round(steps[-1]), "kb": _thinned(steps, resident)}
    return found | {"slope": asdict(slope(steps, resident))}


def _empty(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for file in folder.iterdir():
        if file.is_file():
            file.unlink()


def _thinned(steps: list[float], values: list[float], most: int = 200) -> list[tuple[float, float]]:
    every = max(1, len(steps) // most)
    return list(zip(steps[::every], values[::every], strict=True))


STATUS_PROBE = """
import sys
from sagnode.cli.main import main
try:
    main(["status", "--state-dir", sys.argv[1]])
except SystemExit:
    pass
heavy = ("numpy", "cv2", "pydantic", "apscheduler", "paho")
print("\\nIMPORTED", *(name for name in heavy if name in sys.modules))
"""


def status_cost(plan: Plan) -> dict[str, Any]:
    """Wall time of ``sagnode status`` on the journal that the soak left, and which heavy modules it imported."""
    state = plan.folder / "soak-state"
    words = [sys.executable, "-m", "sagnode", "status", "--state-dir", str(state)]
    environment = os.environ | {"RUNTIME_DIRECTORY": in_memory()}
    walls = []
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    for _ in range(STATUS_RUNS):
        began = time.perf_counter()
        subprocess.run(words, stdout=subprocess.DEVNULL, check=False, env=environment)
        walls.append(time.perf_counter() - began)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    bare = []
    for _ in range(STATUS_RUNS):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", "pass"], check=True)
        bare.append(time.perf_counter() - began)
    probe = subprocess.run(
        [sys.executable, "-c", STATUS_PROBE, str(state)], capture_output=True, text=True, check=True, env=environment
    )
    heavy = probe.stdout.rpartition("IMPORTED")[2].split()
    return {
        "runs": STATUS_RUNS,
        "wall_s": median(walls),
        "cpu_s": cpu / STATUS_RUNS,
        "bare_s": median(bare),
        "imported": heavy,
    }
