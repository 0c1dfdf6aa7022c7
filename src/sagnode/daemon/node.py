"""Puts a node together from its configuration, runs it, and takes it apart again in the right order."""

from __future__ import annotations

import logging
import os
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from sagnode import __version__
from sagnode.config.load import LoadedNode
from sagnode.config.node import Node
from sagnode.daemon import notify
from sagnode.daemon.clock import SystemClock, VirtualClock
from sagnode.daemon.commands import Inbox
from sagnode.daemon.dialogue import configured_dialogue
from sagnode.daemon.ladder import Ladder, Steps
from sagnode.daemon.link import Link
from sagnode.daemon.loop import Ending, Loop, Orders, Parts
from sagnode.daemon.machine import Machine
from sagnode.daemon.past import configured_trend, recent_readings
from sagnode.daemon.pictures import Pictures
from sagnode.daemon.places import other_service_state, runtime_directory, state_directory
from sagnode.daemon.recorder import Recorder
from sagnode.daemon.reload import Reloader
from sagnode.daemon.schedule import Schedule
from sagnode.daemon.show import Facts, Showcase
from sagnode.daemon.spool import Spool
from sagnode.daemon.stamp import Stamp
from sagnode.daemon.store import VOLATILE_KEEP_MB, Store, Stores
from sagnode.daemon.uplink import Wording, configured_link, topic_prefix
from sagnode.worker.supervisor import Limits, Supervisor, command_line

log = logging.getLogger(__name__)

DRAIN_S = 60.0
"""After a replay's end: longest wait for the broker to take what is owed."""
STOP_DRAIN_S = 1.0
"""At a stop: time for what is on the wire."""
EXIT_ANEW = 75
"""The service is to be started anew (sysexits.h: temporary failure)."""


def run(loaded: LoadedNode) -> int:
    """Run the daemon until it is told to stop, or a replay ends; returns the exit code.

    Raises:
        SagnodeError: the state directory or the journal cannot be used, or another daemon uses them.
    """
    notifier = notify.from_environment()
    watchdog = notify.Watchdog(notifier, notify.watchdog_period_s(os.environ, os.getpid()))
    orders = Orders()
    orders.install()
    reloader = Reloader(loaded, notifier, watchdog, stopping=lambda: orders.stop, usable=_usable)
    stores = _stores(loaded)
    while True:
        if stores.state_dir != state_directory(reloader.loaded.node.storage.state_dir):
            stores = _stores(reloader.loaded)
        ending = _run_once(reloader, stores, notifier, watchdog, orders)
        if ending is Ending.RELOAD:
            reloader.put_in_force()
            orders.reload_done()
        elif ending is not Ending.REOPEN:
            log.info("ended: %s", ending.value)
            return EXIT_ANEW if ending is Ending.RESTART else 0


def _usable(loaded: LoadedNode) -> None:
    """Raises ConfigError for a schedule or a topic that only shows itself when it is used."""
    _schedule(loaded.node)
    if loaded.node.mqtt:
        topic_prefix(loaded.node)


def _schedule(node: Node) -> Schedule:
    return Schedule(interval_s=node.schedule.interval_s, cron=node.schedule.cron)


def _stores(loaded: LoadedNode) -> Stores:
    state_dir = state_directory(loaded.node.storage.state_dir)
    return Stores(state_dir, runtime_directory(), Machine().boot_id(), other_service_state(state_dir))


def _run_once(
    reloader: Reloader, stores: Stores, notifier: notify.Notifier, watchdog: notify.Watchdog, orders: Orders
) -> Ending:
    loaded = reloader.loaded
    node = loaded.node
    schedule = _schedule(node)
    prefix = topic_prefix(node) if node.mqtt else ""
    notifier.patience(120.0)
    with stores.opened() as store:
        state_dir, journal = stores.state_dir, store.journal
        status_dir = runtime_directory() or state_dir
        machine = Machine()
        clock = VirtualClock(datetime.now(UTC)) if node.schedule.clock == "virtual" else SystemClock()
        wording = Wording(loaded, machine.boot_id(), clock)
        conductors = {c.id: c.phase for c in loaded.span.conductors if c.measured}
        inbox = Inbox(node.commands.per_minute, now=clock.now) if node.mqtt and node.commands.enabled else None
        link = configured_link(node.mqtt, prefix, journal, schedule, wording, inbox) if node.mqtt else None
        if inbox is not None and link is not None:
            inbox.answer_by(link.say)
        past = recent_readings(journal, len(conductors))
        worker = _worker(loaded, state_dir, watchdog, orders)
        recorder = _recorder(node, store, status_dir)
        ladder = _ladder(node, notifier, wording.boot_id, state_dir)
        showcase = Showcase(
            _facts(loaded, wording, state_dir, status_dir, tuple(conductors)),
            worker=worker,
            recorder=recorder,
            journal=journal,
            link=link,
            machine=machine,
            notifier=notifier,
            ladder=ladder,
        )
        reloader.attach(showcase)
        pictures = Pictures(status_dir / "pictures", node.storage.pictures_keep_mb, machine)
        parts = Parts(
            schedule=schedule,
            interval_s=node.schedule.interval_s,
            clock=clock,
            deadline_s=node.schedule.deadline_s,
            worker=worker,
            stamp=_stamp(loaded, wording, conductors),
            recorder=recorder,
            link=link,
            pictures=pictures if node.storage.pictures else None,
            showcase=showcase,
            machine=machine,
            watchdog=watchdog,
            orders=orders,
            ladder=ladder,
            accept=reloader.accept,
            reopen=lambda: stores.better(recorder.refused_s),
            trend=configured_trend(loaded, past) if node.trend.watch else None,
            dialogue=configured_dialogue(wording, past, journal, link, inbox, state_dir),
        )
        log.info("sagnode %s, %s, state in %s", __version__, loaded.path, store.directory)
        if link is not None:
            link.start()
        notifier.ready(f"started; configuration {loaded.configuration_id}")
        return _run_to_the_end(parts, notifier, wording)


