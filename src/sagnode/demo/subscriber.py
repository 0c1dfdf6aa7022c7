"""A subscriber like any other: it knows the topics and the message model, and nothing of the node's inside."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Self

import paho.mqtt.client as mqtt
from pydantic import ValidationError

from sagnode.daemon.broker import Broker
from sagnode.errors import SagnodeError
from sagnode.message import Reading, ReadingHeader

_SUBSCRIBE_S = 15.0


class Subscriber:
    """Receives readings in a thread of its own; use as a context manager.

    Args:
        broker: where to.
        prefix: topic prefix of the node.
        arrived: called with every reading, in the order of arrival.

    Raises:
        SagnodeError: the broker does not let it subscribe.
    """

    def __init__(self, broker: Broker, prefix: str, arrived: Callable[[ReadingHeader], None]) -> None:
        self._broker = broker
        self._topic = f"{prefix}/measurement/+"
        self._arrived = arrived
        self._subscribed = threading.Event()
        self.readings: list[ReadingHeader] = []
        self.malformed = 0
        """Messages that are no readings by the published schema."""

    def __enter__(self) -> Self:
        """Connect and subscribe."""
        try:
            self._client = self._broker.client(None, b"")
            self._client.on_connect = lambda client, *_: client.subscribe(self._topic, qos=1)
            self._client.on_subscribe = lambda *_: self._subscribed.set()
            self._client.on_message = self._on_message
            self._client.connect(self._broker.host, self._broker.port, self._broker.keepalive_s)
        except (OSError, ValueError) as error:
            raise SagnodeError(f"the subscriber cannot reach {self._broker.explain(error)}") from error
        self._client.loop_start()
        if not self._subscribed.wait(_SUBSCRIBE_S):
            self._client.loop_stop()
            raise SagnodeError(f"broker {self._broker.address} does not let the demonstration subscribe")
        return self

    def __exit__(self, *exc: object) -> None:
        """Leave."""
        self._client.disconnect()
        self._client.loop_stop()

    def wait_for(self, count: int, seconds: float) -> None:
        """Wait until so many readings have come, or no longer."""
        until = time.monotonic() + seconds
        while len(self.readings) < count and time.monotonic() < until:
            time.sleep(0.05)

    def _on_message(self, client: mqtt.Client, userdata: object, message: mqtt.MQTTMessage) -> None:
        del client, userdata
        if message.retain:
            return  # of an earlier run
        try:
            reading = Reading.model_validate_json(message.payload)
        except ValidationError:
            self.malformed += 1
            return
        self.readings.append(reading)
        self._arrived(reading)
