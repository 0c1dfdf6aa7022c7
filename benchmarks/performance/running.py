"""The real worker and the real daemon, run to be measured."""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from performance.frames import shot
from performance.node import write_node
from performance.plan import Plan
from sagnode.config.load import LoadedNode
from sagnode.demo.broker import EmbeddedBroker
from sagnode.worker.protocol import MeasureReply
from sagnode.worker.supervisor import Limits, Supervisor, command_line

HERE = Path(__file__).parent
PATIENT = Limits(deadline_s=300.0, max_readings=10**9, memory_max_mb=1e6)
"""A worker that is never replaced, whatever it takes: that is what is to be seen."""


@contextlib.contextmanager
def running_worker(loaded: LoadedNode) -> Iterator[Supervisor]:
    """The real worker under the daemon's own supervisor."""
    supervisor = Supervisor(command_line(loaded.path), PATIENT, configuration=loaded.snapshot())
    try:
        fault = supervisor.ready(90.0)
        if fault is not None:
            raise RuntimeError(f"the worker does not start: {fault.reason}")
        yield supervisor
    finally:
        supervisor.stop()


def ask(worker: Supervisor) -> MeasureReply:
    """One reading.

    Raises:
        RuntimeError: there is none.
    """
    outcome = worker.measure(None)
    if outcome.reply is None:
        raise RuntimeError(f"the worker gave no reading: {outcome.reason}")
    return outcome.reply


def record_reply(plan: Plan) -> Path:
    """A real worker's reply to the tower's picture, for the stand-in to repeat."""
    with running_worker(write_node(shot("tower", plan.folder), plan.folder / "node-tower")) as worker:
        text = ask(worker).model_dump_json()
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
        "RUNTIME_DIRECTORY": in_memory(),
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


@cache
def in_memory() -> str:
    """A folder for the status, as the service has from systemd; gone when this process ends."""
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108
    folder = tempfile.mkdtemp(prefix="sagnode-bench-", dir=place)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def broker_table(broker: EmbeddedBroker, port: int | None = None) -> dict[str, Any]:
    """The node file's table [mqtt] for a broker that was brought along."""
    protocol = "5" if broker.mqtt5 else "3.1.1"
    return {"host": "127.0.0.1", "port": port or broker.port, "protocol": protocol, "backlog_per_s": 1000.0}


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
