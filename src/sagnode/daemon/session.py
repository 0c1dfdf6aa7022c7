"""One connection to the broker, from CONNECT to its end; the link makes a new one when it breaks."""

from __future__ import annotations

import contextlib
import logging
import select
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import paho.mqtt.client as mqtt
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from sagnode.daemon.broker import CONNECT_TIMEOUT_S, Broker
from sagnode.daemon.logs import Seldom
from sagnode.daemon.mailbox import PACKET_MAX, Farewell, Mailbox
from sagnode.daemon.outbox import Outbox
from sagnode.errors import JournalError

log = logging.getLogger(__name__)

PUBACK_WAIT_S = 20.0
"""A broker that owes an acknowledgement for so long is taken for dead."""
_SOON_S = 3.0
FAREWELL_S = 2.0
"""Longest wait for the acknowledgement of the last message."""


class Receive(Protocol):
    """Takes a command; called in the link's thread."""

    def __call__(self, payload: bytes, *, retained: bool, correlation: bytes | None) -> None:
        """A message, whether it was retained, and its MQTT 5 correlation data."""


@dataclass(frozen=True)
class Terms:
    """What every connection of one node has in common.

    Args:
        broker: where to.
        prefix: topic prefix without a slash at its end.
        online: makes the payload of ``status`` at the moment of connection.
        will: payload of ``status`` that the broker publishes when the node is lost.
        expiry_s: expiry of retained documents such as health.
    """

    broker: Broker
    prefix: str
    online: Callable[[], bytes]
    will: bytes
    expiry_s: float
    receive: Receive | None = None
    """Takes what arrives on the topic ``command``; None where no commands are taken."""

    def may_write(self) -> str:
        """What the broker has to permit."""
        who = f"the user {self.broker.username}" if self.broker.username else "this client"
        return f"its access list must let {who} write below {self.prefix}/"


class LinkLostError(Exception):
    """The connection is of no use any more.

    Args:
        text: one line.
        by_broker: the broker ended it.
        told: it said why.
    """

    def __init__(self, text: str, *, by_broker: bool, told: bool = False) -> None:
        super().__init__(text)
        self.by_broker = by_broker
        self.told = told


