"""What a node costs that does what nodes do most of the time: wait five minutes, measure, send, write it down."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from performance import wear
from performance.frames import Shot, shot
from performance.node import write_node
from performance.plan import Plan
from performance.process import cpu_s
from performance.proxy import Passed, Proxy
from performance.running import ask, broker_table, journalled, running_worker
from performance.windows import Share, share
from sagnode.daemon.uplink import topic_prefix
from sagnode.demo.broker import EmbeddedBroker

BURST = 4
"""What ``sagnode config init`` writes into a new node's file."""
EARLY_S = 0.3
"""A reading's window opens so long before its slot."""
SETTLE_S = 3.0
"""And closes so long after its numbers are in the journal: they are sent, the worker has learnt from the frame."""
REST_S = 2.0
"""Waiting between readings, at least."""
PATIENCE_S = 90.0
FIVE_MINUTES_S = 300.0


def measure(plan: Plan) -> dict[str, Any]:
    """CPU and network of a real node at rest and over its readings; disk writes for each reading."""
    return {"waiting": waiting(plan), "disk": wear.measure(plan)}


@dataclass(frozen=True)
class Sample:
    """What had been spent at one moment."""

    time_s: float
    daemon_s: float
    worker_s: float
    passed: Passed


@dataclass(frozen=True)
class Watch:
    """Samples around readings."""

    before: list[Sample]
    """Each reading, and once more after the last stretch of waiting."""
    after: list[Sample]

    def spans(self) -> list[Passed]:
        """What passed over the network in the window of each reading."""
        return [a.passed.since(b.passed) for b, a in zip(self.before, self.after, strict=False)]


def waiting(plan: Plan) -> dict[str, Any]:
    """The real daemon, worker and broker on the system's clock: the start, then readings and the waiting between them.

    The readings come sooner than every five minutes, so that there are enough of them to say how sure a number is; the
    frames' own times are five minutes apart from burst to burst, so that the worker learns from as many as it would.
    """
    picture = shot("tower", plan.folder)
    interval_s = _interval(plan, picture)
    state = plan.folder / "idle-state"
    shutil.rmtree(state, ignore_errors=True)
    conductors = len(picture.alone(9).conductors)
    folder = plan.folder / "node-idle"
    # the topics' prefix is the same, whatever the port will be
    prefix = topic_prefix(write_node(picture, folder, mqtt={"host": "127.0.0.1"}).node)
    with EmbeddedBroker(plan.folder / "broker") as broker, Proxy(broker.port, prefix) as proxy:
        loaded = write_node(
            picture,
            folder,
            burst=BURST,
            apart_s=FIVE_MINUTES_S / BURST,
            mqtt=broker_table(broker, proxy.port),
            schedule={"interval_s": interval_s, "clock": "system"},
            storage={"state_dir": str(state)},
        )
        words = [sys.executable, "-m", "sagnode", "run", "--config", str(loaded.path)]
        with (plan.folder / "idle.log").open("wb") as log:
            process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            _await(lambda: journalled(state) >= conductors)
            worker = _child_of(process.pid)

            def look() -> Sample:
                return Sample(time.monotonic(), cpu_s(process.pid), cpu_s(worker), proxy.passed())

            time.sleep(SETTLE_S)
            started = look()
            watch = _watch(interval_s, plan.idle_readings, look, lambda: journalled(state) // conductors)
        finally:
            process.terminate()
            process.wait(30)
    assert loaded.node.mqtt is not None
    album = state / "appearances"
    return {
        "interval_s": interval_s,
        "burst": BURST,
        "conductors": conductors,
        "readings": len(watch.after),
        "keepalive_s": loaded.node.mqtt.keepalive_s,
        "album_bytes": album.stat().st_size if album.exists() else 0,
        "start": {"daemon": started.daemon_s, "worker": started.worker_s},
        "cpu": {name: asdict(_cpu(watch, f"{name}_s")) for name in ("daemon", "worker")},
        "network": network(watch.spans()),
    }


def _interval(plan: Plan, picture: Shot) -> float:
    """So much that a reading, what follows it and some waiting fit in, whatever the machine."""
    with running_worker(write_node(picture, plan.folder / "node-idle", burst=BURST)) as worker:
        began = time.monotonic()
        ask(worker)
        return max(plan.idle_interval_s, math.ceil(EARLY_S + 2 * (time.monotonic() - began) + SETTLE_S + REST_S))


def _watch(interval: float, count: int, look: Callable[[], Sample], readings: Callable[[], int]) -> Watch:
    """Samples around so many readings.

    Slots lie on multiples of the interval, whenever the node was started (``sagnode.daemon.schedule``).

    Raises:
        RuntimeError: a reading takes so long that the next one's window has begun.
    """
    before: list[Sample] = []
    after: list[Sample] = []
    slot = interval * (time.time() // interval + 1)
    if slot - EARLY_S < time.time():
        slot += interval
    while len(after) < count:
        time.sleep(max(0.0, slot - EARLY_S - time.time()))
        done = readings()
        before.append(look())
        _await(lambda seen=done: readings() > seen)
        time.sleep(SETTLE_S)
        after.append(look())
        slot += interval
        if readings() != done + 1 or slot - EARLY_S < time.time():
            raise RuntimeError(
                f"a reading with what follows takes longer than {interval:g} s: too much else goes on here"
            )
    time.sleep(max(0.0, slot - EARLY_S - time.time()))
    return Watch([*before, look()], after)


def _cpu(watch: Watch, name: str) -> Share:
    before, after = ([(s.time_s, getattr(s, name)) for s in samples] for samples in (watch.before, watch.after))
    return share(before, after)


def network(spans: Sequence[Passed]) -> dict[str, Any]:
    """What the daemon sends for a reading: counted by message in the windows of the readings, never as a difference.

    Packets are those that went out on the loopback device, and what a network that carries fewer bytes in one needs
    besides.
    """
    count: Counter[str] = Counter()
    size: Counter[str] = Counter()
    packets = 0
    for span in spans:
        count.update(span.sent)
        size.update(span.sent_bytes)
        packets += span.segments_up + sum((span.sent_segments - span.sent).values())
    each = len(spans)
    return {
        "messages": {name: {"count": count[name] / each, "bytes": size[name] / each} for name in sorted(count)},
        "up": sum(s.up for s in spans) / each,
        "down": sum(s.down for s in spans) / each,
        "packets": packets / each,
    }


def _await(reached: Callable[[], bool]) -> None:
    give_up = time.monotonic() + PATIENCE_S
    while not reached():
        if time.monotonic() > give_up:
            raise RuntimeError(f"the node made no reading within {PATIENCE_S:.0f} s")
        time.sleep(0.1)


def _child_of(pid: int) -> int:
    """The worker: the daemon's only child."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    if len(children) != 1:
        raise RuntimeError(f"the daemon has {len(children)} children, expected its worker")
    return int(children[0])
