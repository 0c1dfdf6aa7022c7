"""The configured way to the broker: whom to call, under which topics, and what ``status`` says there."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sagnode import __version__
from sagnode.config.load import LoadedNode
from sagnode.config.mqtt import Mqtt
from sagnode.config.node import Node
from sagnode.daemon.broker import Broker
from sagnode.daemon.clock import Clock
from sagnode.daemon.commands import Inbox
from sagnode.daemon.journal import Journal
from sagnode.daemon.link import Link
from sagnode.daemon.outbox import Outbox
from sagnode.daemon.schedule import Schedule
from sagnode.daemon.session import Terms
from sagnode.errors import ConfigError
from sagnode.message import Identity, StatusMessage


@dataclass(frozen=True)
class Wording:
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


def configured_link(
    mqtt: Mqtt, prefix: str, journal: Journal, schedule: Schedule, wording: Wording, inbox: Inbox | None
) -> Link:
    """The link of a node to its broker, not started yet."""
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