def _run_to_the_end(parts: Parts, notifier: notify.Notifier, wording: Wording) -> Ending:
    """The loop, and what is to be finished after it however it ends."""
    ending = Ending.STOPPED
    try:
        ending = Loop(parts).run()
    finally:
        if ending is Ending.STOPPED:
            notifier.stopping()
        parts.worker.stop()
        parts.recorder.finish()
        _leave(parts.link, ending, parts.watchdog, wording)
        now, trust = parts.clock.now(), parts.machine.clock_trust()
        parts.showcase.show([], now=now, next_slot=None, gap_s=float("inf"), trust=trust, state=ending.value)
    return ending


def _worker(loaded: LoadedNode, state_dir: Path, watchdog: notify.Watchdog, orders: Orders) -> Supervisor:
    node = loaded.node
    limits = Limits(
        deadline_s=node.schedule.deadline_s,
        max_readings=node.worker.max_readings,
        memory_max_mb=node.worker.memory_max_mb,
        backoff_max_s=node.worker.backoff_max_s,
    )
    beat = partial(_beat, watchdog, orders)
    return Supervisor(
        command_line(loaded.path, _album(node, state_dir)), limits, beat=beat, configuration=loaded.snapshot()
    )


def _recorder(node: Node, store: Store, status_dir: Path) -> Recorder:
    return Recorder(
        store.journal,
        owed=node.mqtt is not None,
        keep_days=node.storage.keep_days,
        keep_mb=min(node.storage.keep_mb, VOLATILE_KEEP_MB) if store.volatile else node.storage.keep_mb,
        spool=Spool(status_dir / "spool"),
    )


def _facts(
    loaded: LoadedNode, wording: Wording, state_dir: Path, status_dir: Path, conductors: tuple[str, ...]
) -> Facts:
    return Facts(
        identity=wording.identity,
        configuration=loaded.path,
        configuration_id=loaded.configuration_id,
        state_dir=state_dir,
        status_dir=status_dir,
        boot_id=wording.boot_id,
        virtual_clock=loaded.node.schedule.clock == "virtual",
        deadline_s=loaded.node.schedule.deadline_s,
        conductors=conductors,
    )


def _stamp(loaded: LoadedNode, wording: Wording, conductors: dict[str, str | None]) -> Stamp:
    return Stamp(
        identity=wording.identity,
        conductors=conductors,
        method=loaded.node.measure.method,
        configuration_id=loaded.configuration_id,
        software_version=__version__,
        boot_id=wording.boot_id,
        test=loaded.node.unit.commissioning,
    )


def _album(node: Node, state_dir: Path) -> Path | None:
    """Where appearances of landmarks are kept; a replay learns its own, so that it is the same every time."""
    return None if node.camera.backend == "replay" else state_dir / "appearances"


def _ladder(node: Node, notifier: notify.Notifier, boot_id: str, state_dir: Path) -> Ladder | None:
    """None where nobody would start this process anew, and where files are replayed, which no fresh start mends."""
    if not notifier.present or node.camera.backend == "replay":
        return None
    recovery = node.recovery
    steps = Steps(
        restart_after_s=recovery.restart_after_s,
        restarts_before_reboot=recovery.restarts_before_reboot,
        reboot=recovery.reboot,
        reboot_wait_h=recovery.reboot_wait_h,
    )
    asked = runtime_directory()
    return Ladder(state_dir / "recovery.json", steps, boot_id, asked / "reboot-wanted" if asked else None)


def _beat(watchdog: notify.Watchdog, orders: Orders) -> bool:
    """While the worker is waited for: all is well, go on, unless told to stop."""
    watchdog.beat()
    return not orders.stop


def _leave(link: Link | None, ending: Ending, watchdog: notify.Watchdog, wording: Wording) -> None:
    """Say goodbye to the broker; after the end of a replay not before it has everything, within bounds."""
    if link is None:
        return
    drain_s = DRAIN_S if ending is Ending.END_OF_FRAMES else STOP_DRAIN_S
    watchdog.promise(drain_s + 10.0)
    link.stop(drain_s, wording.status("offline", wording.clock.now(), ending.value))