class Session:
    """One connection.

    Args:
        terms: of the node.
        outbox: what to send.
        mailbox: word from the daemon's loop.
        accepted: called with True when the broker has taken the connection.
    """

    def __init__(self, terms: Terms, outbox: Outbox, mailbox: Mailbox, accepted: Callable[[], None]) -> None:
        self._terms = terms
        self._broker = terms.broker
        self._outbox = outbox
        self._mailbox = mailbox
        self._tell_accepted = accepted
        self._client = self._broker.client(f"{terms.prefix}/status", terms.will)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_publish = self._on_publish
        self._client.on_message = self._on_message
        # Else paho writes at once, ahead of what the broker has said: its reason to hang up would be lost for a reset.
        self._client.on_socket_register_write = _later
        self._accepted = False
        self._accepted_at = 0.0
        self._refusal = ""
        self._readings: dict[int, int] = {}  # message id to sequence number
        self._papers: dict[int, str] = {}  # message id to topic of a document
        self._heads: dict[int, float] = {}  # oldest message without an acknowledgement, and since when it is that
        self._largest = 0
        """Size of the largest packet that was sent, bytes."""
        self._last_answer = time.monotonic()
        self._journal_again_at = 0.0
        self._complaints = Seldom(log)

    def run(self) -> None:
        """Serve the connection; returns after a farewell.

        Raises:
            LinkLostError: the broker refused, hung up or fell silent.
            OSError, ValueError: it was never reached.
        """
        try:
            self._broker.connect(self._client)
            connack_by = time.monotonic() + CONNECT_TIMEOUT_S
            while not self._accepted:
                self._turn(0.5)
                if time.monotonic() > connack_by:
                    raise LinkLostError(f"{self._broker.address}: accepts but does not answer", by_broker=False)
            self._serve()
        finally:
            self._close()

    def _serve(self) -> None:
        self._show("status", self._terms.online())
        self._mailbox.send_all_again()
        while True:
            self._send_documents()
            self._send_notes()
            self._send_readings()
            farewell = self._mailbox.farewell
            if farewell is not None and (self._mailbox.over() or self._drained()):
                self._say_goodbye(farewell)
                return
            self._turn(min(self._outbox.wait_s(), 0.1 if farewell or self._outbox.unwritten else 1.0))
            if self._head_waits_s() > PUBACK_WAIT_S:
                text = f"{self._broker.address}: no acknowledgement for {PUBACK_WAIT_S:g} s"
                raise LinkLostError(text, by_broker=False)

    def _head_waits_s(self) -> float:
        """Since when the same message has been the oldest without an acknowledgement.

        They come in the order of the messages (MQTT 5.0, 4.6); one that is passed over would block its place for ever.
        """
        now = time.monotonic()
        heads = (next(iter(self._readings), None), next(iter(self._papers), None))
        self._heads = {mid: self._heads.get(mid, now) for mid in heads if mid is not None}
        return now - min(self._heads.values(), default=now)

    def _turn(self, timeout_s: float) -> None:
        """Wait for the network or for news, and let paho do its part."""
        client, nudged = self._client, self._mailbox.nudged
        sock = client.socket()
        if sock is None:
            self._lost()
            return
        fd = sock.fileno()
        hidden = getattr(sock, "pending", lambda: 0)()  # bytes that TLS has decrypted already
        waiting = select.poll()  # select(2) knows no descriptor above 1023
        waiting.register(fd, select.POLLIN | (select.POLLOUT if client.want_write() else 0))
        waiting.register(nudged, select.POLLIN)
        ready = dict(waiting.poll(0.0 if hidden else 1000 * timeout_s))
        code = mqtt.MQTT_ERR_SUCCESS
        if ready.get(fd, 0) & ~select.POLLOUT or hidden:
            code = client.loop_read()
        if code == mqtt.MQTT_ERR_SUCCESS and ready.get(fd, 0) & select.POLLOUT:
            code = client.loop_write()
        if code == mqtt.MQTT_ERR_SUCCESS:
            code = client.loop_misc()
        if nudged in ready:
            self._mailbox.clear_nudges()
        if self._refusal or code != mqtt.MQTT_ERR_SUCCESS:
            self._lost()

    def _lost(self) -> None:
        text = f"{self._broker.address}: {self._refusal or self._hung_up()}"
        raise LinkLostError(text, by_broker=True, told=bool(self._refusal))

    def _hung_up(self) -> str:
        if self._accepted and time.monotonic() - self._accepted_at < _SOON_S:
            size = f"it may not bear packets of {self._largest} bytes, or " if self._largest else ""
            who = f"another client may use mqtt.client_id = {self._broker.client_id}"
            return f"hung up soon after it accepted; {size}{who}"
        if self._accepted:
            return "connection lost"
        told = self._broker.how_it_hangs_up()
        if told:
            return told
        if self._broker.tls and self._broker.cert_file is None:
            return "hung up before it answered; it may want a client certificate (mqtt.tls.cert_file)"
        if self._broker.tls:
            return "hung up before it answered; check that it accepts mqtt.tls.cert_file"
        if self._broker.mqtt5:
            return 'hung up before it answered; it may want TLS, or mqtt.protocol = "3.1.1"'
        return "hung up before it answered; it may want TLS"

    # -- sending

    def _send_readings(self) -> None:
        if time.monotonic() < self._journal_again_at:
            return
        if self._mailbox.look_again:
            self._mailbox.look_again = False
            self._outbox.look_again()
        try:
            # While acknowledgements keep coming they are written together, some fifty to a commit.
            if self._outbox.unwritten >= 50 or self._outbox.on_the_wire == 0 or self._quiet():
                self._outbox.settle()
            for outgoing in self._outbox.take():
                topic = f"{self._terms.prefix}/measurement/{outgoing.conductor}"
                properties = self._broker.properties(expiry_s=outgoing.expires_in_s)
                if too_large := self._too_large(topic, outgoing.payload, properties):
                    self._outbox.refused(outgoing.sequence, too_large)
                    continue
                info = self._client.publish(
                    topic, outgoing.payload, qos=1, retain=not outgoing.backfill, properties=properties
                )
                self._readings[info.mid] = outgoing.sequence
        except JournalError as error:
            self._complaints.error(str(error))
            self._journal_again_at = time.monotonic() + 1.0

    def _too_large(self, topic: str, payload: bytes, properties: Properties | None) -> str:
        """Why this cannot be sent, in words, or nothing: a broker hangs up on what is larger than it said it takes."""
        packed = 0 if properties is None else len(properties.pack())  # type: ignore[no-untyped-call]
        rest = 2 + len(topic.encode()) + 2 + packed + len(payload)
        size = 1 + (1 if rest < 128 else 2 if rest < 16_384 else 3 if rest < 2_097_152 else 4) + rest
        if size > self._mailbox.packet_max:
            return f"{size} bytes, and the broker takes packets of {self._mailbox.packet_max}"
        self._largest = max(self._largest, size)
        return ""

    def _quiet(self) -> bool:
        return time.monotonic() - self._last_answer > 0.05

    def _drained(self) -> bool:
        try:
            return self._mailbox.empty and not self._papers and self._outbox.drained()
        except JournalError:
            return True

    def _send_documents(self) -> None:
        # One of each topic at a time: what is replaced while it is on its way goes afterwards.
        for topic, payload in self._mailbox.take(but=self._papers.values()).items():
            self._show(topic, payload, expiry_s=self._terms.expiry_s)

    def _send_notes(self) -> None:
        for note in self._mailbox.notes():
            properties = self._broker.properties(
                content_type=note.content_type, correlation=note.correlation, about=note.about
            )
            self._publish(note.topic, note.payload, properties, retain=False)

    def _show(self, topic: str, payload: bytes, expiry_s: float | None = None) -> None:
        properties = self._broker.properties(expiry_s=expiry_s)
        self._publish(topic, payload, properties, retain=True)

    def _publish(self, topic: str, payload: bytes, properties: Properties | None, *, retain: bool) -> None:
        full = f"{self._terms.prefix}/{topic}"
        if too_large := self._too_large(full, payload, properties):
            self._refuse(topic, too_large)
            return
        self._papers[self._client.publish(full, payload, qos=1, retain=retain, properties=properties).mid] = topic

    def _refuse(self, topic: str, why: str) -> None:
        self._mailbox.refused[topic] = why
        self._complaints.error(f"{self._broker.address} does not take {topic}: {why}")

    def _say_goodbye(self, farewell: Farewell) -> None:
        """An orderly DISCONNECT discards the last will, so ``offline`` is said first, and acknowledged."""
        self._papers.clear()
        self._show("status", farewell.status)
        until = time.monotonic() + FAREWELL_S
        while self._papers and time.monotonic() < until:
            self._turn(0.1)
        with contextlib.suppress(JournalError):
            self._outbox.settle()
        self._client.on_socket_register_write = None
        self._client.disconnect()
        while self._client.want_write() and time.monotonic() < until:
            self._turn(0.1)
        log.info("left broker %s", self._broker.address)

    def _close(self) -> None:
        sock = self._client.socket()
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.close()

    # -- paho's callbacks, all in this thread, out of loop_read

    def _on_connect(
        self,
        client: mqtt.Client,
        userdata: object,
        flags: mqtt.ConnectFlags,
        reason: ReasonCode,
        properties: Properties | None,
    ) -> None:
        del client, userdata, flags
        if reason.is_failure:
            remedy = "check mqtt.username and mqtt.password_file"
            if "protocol" in str(reason).lower():
                remedy = 'set mqtt.protocol = "3.1.1"' if self._broker.mqtt5 else "it speaks neither MQTT 5 nor 3.1.1"
            if "not supported" in str(reason).lower():
                remedy = "it must permit QoS 1 and retained messages"
            self._refusal = f"refused: {reason}; {remedy}"
            return
        self._outbox.limit(getattr(properties, "ReceiveMaximum", 65535))
        self._mailbox.packet_max = getattr(properties, "MaximumPacketSize", PACKET_MAX)
        if self._terms.receive is not None:
            self._broker.subscribe(self._client, f"{self._terms.prefix}/command")
        self._accepted = True
        self._accepted_at = time.monotonic()
        self._last_answer = time.monotonic()
        self._tell_accepted()
        log.info("connected to broker %s", self._broker.address)

    def _on_disconnect(
        self,
        client: mqtt.Client,
        userdata: object,
        flags: mqtt.DisconnectFlags,
        reason: ReasonCode,
        properties: Properties | None,
    ) -> None:
        del client, userdata, properties
        if flags.is_disconnect_packet_from_server:
            hint = "; another client uses mqtt.client_id" if "taken over" in str(reason).lower() else ""
            self._refusal = f"the broker hung up: {reason}{hint}"

    def _on_message(self, client: mqtt.Client, userdata: object, message: mqtt.MQTTMessage) -> None:
        del client, userdata
        if self._terms.receive is not None:
            correlation = getattr(message.properties, "CorrelationData", None)
            self._terms.receive(bytes(message.payload), retained=message.retain, correlation=correlation)

    def _on_publish(
        self, client: mqtt.Client, userdata: object, mid: int, reason: ReasonCode, properties: Properties
    ) -> None:
        del client, userdata, properties
        self._last_answer = time.monotonic()
        topic = self._papers.pop(mid, None)
        if topic is not None and reason.is_failure:
            self._refuse(topic, f"the broker answered: {reason}")
        elif topic is not None:
            self._mailbox.refused.pop(topic, None)
        sequence = self._readings.pop(mid, None)
        if sequence is None:
            return
        if reason.is_failure:
            self._outbox.refused(sequence, f"the broker answered: {reason}")
        else:
            self._outbox.acknowledged(sequence)


def _later(client: mqtt.Client, userdata: object, sock: object) -> None:
    """What is to be written waits for the session's own turn."""
    del client, userdata, sock
