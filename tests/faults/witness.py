"""A TCP proxy between node and broker that does to the link what weather, routers and brokers do, and keeps the record.

It reads the MQTT packets that pass (fixed header, packet identifiers; MQTT 5.0 and 3.1.1 alike for these), so it can
break a link at a chosen packet, and knows of every reading when it was sent and whether its PUBACK came through.
"""

import contextlib
import json
import random
import selectors
import socket
import threading
import time
from dataclasses import dataclass, field

PUBLISH, PUBACK = 3, 4


@dataclass
class Sent:
    """One reading as it passed."""

    text: bytes
    at: list = field(default_factory=list)
    acknowledged_at: list = field(default_factory=list)


def packets(buffer):
    """Cut whole MQTT packets off the front of a buffer: (kind, flags, body, raw)."""
    while len(buffer) >= 2:
        length = shift = 0
        for index in range(1, min(5, len(buffer))):
            length |= (buffer[index] & 0x7F) << shift
            shift += 7
            if not buffer[index] & 0x80:
                break
        else:
            return
        start = index + 1
        if len(buffer) < start + length:
            return
        raw = bytes(buffer[: start + length])
        del buffer[: start + length]
        yield raw[0] >> 4, raw[0] & 0xF, raw[start:], raw


def published(body, flags, mqtt5=True):
    """Topic, packet identifier (None at QoS 0) and payload of a PUBLISH."""
    size = int.from_bytes(body[:2], "big")
    topic, rest, identifier = body[2 : 2 + size].decode(), body[2 + size :], None
    if flags & 6:
        identifier, rest = int.from_bytes(rest[:2], "big"), rest[2:]
    if mqtt5:
        length = shift = used = 0
        for byte in rest:
            length |= (byte & 0x7F) << shift
            shift, used = shift + 7, used + 1
            if not byte & 0x80:
                break
        rest = rest[used + length :]
    return topic, identifier, rest


class Witness:
    """The proxy; a thread of its own.

    ``mode`` may be set at any time:
    pass, refuse (accept and reset), closed (nobody listens), silent (take everything, hand on nothing), slow (a
    kilobyte every 50 ms), mute-broker (what the node says arrives, what the broker says does not).
    ``cut(where)`` breaks the link at the next packet: before-puback, inside-puback, inside-publish, after-publish.
    """

    def __init__(self, broker_port, seed=1):
        self.broker_port = broker_port
        self.random = random.Random(seed)
        self.sent = {}
        self.cuts = 0
        self._mode = "pass"
        self._cut = None
        self._lock = threading.Lock()
        self._pairs = []
        self._listener = None
        self._selector = selectors.DefaultSelector()
        self.port = 0
        self._listen()
        self._over = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    # -- for the campaign

    @property
    def mode(self):
        return self._mode

    @mode.setter
    def mode(self, mode):
        with self._lock:
            self._mode = mode
            if mode in {"refuse", "closed"}:
                for pair in list(self._pairs):
                    pair.reset()
            if mode == "closed" and self._listener is not None:
                self._selector.unregister(self._listener)
                self._listener.close()
                self._listener = None
            elif mode != "closed" and self._listener is None:
                self._listen()

    def cut(self, where):
        self._cut = where

    def break_all(self):
        """Every connection ends with a reset."""
        with self._lock:
            for pair in list(self._pairs):
                pair.reset()

    def acknowledged(self):
        with self._lock:
            return {sequence for sequence, sent in self.sent.items() if sent.acknowledged_at}

    def first_acknowledged_after(self, instant):
        with self._lock:
            times = [t for sent in self.sent.values() for t in sent.acknowledged_at if t >= instant]
        return min(times, default=None)

    def close(self):
        self._over = True
        self._thread.join(5)
        with self._lock:
            for pair in list(self._pairs):
                pair.reset()
            if self._listener:
                self._listener.close()

    # -- within

    def _listen(self):
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", self.port))
        self.port = listener.getsockname()[1]
        listener.listen(16)
        listener.setblocking(False)
        self._listener = listener
        self._selector.register(listener, selectors.EVENT_READ, None)

    def _run(self):
        while not self._over:
            for key, _ in self._selector.select(0.05):
                with self._lock, contextlib.suppress(OSError, KeyError):
                    if key.data is None:
                        self._accept()
                    else:
                        key.data.ready(key.fileobj)
            if self._mode == "slow":
                time.sleep(0.05)

    def _accept(self):
        if self._listener is None:
            return
        node, _ = self._listener.accept()
        if self._mode == "refuse":
            _reset(node)
            return
        try:
            broker = socket.create_connection(("127.0.0.1", self.broker_port), 1)
        except OSError:
            _reset(node)
            return
        self._pairs.append(_Pair(self, node, broker))


class _Pair:
    """One connection of the node and its counterpart at the broker."""

    def __init__(self, witness, node, broker):
        self.witness, self.node, self.broker = witness, node, broker
        self.upward, self.downward = bytearray(), bytearray()
        self.waiting = {}  # packet identifier to sequence
        for end in (node, broker):
            end.settimeout(2.0)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            witness._selector.register(end, selectors.EVENT_READ, self)

    def ready(self, end):
        mode = self.witness._mode
        if mode == "silent":
            end.recv(1 << 16)
            return
        try:
            data = end.recv(1024 if mode == "slow" else 1 << 16)
        except OSError:
            data = b""
        if not data:
            self.close()
            return
        try:
            if end is self.node:
                self._up(data)
            else:
                self._down(data, mode)
        except OSError:
            self.close()

    def _up(self, data):
        self.upward += data
        for kind, flags, body, raw in packets(self.upward):
            if kind == PUBLISH:
                topic, identifier, payload = published(body, flags)
                if "/measurement/" in topic:
                    sequence = json.loads(payload)["sequence"]
                    self.waiting[identifier] = sequence
                    self.witness.sent.setdefault(sequence, Sent(payload)).at.append(time.monotonic())
                    if self.witness._cut == "inside-publish":
                        self.broker.sendall(raw[: self.witness.random.randrange(1, len(raw))])
                        return self._cut()
                    self.broker.sendall(raw)
                    if self.witness._cut == "after-publish":
                        return self._cut()
                    continue
            self.broker.sendall(raw)
        return None

    def _down(self, data, mode):
        self.downward += data
        for kind, _, body, raw in packets(self.downward):
            if mode == "mute-broker":
                continue
            sequence = self.waiting.pop(int.from_bytes(body[:2], "big"), None) if kind == PUBACK else None
            if sequence is not None and self.witness._cut == "before-puback":
                return self._cut()
            if sequence is not None and self.witness._cut == "inside-puback":
                self.node.sendall(raw[: self.witness.random.randrange(1, len(raw))])
                return self._cut()
            self.node.sendall(raw)
            if sequence is not None:
                self.witness.sent[sequence].acknowledged_at.append(time.monotonic())
        return None

    def _cut(self):
        self.witness._cut = None
        self.witness.cuts += 1
        self.reset()

    def reset(self):
        _reset(self.node)
        self.close()

    def close(self):
        for end in (self.node, self.broker):
            with contextlib.suppress(KeyError, ValueError):
                self.witness._selector.unregister(end)
            end.close()
        if self in self.witness._pairs:
            self.witness._pairs.remove(self)


def _reset(end):
    with contextlib.suppress(OSError):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    end.close()
