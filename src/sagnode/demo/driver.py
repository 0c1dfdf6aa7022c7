"""The demonstration: the real daemon on a replayed day, a broker, a subscriber, a picture and a plot.

The daemon is started as the service would start it, ``sagnode run --config``, with a node file that differs from the
site's in its broker and its state directory only. Everything that is told afterwards comes out of messages that arrived
at the subscriber.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sagnode.config.load import LoadedNode, load_node
from sagnode.config.show import toml_text
from sagnode.daemon.uplink import configured_broker, topic_prefix
from sagnode.demo.broker import EmbeddedBroker
from sagnode.demo.results import Delivery, Point, best_frame, delivery, join, read_truth, summary
from sagnode.demo.subscriber import Subscriber
from sagnode.errors import ConfigError, SagnodeError
from sagnode.message import ReadingHeader, reading_estimate
from sagnode.quality import Validity

_STOP_S = 10.0
_SETTLE_S = 5.0


@dataclass(frozen=True)
class Outcome:
    """What the demonstration found."""

    points: list[Point]
    sent: Delivery
    daemon_status: int

    @property
    def failed(self) -> bool:
        """Whether something went wrong that must not."""
        return bool(self.daemon_status or self.sent.lost or self.sent.repeated or not self.points)


def demonstrate(config: Path, out: Path, prefer_broker: str | None = None) -> int:
    """Run the day and show it; returns the exit code.

    Args:
        config: the site's node file; its camera must replay frames.
        out: directory for everything that is made; made if need be.
        prefer_broker: ``mosquitto`` or ``amqtt`` where the configuration names no broker.

    Raises:
        SagnodeError: it cannot be started.
    """
    site = load_node(config)
    if site.node.camera.replay is None or site.node.camera.backend != "replay":
        raise ConfigError(f"{config}: the demonstration replays frames", 'set camera.backend = "replay"')
    _check_frames(site)
    out = out.absolute()
    try:
        out.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(out / "state", ignore_errors=True)
    except OSError as error:
        raise SagnodeError(f"{out}: {error.strerror}", "choose another --out") from error
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.ExitStack() as stack:
        broker = None
        if site.node.mqtt is None:
            broker = stack.enter_context(EmbeddedBroker(out / "broker", prefer_broker))
            print(f"broker: {broker.kind} on 127.0.0.1:{broker.port}, brought along")
        loaded = _write_node(site, out, broker)
        outcome = _run_day(loaded, out)
    for line in ("", *summary(outcome.points, outcome.sent)):
        print(line)
    if outcome.daemon_status:
        _print_tail(out / "daemon.log")
    for line in ("", *_pictures(loaded, outcome.points, out)):
        print(line)
    return 1 if outcome.failed else 0


def _check_frames(site: LoadedNode) -> None:
    """A daemon would wait for frames that may still come; a demonstration must not.

    Raises:
        FrameError: there are none.
    """
    from sagnode.capture import open_source

    source = open_source(site.node.camera)
    try:
        source.open()
    finally:
        source.close()


def _write_node(site: LoadedNode, out: Path, broker: EmbeddedBroker | None) -> LoadedNode:
    """The site's node file with state in ``out``, and the broker that was brought along."""
    node: dict[str, Any] = site.node.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    node.setdefault("storage", {})["state_dir"] = str(out / "state")
    if broker is not None:
        node["mqtt"] = {"host": "127.0.0.1", "port": broker.port, "protocol": "5" if broker.mqtt5 else "3.1.1"}
    path = out / "node.toml"
    text = f"# Written by the demonstration out of {site.path}.\n{toml_text(node)}"
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SagnodeError(f"{path}: {error.strerror}", "choose another --out") from error
    return load_node(path)


def _run_day(loaded: LoadedNode, out: Path) -> Outcome:
    mqtt = loaded.node.mqtt
    assert mqtt is not None  # noqa: S101 - the node file was written with a broker
    client = configured_broker(mqtt, f"sagnode-demo-{os.getpid()}")
    prefix = topic_prefix(loaded.node)
    print(f"subscribed to {prefix}/measurement/+")
    print("daemon: sagnode run --config", loaded.path)
    print()
    started = time.monotonic()
    with Subscriber(client, prefix, _print_reading) as subscriber:
        status = _run_daemon(loaded.path, out)
        journalled = _journalled(out / "state" / "journal.sqlite")
        subscriber.wait_for(len(journalled), _SETTLE_S)
        readings = list(subscriber.readings)
        if subscriber.malformed:
            print(f"{subscriber.malformed} messages were no readings by their schema")
    print(f"\nthe day took {time.monotonic() - started:.0f} s; the daemon ended with exit code {status}")
    truth = read_truth(_frames(loaded))
    sent = delivery(journalled, [reading.sequence for reading in readings])
    return Outcome(join(readings, truth), sent, status)


