"""Puts a node together from its configuration, runs it, and takes it apart again in the right order."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from sagnode import __version__
from sagnode.config.load import LoadedNode
from sagnode.config.node import Mqtt, Node
from sagnode.daemon import notify
from sagnode.daemon.broker import Broker
from sagnode.daemon.clock import Clock, SystemClock, VirtualClock
from sagnode.daemon.commands import Inbox
from sagnode.daemon.dialogue import configured_dialogue
from sagnode.daemon.journal import Journal
from sagnode.daemon.ladder import Ladder, Steps
from sagnode.daemon.link import Link
from sagnode.daemon.loop import Ending, Loop, Orders, Parts
from sagnode.daemon.machine import Machine
from sagnode.daemon.outbox import Outbox
from sagnode.daemon.past import configured_trend, recent_readings
from sagnode.daemon.pictures import Pictures
from sagnode.daemon.places import runtime_directory, state_directory
from sagnode.daemon.recorder import Recorder
from sagnode.daemon.reload import Reloader
from sagnode.daemon.schedule import Schedule
from sagnode.daemon.session import Terms
from sagnode.daemon.show import Facts, Showcase
from sagnode.daemon.spool import Spool
from sagnode.daemon.stamp import Stamp
from sagnode.daemon.store import VOLATILE_KEEP_MB, Stores
from sagnode.errors import ConfigError
from sagnode.message import Identity, StatusMessage
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
    return Stores(state_directory(loaded.node.storage.state_dir), runtime_directory(), Machine().boot_id())


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
        wording = _Wording(loaded, machine.boot_id(), clock)
        conductors = {c.id: c.phase for c in loaded.span.conductors if c.measured}
        inbox = Inbox(node.commands.per_minute, now=clock.now) if node.mqtt and node.commands.enabled else None
        link = _link(node.mqtt, prefix, journal, schedule, wording, inbox) if node.mqtt else None
        if inbox is not None and link is not None:
            inbox.answer_by(link.say)
        past = recent_readings(journal, len(conductors))
        worker = Supervisor(
            command_line(loaded.path),
            Limits(
                deadline_s=node.schedule.deadline_s,
                max_readings=node.worker.max_readings,
                memory_max_mb=node.worker.memory_max_mb,
                backoff_max_s=node.worker.backoff_max_s,
            ),
            beat=lambda: _beat(watchdog, orders),
            configuration=loaded.snapshot(),
        )
        recorder = Recorder(
            journal,
            owed=link is not None,
            keep_days=node.storage.keep_days,
            keep_mb=min(node.storage.keep_mb, VOLATILE_KEEP_MB) if store.volatile else node.storage.keep_mb,
            spool=Spool(status_dir / "spool"),
        )
        ladder = _ladder(node, notifier, wording.boot_id, state_dir)
        showcase = Showcase(
            Facts(
                identity=wording.identity,
                configuration=loaded.path,
                configuration_id=loaded.configuration_id,
                state_dir=state_dir,
                status_dir=status_dir,
                boot_id=wording.boot_id,
                virtual_clock=node.schedule.clock == "virtual",
                deadline_s=node.schedule.deadline_s,
                conductors=tuple(conductors),
            ),
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
            stamp=Stamp(
                identity=wording.identity,
                conductors=conductors,
                method=node.measure.method,
                configuration_id=loaded.configuration_id,
                software_version=__version__,
                boot_id=wording.boot_id,
                test=node.unit.commissioning,
            ),
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
            dialogue=configured_dialogue(loaded, wording.identity, past, journal, link, inbox, state_dir),
        )
        log.info("sagnode %s, %s, state in %s", __version__, loaded.path, store.directory)
        if link is not None:
            link.start()
        notifier.ready(f"started; configuration {loaded.configuration_id}")
        ending = Ending.STOPPED
        try:
            ending = Loop(parts).run()
        finally:
            if ending is Ending.STOPPED:
                notifier.stopping()
            worker.stop()
            recorder.finish()
            _leave(link, ending, watchdog, wording)
            trust = machine.clock_trust()
            showcase.show([], now=clock.now(), next_slot=None, gap_s=float("inf"), trust=trust, state=ending.value)
        return ending


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


def _leave(link: Link | None, ending: Ending, watchdog: notify.Watchdog, wording: _Wording) -> None:
    """Say goodbye to the broker; after the end of a replay not before it has everything, within bounds."""
    if link is None:
        return
    drain_s = DRAIN_S if ending is Ending.END_OF_FRAMES else STOP_DRAIN_S
    watchdog.promise(drain_s + 10.0)
    link.stop(drain_s, wording.status("offline", wording.clock.now(), ending.value))


@dataclass(frozen=True)
class _Wording:
    """What ``status`` says on MQTT."""

    loaded: LoadedNode
    boot_id: str
    clock: Clock

    @property
    def identity(self) -> Identity:
        """Of the unit."""
        unit = self.loaded.node.unit
        return Identity(utility=unit.utility, line=unit.line, span=unit.span, unit=unit.unit)

    def status(self, state: str, since: datetime | None, text: str = "") -> bytes:
        """Payload of the topic ``status``."""
        message = StatusMessage.model_validate(
            {
                "state": state,
                "since": since,
                "software_version": __version__,
                "boot_id": self.boot_id,
                "configuration_id": self.loaded.configuration_id,
                "text": text,
            }
        )
        return message.model_dump_json().encode()

    def online(self) -> bytes:
        """At the moment of connection."""
        return self.status("online", self.clock.now())


def _link(
    mqtt: Mqtt, prefix: str, journal: Journal, schedule: Schedule, wording: _Wording, inbox: Inbox | None
) -> Link:
    clock = wording.clock
    gap_s = schedule.gap_s(clock.now())
    # A newest reading must not lapse before the next one can replace it.
    expiry_s = max(mqtt.expiry_s, 2 * gap_s if gap_s != float("inf") else 0.0)
    outbox = Outbox(journal, inflight=mqtt.inflight, backlog_per_s=mqtt.backlog_per_s, expiry_s=expiry_s, now=clock.now)
    broker = configured_broker(mqtt, mqtt.client_id or f"sagnode-{wording.identity.unit}")
    will = wording.status("offline", None, "connection lost")
    return Link(Terms(broker, prefix, wording.online, will, expiry_s, inbox.receive if inbox else None), outbox)


def configured_broker(mqtt: Mqtt, client_id: str) -> Broker:
    """The broker of a configuration's table [mqtt], for a client of this name."""
    tls = mqtt.tls
    return Broker(
        host=mqtt.host,
        port=mqtt.port,
        client_id=client_id,
        mqtt5=mqtt.protocol == "5",
        username=mqtt.username,
        password_file=mqtt.password_file,
        tls=tls is not None,
        ca_file=tls.ca_file if tls else None,
        cert_file=tls.cert_file if tls else None,
        key_file=tls.key_file if tls else None,
        keepalive_s=mqtt.keepalive_s,
    )


def topic_prefix(node: Node) -> str:
    """The topic prefix with its places filled in, without a slash at its end.

    Raises:
        ConfigError: mqtt.prefix is no template of a topic.
    """
    assert node.mqtt is not None  # noqa: S101 - the caller has looked
    unit = node.unit
    template = node.mqtt.prefix
    remedy = "it may name {utility}, {line}, {span} and {unit}, and may not contain + or #"
    try:
        prefix = template.format(utility=unit.utility, line=unit.line, span=unit.span, unit=unit.unit).strip("/")
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise ConfigError(f"mqtt.prefix = {template!r} cannot be filled in ({error})", remedy) from error
    if not prefix or set("+#\0") & set(prefix):
        raise ConfigError(f"mqtt.prefix = {template!r} is no topic", remedy)
    return prefix
