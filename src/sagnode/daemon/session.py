"""One connection to the broker, from CONNECT to its end; the link makes a new one when it breaks."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

import paho.mqtt.client as mqtt
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from sagnode.daemon.broker import CONNECT_TIMEOUT_S, Broker
from sagnode.daemon.logs import Seldom
from sagnode.daemon.outbox import Outbox
from sagnode.errors import JournalError

log = logging.getLogger(__name__)

PUBACK_WAIT_S = 20.0
"""A broker that owes an acknowledgement for so long is taken for dead."""
_SOON_S = 3.0
FAREWELL_S = 2.0
"""Longest wait for the acknowledgement of the last message."""


@dataclass(frozen=True)
class Farewell:
    """How the link is to end: send what is owed until then (monotonic seconds), then say this on ``status``."""

    drain_until: float
    status: bytes


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


class LinkLostError(Exception):
    """The connection is of no use any more; ``by_broker`` says who ended it."""

    def __init__(self, text: str, *, by_broker: bool) -> None:
        super().__init__(text)
        self.by_broker = by_broker


class Mailbox:
    """Where the daemon's loop leaves word for the link's thread: retained documents, a nudge, the farewell."""

    def __init__(self) -> None:
        self.farewell: Farewell | None = None
        self._documents: dict[str, bytes] = {}
        self._unsent: set[str] = set()
        self._lock = threading.Lock()
        self.nudged, self._nudge = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)

    def put(self, topic: str, payload: bytes) -> None:
        """Leave a document; only the newest of each topic is kept."""
        with self._lock:
            self._documents[topic] = payload
            self._unsent.add(topic)

    def take(self, but: Collection[str]) -> dict[str, bytes]:
        """Documents that are not sent yet, except of these topics."""
        with self._lock:
            due = {topic: self._documents[topic] for topic in self._unsent if topic not in but}
            self._unsent.difference_update(due)
        return due

    def send_all_again(self) -> None:
        """A new connection: the broker may have forgotten."""
        with self._lock:
            self._unsent.update(self._documents)

    @property
    def empty(self) -> bool:
        """Whether every document was taken."""
        with self._lock:
            return not self._unsent

    def over(self) -> bool:
        """Whether the time for the farewell has come, drained or not."""
        return self.farewell is not None and time.monotonic() >= self.farewell.drain_until

    def nudge(self) -> None:
        """End the thread's wait."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._nudge, b"n")

    def clear_nudges(self) -> None:
        """They have been seen."""
        with contextlib.suppress(BlockingIOError):
            while os.read(self.nudged, 4096):
                pass


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
        self._accepted = False
        self._accepted_at = 0.0
        self._refusal = ""
        self._readings: dict[int, int] = {}  # message id to sequence number
        self._papers: dict[int, str] = {}  # message id to topic of a document
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
            # paho spells MQTT 3.1.1's clean session in its constructor; clean_start is MQTT 5's, and its default there.
            self._client.connect(self._broker.host, self._broker.port, self._broker.keepalive_s)
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
            self._send_readings()
            farewell = self._mailbox.farewell
            if farewell is not None and (self._mailbox.over() or self._drained()):
                self._say_goodbye(farewell)
                return
            self._turn(min(self._outbox.wait_s(), 0.1 if farewell or self._outbox.unwritten else 1.0))
            if (self._readings or self._papers) and time.monotonic() - self._last_answer > PUBACK_WAIT_S:
                text = f"{self._broker.address}: no acknowledgement for {PUBACK_WAIT_S:g} s"
                raise LinkLostError(text, by_broker=False)

    def _turn(self, timeout_s: float) -> None:
        """Wait for the network or for news, and let paho do its part."""
        client, nudged = self._client, self._mailbox.nudged
        sock = client.socket()
        if sock is None:
            self._lost()
            return
        fd = sock.fileno()
        hidden = getattr(sock, "pending", lambda: 0)()  # bytes that TLS has decrypted already
        writers = [fd] if client.want_write() else []
        readable, writable, _ = select.select([fd, nudged], writers, [], 0.0 if hidden else timeout_s)
        code = mqtt.MQTT_ERR_SUCCESS
        if fd in readable or hidden:
            code = client.loop_read()
        if code == mqtt.MQTT_ERR_SUCCESS and writable:
            code = client.loop_write()
        if code == mqtt.MQTT_ERR_SUCCESS:
            code = client.loop_misc()
        if nudged in readable:
            self._mailbox.clear_nudges()
        if self._refusal or code != mqtt.MQTT_ERR_SUCCESS:
            self._lost()

    def _lost(self) -> None:
        raise LinkLostError(f"{self._broker.address}: {self._refusal or self._hung_up()}", by_broker=True)

    def _hung_up(self) -> str:
        if self._accepted and time.monotonic() - self._accepted_at < _SOON_S:
            return f"hung up soon after it accepted; another client may use mqtt.client_id = {self._broker.client_id}"
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
        try:
            # While acknowledgements keep coming they are written together, some fifty to a commit.
            if self._outbox.unwritten >= 50 or self._outbox.on_the_wire == 0 or self._quiet():
                self._outbox.settle()
            for outgoing in self._outbox.take():
                if not self._readings:
                    self._last_answer = time.monotonic()
                info = self._client.publish(
                    f"{self._terms.prefix}/measurement/{outgoing.conductor}",
                    outgoing.payload,
                    qos=1,
                    retain=not outgoing.backfill,
                    properties=self._broker.properties(expiry_s=outgoing.expires_in_s),
                )
                self._readings[info.mid] = outgoing.sequence
        except JournalError as error:
            self._complaints.error(str(error))
            self._journal_again_at = time.monotonic() + 1.0

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

    def _show(self, topic: str, payload: bytes, expiry_s: float | None = None) -> None:
        if not self._papers:
            self._last_answer = time.monotonic()
        properties = self._broker.properties(expiry_s=expiry_s)
        full = f"{self._terms.prefix}/{topic}"
        self._papers[self._client.publish(full, payload, qos=1, retain=True, properties=properties).mid] = topic

    def _say_goodbye(self, farewell: Farewell) -> None:
        """An orderly DISCONNECT discards the last will, so ``offline`` is said first, and acknowledged."""
        self._papers.clear()
        self._show("status", farewell.status)
        until = time.monotonic() + FAREWELL_S
        while self._papers and time.monotonic() < until:
            self._turn(0.1)
        with contextlib.suppress(JournalError):
            self._outbox.settle()
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
            self._refusal = f"refused: {reason}; {remedy}"
            return
        self._outbox.limit(getattr(properties, "ReceiveMaximum", 65535))
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

    def _on_publish(
        self, client: mqtt.Client, userdata: object, mid: int, reason: ReasonCode, properties: Properties
    ) -> None:
        del client, userdata, properties
        self._last_answer = time.monotonic()
        topic = self._papers.pop(mid, None)
        if topic is not None and reason.is_failure:
            self._complaints.error(f"{self._broker.address} does not take {topic}: {reason}")
        sequence = self._readings.pop(mid, None)
        if sequence is None:
            return
        if reason.is_failure:
            self._outbox.refused(sequence, f"the broker answered: {reason}")
        else:
            self._outbox.acknowledged(sequence)
