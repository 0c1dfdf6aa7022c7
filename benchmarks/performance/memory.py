"""Resident memory of the processes, its growth over many readings, and what ``sagnode status`` takes."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from performance.frames import NAMES, shot
from performance.node import write_node
from performance.plan import Plan
from performance.process import cpu_s, peak_kb, resident_kb, slope
from sagnode.config.load import LoadedNode
from sagnode.demo.broker import EmbeddedBroker
from sagnode.worker.protocol import MeasureReply
from sagnode.worker.supervisor import Limits, Supervisor, command_line

HERE = Path(__file__).parent
PATIENT = Limits(deadline_s=300.0, max_readings=10**9, memory_max_mb=1e6)
METHODS = ("literal", "anchored", "reading", "burst")
STATUS_RUNS = 9


def measure(plan: Plan) -> dict[str, Any]:
    """All of it."""
    nodes = {name: write_node(shot(name, plan.folder), plan.folder / f"node-{name}") for name in NAMES}
    return {
        "methods": {name: {m: _child(m, nodes[name].path) for m in METHODS} for name in NAMES},
        "worker": {name: _worker_peak(nodes[name]) for name in NAMES},
        "worker_burst": _worker_peak(write_node(shot("field", plan.folder), plan.folder / "node-field-8", burst=8)),
        "worker_soak": worker_soak(nodes["lab"], plan.worker_readings, plan.soak_s),
        "daemon_soak": daemon_soak(plan, plan.daemon_readings),
        "status": status_cost(plan),
    }


def _child(method: str, node: Path) -> dict[str, int]:
    words = [sys.executable, str(HERE / "child.py"), method, str(node)]
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True, text=True)
    return dict(json.loads(done.stdout))


@contextlib.contextmanager
def _worker(loaded: LoadedNode) -> Iterator[Supervisor]:
    supervisor = Supervisor(command_line(loaded.path), PATIENT, configuration=loaded.snapshot())
    try:
        fault = supervisor.ready(90.0)
        if fault is not None:
            raise RuntimeError(f"the worker does not start: {fault.reason}")
        yield supervisor
    finally:
        supervisor.stop()


def _ask(worker: Supervisor) -> MeasureReply:
    outcome = worker.measure(None)
    if outcome.reply is None:
        raise RuntimeError(f"the worker gave no reading: {outcome.reason}")
    return outcome.reply


def _worker_peak(loaded: LoadedNode) -> dict[str, float]:
    """The real worker's memory over three readings, decoding included, kB."""
    with _worker(loaded) as worker:
        assert worker.hello is not None
        pid = worker.hello.pid
        ready = resident_kb(pid)
        elapsed = [_ask(worker).elapsed_s for _ in range(3)]
        return {"ready_kb": ready, "peak_kb": peak_kb(pid), "after_kb": resident_kb(pid), "elapsed_s": min(elapsed)}


def worker_soak(loaded: LoadedNode, readings: int, most_s: float) -> dict[str, Any]:
    """The real worker's resident memory over many readings of a small frame, for ``most_s`` seconds at most."""
    steps: list[float] = []
    resident: list[float] = []
    with _worker(loaded) as worker:
        assert worker.hello is not None
        end = time.monotonic() + most_s
        while len(steps) < readings and time.monotonic() < end:
            _ask(worker)
            steps.append(len(steps) + 1)
            resident.append(resident_kb(worker.hello.pid))
    return {"readings": len(steps), "slope": asdict(slope(steps, resident)), "kb": _thinned(steps, resident)}


def record_reply(plan: Plan) -> Path:
    """A real worker's reply to the tower's picture, for the stand-in to repeat."""
    with _worker(write_node(shot("tower", plan.folder), plan.folder / "node-tower")) as worker:
        text = _ask(worker).model_dump_json()
    file = plan.folder / "reply.json"
    file.write_text(text, encoding="utf-8")
    return file


@contextlib.contextmanager
def stand_in_daemon(
    plan: Plan, folder: Path, cycles: int, mqtt: dict[str, Any], flush: Path | None = None
) -> Iterator[tuple[subprocess.Popen[bytes], LoadedNode]]:
    """The daemon with a stand-in for a worker, as fast as it goes; state in ``folder``; its status in memory."""
    storage = {"state_dir": str(folder), "pictures": True}
    loaded = write_node(shot("tower", plan.folder), plan.folder / "node-soak", mqtt=mqtt, storage=storage)
    environment = os.environ | {
        "SAGNODE_STAND_IN_REPLY": str(record_reply(plan)),
        "SAGNODE_STAND_IN_READINGS": str(cycles),
        "RUNTIME_DIRECTORY": _in_memory(),
    }
    if flush is not None:
        environment["SAGNODE_STAND_IN_FLUSH"] = str(flush)
    words = [sys.executable, str(HERE / "daemon.py"), str(loaded.path)]
    with (plan.folder / "daemon.log").open("wb") as log:
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
    try:
        yield process, loaded
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait(30)


def _in_memory() -> str:
    """For the status, as the service has from systemd."""
    folder = Path("/dev/shm" if Path("/dev/shm").is_dir() else "/tmp") / f"sagnode-bench-{os.getpid()}"  # noqa: S108
    folder.mkdir(exist_ok=True)
    return str(folder)


def broker_table(broker: EmbeddedBroker, port: int | None = None) -> dict[str, Any]:
    """The node file's table [mqtt] for a broker that was brought along."""
    protocol = "5" if broker.mqtt5 else "3.1.1"
    return {"host": "127.0.0.1", "port": port or broker.port, "protocol": protocol, "backlog_per_s": 1000.0}


def daemon_soak(plan: Plan, readings: int) -> dict[str, Any]:
    """Resident memory of the daemon with journal and broker, readings as fast as they go."""
    state = plan.folder / "soak-state"
    _empty(state)
    conductors = len(shot("tower", plan.folder).alone(9).conductors)
    cycles = -(-readings // conductors)
    steps: list[float] = []
    resident: list[float] = []
    spent: list[float] = []
    with (
        EmbeddedBroker(plan.folder / "broker") as broker,
        stand_in_daemon(plan, state, cycles, broker_table(broker)) as (process, _),
    ):
        began = time.monotonic()
        while process.poll() is None and time.monotonic() - began < plan.soak_s:
            with contextlib.suppress(FileNotFoundError, ValueError, ProcessLookupError):
                sample = resident_kb(process.pid), cpu_s(process.pid), journalled(state)
                for series, value in zip((resident, spent, steps), sample, strict=True):
                    series.append(value)
            time.sleep(0.25)
        seconds = time.monotonic() - began
        if process.returncode:
            raise RuntimeError(f"the daemon ended with {process.returncode}; see {plan.folder / 'daemon.log'}")
    done = journalled(state)
    return {
        "readings": done,
        "seconds": seconds,
        "peak_kb": max(resident),
        "cpu_s_each": slope(steps, spent).per_thousand / 1000 * conductors,
        "slope": asdict(slope(steps, resident)),
        "kb": _thinned(steps, resident),
    }


def journalled(state: Path) -> int:
    """Readings in the journal so far."""
    file = state / "journal.sqlite"
    if not file.exists():
        return 0
    with (
        contextlib.suppress(sqlite3.OperationalError),
        contextlib.closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as db,
    ):
        return int(db.execute("SELECT coalesce(max(sequence), 0) FROM readings").fetchone()[0])
    return 0


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
    environment = os.environ | {"RUNTIME_DIRECTORY": _in_memory()}
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
    return {"wall_s": min(walls), "cpu_s": cpu / STATUS_RUNS, "bare_s": min(bare), "imported": heavy}
