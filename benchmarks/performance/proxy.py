"""A TCP proxy between the daemon and its broker that counts what passes, and what for."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
import threading
from collections import Counter
from dataclasses import dataclass, field
from typing import Self

from performance.packets import Packets

_SEGMENTS_AT = 136
"""Of tcpi_segs_out and tcpi_segs_in in Linux' struct tcp_info (linux/tcp.h)."""
HEADERS = 52
"""Bytes of IPv4 and TCP headers with timestamps that every segment carries."""


@dataclass(frozen=True)
class Passed:
    """Counts since the start."""

    up: int
    """Bytes of the TCP stream from the daemon to the broker."""
    down: int
    segments_up: int
    """Packets that the daemon has sent, acknowledgements included."""
    sent: Counter[str] = field(default_factory=Counter)
    """MQTT packets from the daemon by what they were for: ``measurement``, ``health``, ``keep-alive`` and so on."""
    sent_bytes: Counter[str] = field(default_factory=Counter)
    sent_segments: Counter[str] = field(default_factory=Counter)
    """Network packets of 1400 bytes that those fill."""

    def since(self, before: Passed) -> Passed:
        """What came since."""
        return Passed(
            self.up - before.up,
            self.down - before.down,
            self.segments_up - before.segments_up,
            self.sent - before.sent,
            self.sent_bytes - before.sent_bytes,
            self.sent_segments - before.sent_segments,
        )


class Proxy:
    """Use as a context manager; ``port`` is where the daemon is to connect. One connection at a time is enough.

    Args:
        broker_port: on this machine.
        prefix: of the topics, which is left out of what a message is called.
    """

    def __init__(self, broker_port: int, prefix: str = "") -> None:
        self._broker_port = broker_port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._up = self._down = self._segments_before = 0
        self._packets = Packets(prefix)
        self._near: socket.socket | None = None

    def __enter__(self) -> Self:
        """Begin to listen."""
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        """Close everything."""
        self._stop.set()
        self._thread.join(5)
        self._listener.close()

    def passed(self) -> Passed:
        """Counts up to now."""
        segments = self._segments_before + _segments_in(self._near)
        seen = (self._packets.count, self._packets.size, self._packets.segments)
        return Passed(self._up, self._down, segments, *(Counter(c) for c in seen))

    def _serve(self) -> None:
        self._listener.settimeout(0.2)
        while not self._stop.is_set():
            with contextlib.suppress(TimeoutError):
                near, _ = self._listener.accept()
                with near, socket.create_connection(("127.0.0.1", self._broker_port)) as far:
                    self._near = near
                    self._packets.begin()
                    self._pump(near, far)
                    self._segments_before += _segments_in(near)
                    self._near = None

    def _pump(self, near: socket.socket, far: socket.socket) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(near, selectors.EVENT_READ, far)
            selector.register(far, selectors.EVENT_READ, near)
            while not self._stop.is_set():
                for key, _ in selector.select(0.2):
                    source = near if key.fileobj is near else far
                    with contextlib.suppress(ConnectionError):
                        data = source.recv(1 << 16)
                        # counted before it goes on, so that whoever has received it finds it counted
                        if source is near:
                            self._up += len(data)
                            self._packets.take(data)
                        else:
                            self._down += len(data)
                        key.data.sendall(data)
                        if data:
                            continue
                    return


def _segments_in(sock: socket.socket | None) -> int:
    if sock is None:
        return 0
    with contextlib.suppress(OSError, struct.error):
        info = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 192)
        return int(struct.unpack_from("=2I", info, _SEGMENTS_AT)[1])
    return 0
