"""Where the daemon's loop leaves word for the link's thread."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

NOTES_MAX = 20
"""Replies and pictures that wait for a connection; the oldest go."""
NOTE_KEPT_S = 60.0
"""An answer that comes later than this is of no use to who asked."""
PACKET_MAX = 2**28
"""MQTT's own limit of a packet, bytes."""

About = tuple[tuple[str, str], ...]
"""Names and values of MQTT 5 user properties."""


@dataclass(frozen=True)
class Farewell:
    """How the link is to end: send what is owed until then (monotonic seconds), then say this on ``status``."""

    drain_until: float
    status: bytes


@dataclass(frozen=True)
class Note:
    """A message that is sent once and not retained: a reply, a picture."""

    topic: str
    payload: bytes
    content_type: str
    correlation: bytes | None = None
    about: About = ()


class Mailbox:
    """Where the daemon's loop leaves word for the link's thread: retained documents, notes, a nudge, the farewell."""

    def __init__(self) -> None:
        self.farewell: Farewell | None = None
        self.look_again = False
        """Readings in the journal are owed once more."""
        self.packet_max = PACKET_MAX
        """Largest packet that the broker takes, bytes."""
        self.refused: dict[str, str] = {}
        """Topics of documents and notes that the broker would not take, and what it answered."""
        self._notes: deque[tuple[float, Note]] = deque(maxlen=NOTES_MAX)
        self._documents: dict[str, bytes] = {}
        self._unsent: set[str] = set()
        self._lock = threading.Lock()
        self._pipe_lock = threading.Lock()
        self._closed = False
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

    def drop(self, note: Note) -> None:
        """Leave a note; it is sent once, or never when no connection comes soon."""
        self._notes.append((time.monotonic(), note))

    def notes(self) -> list[Note]:
        """Notes that are not sent yet, nor too old."""
        found = []
        while self._notes:
            left_at, note = self._notes.popleft()
            if time.monotonic() - left_at < NOTE_KEPT_S:
                found.append(note)
        return found

    def send_all_again(self) -> None:
        """A new connection: the broker may have forgotten."""
        with self._lock:
            self._unsent.update(self._documents)

    @property
    def empty(self) -> bool:
        """Whether every document and note was taken."""
        with self._lock:
            return not self._unsent and not self._notes

    def over(self) -> bool:
        """Whether the time for the farewell has come, drained or not."""
        return self.farewell is not None and time.monotonic() >= self.farewell.drain_until

    def nudge(self) -> None:
        """End the thread's wait."""
        with self._pipe_lock, contextlib.suppress(BlockingIOError):
            if not self._closed:
                os.write(self._nudge, b"n")

    def clear_nudges(self) -> None:
        """They have been seen."""
        with contextlib.suppress(BlockingIOError):
            while os.read(self.nudged, 4096):
                pass

    def close(self) -> None:
        """Nobody reads any more; what is left later disturbs nobody."""
        with self._pipe_lock:
            if not self._closed:
                self._closed = True
                os.close(self.nudged)
                os.close(self._nudge)