def _run_daemon(config: Path, out: Path) -> int:
    """Run the daemon until the replay ends; an interruption ends it too."""
    # Directories of systemd's, where the demonstration itself is run by a service, are not the daemon's.
    environment = {k: v for k, v in os.environ.items() if k not in {"RUNTIME_DIRECTORY", "STATE_DIRECTORY"}}
    command = [sys.executable, "-m", "sagnode", "run", "--config", str(config)]
    process: subprocess.Popen[bytes] | None = None
    try:
        with (out / "daemon.log").open("wb") as log, _interruptions_later():
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, env=environment
            )
        return process.wait()
    finally:
        if process is not None and process.poll() is None:
            process.terminate()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


@contextlib.contextmanager
def _interruptions_later() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back for a moment, so that a child that is being started is not forgotten."""
    came: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda got, _: came.append(got)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if came:
        raise KeyboardInterrupt


def _print_reading(reading: ReadingHeader) -> None:
    quality = reading.quality
    sag, clearance = reading_estimate(reading, "sag"), reading_estimate(reading, "clearance")
    time_ = reading.acquired_at.astimezone(UTC).strftime("%H:%M")
    late = "  backfill" if reading.backfill else ""
    if sag is None:
        text = "no value"
    else:
        half = max(sag.hi - sag.value, sag.value - sag.lo)
        digits = sag.decimals
        text = f"sag {sag.value:6.{digits}f} ± {half:.{digits}f} m"
        if clearance is not None:
            digits = clearance.decimals
            lo, hi = f"{clearance.lo:.{digits}f}", f"{clearance.hi:.{digits}f}"
            text += f"   clearance {clearance.value:6.{digits}f} [{lo} .. {hi}] m"
    print(f"{time_}  {reading.conductor:<4} {text:<62}  {quality.validity}{late}", flush=True)
    if quality.validity is not Validity.GOOD:
        for reason in quality.reasons:
            print(f"            {reason.cause}: {reason.text}", flush=True)


def _pictures(loaded: LoadedNode, points: list[Point], out: Path) -> Iterator[str]:
    """Draw the plot and the overlay; yields where they are, or why not."""
    unit = loaded.node.unit
    if points:
        path = out / "day.png"
        try:
            from sagnode.demo.plot import plot_day

            first = points[0].time.astimezone(UTC)
            plot_day(points, f"{unit.line}, {unit.span}: {first:%Y-%m-%d}", path)
            yield f"plot of the day:  {path}"
        except SagnodeError as error:
            yield f"no plot: {error}"
    frame = best_frame(points)
    if frame is None:
        yield "no overlay: no reading has a value"
    else:
        picture = _draw_frame(loaded, frame, out / "overlay.png")
        yield f"overlay of {frame.astimezone(UTC):%H:%M}: {picture}"
    yield f"journal and state: {out / 'state'}"
    yield f"log of the daemon: {out / 'daemon.log'}"


def _draw_frame(loaded: LoadedNode, at: datetime, path: Path) -> Path:
    """Measure one frame once more, all conductors in one picture, and draw it."""
    from sagnode.capture import open_source
    from sagnode.capture.images import write_png
    from sagnode.overlay import draw_overlay
    from sagnode.pipeline import load_site, measure_burst

    source = open_source(loaded.node.camera)
    try:
        source.open()
        while (coming := source.first_frame_at()) is not None and coming < at:
            source.skip_until(coming)
        image = source.burst(1, 0.0)[0].image
    finally:
        source.close()
    write_png(path, draw_overlay(image, measure_burst(load_site(loaded.span, loaded.node.measure), [image])))
    return path


def _frames(loaded: LoadedNode) -> Path:
    """Directory of the frames; the truth lies beside them."""
    replay = loaded.node.camera.replay
    assert replay is not None  # noqa: S101 - demonstrate() has looked
    path = Path(replay.path)
    return path if path.is_dir() else path.parent


def _journalled(path: Path) -> list[int]:
    """Sequence numbers that the journal holds."""
    if not path.exists():
        return []
    with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as db:
        return [sequence for (sequence,) in db.execute("SELECT sequence FROM readings ORDER BY sequence")]


def _print_tail(log: Path) -> None:
    print(f"\nthe last words of the daemon ({log}):")
    with contextlib.suppress(OSError):
        for line in log.read_text(encoding="utf-8", errors="replace").splitlines()[-15:]:
            print(f"  {line}")
