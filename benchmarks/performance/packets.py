"""Cuts one direction of an MQTT connection into its control packets and says what each was for."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

PUBLISH = 3
TYPES = {
    1: "connection",
    2: "connection",
    4: "acknowledgements",
    5: "acknowledgements",
    6: "acknowledgements",
    7: "acknowledgements",
    8: "connection",
    9: "connection",
    12: "keep-alive",
    13: "keep-alive",
    14: "connection",
}
"""Types of control packets (MQTT 5.0, table 2-1)."""
MOST = 5
"""Bytes of the longest fixed header (MQTT 5.0, 2.1.1)."""


@dataclass
class Packets:
    """Give it the bytes as they come; it counts packets and bytes by what they were for.

    A message counts as the first level of its topic below the prefix.
    """

    prefix: str
    count: Counter[str] = field(default_factory=Counter)
    size: Counter[str] = field(default_factory=Counter)
    segments: Counter[str] = field(default_factory=Counter)
    """Packets of a network with so many bytes in each, were every control packet sent by itself."""
    segment_bytes: int = 1400
    _rest: bytearray = field(default_factory=bytearray)

    def begin(self) -> None:
        """A connection begins; what was left of the last one is of no use."""
        self._rest.clear()

    def take(self, data: bytes) -> None:
        """The next bytes of the stream."""
        self._rest += data
        while (length := _whole(self._rest)) is not None and length <= len(self._rest):
            self._note(bytes(self._rest[:length]))
            del self._rest[:length]

    def _note(self, packet: bytes) -> None:
        kind = packet[0] >> 4
        what = self._topic(packet) if kind == PUBLISH else TYPES.get(kind, "other")
        self.count[what] += 1
        self.size[what] += len(packet)
        self.segments[what] += -(-len(packet) // self.segment_bytes)

    def _topic(self, packet: bytes) -> str:
        header = _header(packet)
        length = int.from_bytes(packet[header : header + 2], "big")
        topic = packet[header + 2 : header + 2 + length].decode(errors="replace")
        return topic.removeprefix(self.prefix).strip("/").partition("/")[0]


def _whole(data: bytes | bytearray) -> int | None:
    """Bytes of the packet that begins here; None where its fixed header is not all here."""
    header = _header(data)
    if header == 0:
        return None
    return header + sum((b & 127) << 7 * k for k, b in enumerate(data[1:header]))


def _header(data: bytes | bytearray) -> int:
    """Bytes of the fixed header; 0 where it is not all here."""
    for k in range(1, min(MOST, len(data))):
        if data[k] < 128:
            return k + 1
    return 0
