"""What a node costs that does what nodes do most of the time: wait five minutes, measure, send, write it down."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from performance.frames import shot
from performance.memory import broker_table, journalled, stand_in_daemon
from performance.node import write_node
from performance.plan import Plan
from performance.process import cpu_s, written_bytes
from performance.proxy import Proxy
from sagnode.demo.broker import EmbeddedBroker

BURST = 4
"""What ``sagnode config init`` writes into a new node's file."""
SETTLE_S = 6.0
CARD_MB = 256
SECTOR = 512


def measure(plan: Plan) -> dict[str, Any]:
    """CPU and network of a real node at rest and over one reading; disk writes for each reading."""
    return {"waiting": waiting(plan), "disk": disk(plan)}


def waiting(plan: Plan) -> dict[str, Any]:
    """The real daemon, worker and broker on the system's clock: a stretch of waiting, then one more reading."""
    interval = plan.idle_s + 2 * SETTLE_S
    picture = shot("tower", plan.folder)
    state = plan.folder / "idle-state"
    shutil.rmtree(state, ignore_errors=True)
    with EmbeddedBroker(plan.folder / "broker") as broker, Proxy(broker.port) as proxy:
        loaded = write_node(
            picture,
            plan.folder / "node-idle",
            burst=BURST,
            mqtt=broker_table(broker, proxy.port),
            schedule={"interval_s": interval, "clock": "system"},
            storage={"state_dir": str(state)},
        )
        words = [sys.executable, "-m", "sagnode", "run", "--config", str(loaded.path)]
        with (plan.folder / "idle.log").open("wb") as log:
            process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            conductors = len(picture.alone(9).conductors)
            _await(lambda: journalled(state) >= conductors, 90)
            first = time.monotonic()
            time.sleep(SETTLE_S)
            worker = _child_of(process.pid)
            before = _sample(process.pid, worker, proxy)
            time.sleep(plan.idle_s)
            rested = _sample(process.pid, worker, proxy)
            _await(lambda: journalled(state) >= 2 * conductors, 90)
            time.sleep(max(0.0, first + interval + SETTLE_S - time.monotonic()))
            after = _sample(process.pid, worker, proxy)
        finally:
            process.terminate()
            process.wait(30)
    at_rest = _rates(before, rested)
    whole = {k: after[k] - rested[k] for k in rested}
    reading = {k: whole[k] - at_rest[k] * whole["time_s"] for k in at_rest}
    return {"interval_s": interval, "burst": BURST, "rate": at_rest, "reading": reading, "conductors": conductors}


def _sample(daemon: int, worker: int, proxy: Proxy) -> dict[str, float]:
    passed = asdict(proxy.passed())
    return {"time_s": time.monotonic(), "daemon_s": cpu_s(daemon), "worker_s": cpu_s(worker), **passed}


def _rates(before: dict[str, float], after: dict[str, float]) -> dict[str, float]:
    """By the second."""
    seconds = after["time_s"] - before["time_s"]
    return {k: (after[k] - before[k]) / seconds for k in before if k != "time_s"}


def _await(reached, seconds: float) -> None:
    give_up = time.monotonic() + seconds
    while not reached():
        if time.monotonic() > give_up:
            raise RuntimeError(f"the node made no reading within {seconds:.0f} s")
        time.sleep(0.1)


def _child_of(pid: int) -> int:
    """The worker: the daemon's only child."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    if len(children) != 1:
        raise RuntimeError(f"the daemon has {len(children)} children, expected its worker")
    return int(children[0])


def disk(plan: Plan) -> dict[str, Any]:
    """Bytes written for each reading, by the kernel's account of the process and by a block device's own counters."""
    cycles = plan.written_readings
    conductors = len(shot("tower", plan.folder).alone(9).conductors)
    with _card(plan.folder) as (folder, device), EmbeddedBroker(plan.folder / "broker") as broker:
        state = folder / "state"
        state.mkdir()
        os.sync()
        began = _written(device)
        by_process = 0
        with stand_in_daemon(plan, state, cycles, broker_table(broker), flush=folder) as (process, _):
            while process.poll() is None:
                with contextlib.suppress(OSError, ValueError):
                    by_process = max(by_process, written_bytes(process.pid))
                time.sleep(0.05)
        os.sync()
        requests, sectors = (after - before for after, before in zip(_written(device), began, strict=True))
        readings = journalled(state)
        if readings < cycles * conductors:
            raise RuntimeError(f"{readings} readings in the journal, {cycles * conductors} expected")
        payload = _payload(state / "journal.sqlite")
        size = (state / "journal.sqlite").stat().st_size
    result: dict[str, Any] = {
        "cycles": cycles,
        "conductors": conductors,
        "json_bytes": payload / cycles,
        "journal_bytes": size / cycles,
        "process_bytes": by_process / cycles,
    }
    if device is not None:
        result |= {"device_bytes": sectors * SECTOR / cycles, "device_requests": requests / cycles}
    return result


def _payload(journal: Path) -> int:
    """Bytes of all readings themselves."""
    import sqlite3

    with contextlib.closing(sqlite3.connect(f"file:{journal}?mode=ro", uri=True)) as db:
        return int(db.execute("SELECT sum(length(CAST(json AS BLOB))) FROM readings").fetchone()[0])


@contextlib.contextmanager
def _card(folder: Path) -> Iterator[tuple[Path, str | None]]:
    """An ext4 file system of its own on a loop device, as a card has; a plain folder where that is not allowed."""
    mount = folder / "card"
    mount.mkdir(exist_ok=True)
    image = folder / "card.img"
    if os.geteuid() != 0 or shutil.which("mkfs.ext4", path="/usr/sbin:/sbin:/usr/bin:/bin") is None:
        plain = folder / "card-plain"
        shutil.rmtree(plain, ignore_errors=True)
        plain.mkdir()
        yield plain, None
        return
    with image.open("wb") as file:
        file.truncate(CARD_MB << 20)
    quiet = {"check": True, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    # tables made at once, so that the kernel does not write them in the background while we count
    options = ["-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0"]
    subprocess.run(["/usr/sbin/mkfs.ext4", *options, str(image)], **quiet)
    shown = subprocess.run(
        ["losetup", "--find", "--show", str(image)], check=True, capture_output=True, text=True
    ).stdout.strip()
    try:
        subprocess.run(["mount", "-o", "noatime", shown, str(mount)], **quiet)
        try:
            yield mount, Path(shown).name
        finally:
            subprocess.run(["umount", str(mount)], **quiet)
    finally:
        subprocess.run(["losetup", "--detach", shown], **quiet)
        image.unlink()


def _written(device: str | None) -> tuple[int, int]:
    """Write requests and sectors of a block device so far (Documentation/block/stat.rst)."""
    if device is None:
        return 0, 0
    fields = Path(f"/sys/block/{device}/stat").read_text(encoding="ascii").split()
    return int(fields[4]), int(fields[6])
