"""Commands as they arrive: validated, bounded in size and rate, answered. Nothing is carried out here.

The link's thread puts them in, the daemon's loop takes them out. Whatever is not a command by its schema is answered
with an error and has no other effect; what is not even worth an answer (a retained command, a flood) is logged.
"""

from __future__ import annotations

import json
import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from pydantic import ValidationError

from sagnode.daemon.logs import Seldom
from sagnode.exchange import (
    COMMAND,
    COMMAND_MAX_BYTES,
    CORRELATION_MAX,
    MeasureCommand,
    PictureCommand,
    ReplyMessage,
    ResendCommand,
)

log = logging.getLogger(__name__)

WAITING_MAX = 8
"""Commands that wait for the loop, which may be in the middle of a reading."""


class Send(Protocol):
    """Publishes a message once; see :meth:`sagnode.daemon.link.Link.say`."""

    def __call__(self, topic: str, payload: bytes, *, content_type: str, correlation: bytes | None) -> None:
        """Publish below the prefix."""


@dataclass(frozen=True)
class Asked:
    """A valid command that waits."""

    command: MeasureCommand | PictureCommand | ResendCommand
    correlation: bytes | None
    """MQTT 5 correlation data of the request."""


class Inbox:
    """Takes commands from the link's thread and hands them to the loop.

    Args:
        per_minute: rate of commands that are heard; as many refusals are answered, the rest is dropped.
        now: time of day.
        monotonic: seconds.
    """

    def __init__(
        self,
        per_minute: int,
        *,
        now: Callable[[], datetime],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._send: Send | None = None
        self._now = now
        self._waiting: deque[Asked] = deque()
        self._per_minute = per_minute
        self._heard = _Allowance(per_minute, monotonic)
        self._refused = _Allowance(per_minute, monotonic)
        self._complaints = Seldom(log)

    def answer_by(self, send: Send) -> None:
        """Replies go this way from now on."""
        self._send = send

    def receive(self, payload: bytes, *, retained: bool, correlation: bytes | None) -> None:
        """One message from the topic ``command``; called in the link's thread."""
        if retained:
            # It would be carried out again after every reconnection.
            self._complaints.error("a retained command is ignored; publish commands without the retain flag")
            return
        if not self._heard.spend():
            self._refuse(f"more than {self._per_minute} commands a minute (commands.per_minute); wait", correlation)
            return
        if len(payload) > COMMAND_MAX_BYTES:
            self._refuse(f"{len(payload)} bytes; a command has {COMMAND_MAX_BYTES} at most", correlation)
            return
        try:
            command = COMMAND.validate_json(payload)
        except ValidationError as error:
            self._refuse(_faults(error), correlation, _own_correlation(payload))
            return
        asked = Asked(command, correlation)
        if len(self._waiting) >= WAITING_MAX:
            self.answer(asked, error=f"{WAITING_MAX} commands wait already; wait for their replies")
            return
        self._waiting.append(asked)

    def take(self) -> Asked | None:
        """The next command, or None; called by the loop."""
        try:
            return self._waiting.popleft()
        except IndexError:
            return None

    def answer(self, asked: Asked, *, error: str | None = None, **results: object) -> None:
        """Answer a command that was taken: with its results, or with what was wrong."""
        reply = ReplyMessage.model_validate(
            {
                "at": self._now(),
                "command": asked.command.command,
                "ok": error is None,
                "error": error,
                "correlation": asked.command.correlation,
                **results,
            }
        )
        log.info("command %s: %s", asked.command.command, error or "done")
        self._reply(reply, asked.correlation)

    def _refuse(self, error: str, correlation: bytes | None, own: str | None = None) -> None:
        self._complaints.error(f"command refused: {error}")
        if self._refused.spend():
            reply = ReplyMessage(at=self._now(), command=None, ok=False, error=error, correlation=own)
            self._reply(reply, correlation)

    def _reply(self, reply: ReplyMessage, correlation: bytes | None) -> None:
        if self._send is not None:
            payload = reply.model_dump_json().encode()
            self._send("reply", payload, content_type="application/json", correlation=correlation)


class _Allowance:
    """So many a minute, and no more at once."""

    def __init__(self, per_minute: int, monotonic: Callable[[], float]) -> None:
        self._per_minute = per_minute
        self._monotonic = monotonic
        self._left = float(per_minute)
        self._at = monotonic()

    def spend(self) -> bool:
        now = self._monotonic()
        self._left = min(float(self._per_minute), self._left + (now - self._at) * self._per_minute / 60)
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


def _own_correlation(payload: bytes) -> str | None:
    """The correlation that a refused command bears in its payload; under MQTT 3.1.1 there is no other."""
    try:
        own = json.loads(payload)["correlation"]
        own.encode()  # half a surrogate pair is text in JSON's escapes, and no text that could be sent back
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return own if isinstance(own, str) and len(own) <= CORRELATION_MAX else None


def _printable(text: str) -> str:
    return "".join(sign if sign.isprintable() else "?" for sign in text)


def _faults(error: ValidationError) -> str:
    """At most three faults of a command in words, without its own text, which may be anything."""
    found = []
    for fault in error.errors(include_url=False, include_input=False)[:3]:
        # Unknown keys and words are quoted, and they are the sender's own text: no line of its making in the log.
        place = ".".join(_printable(str(word)[:40]) for word in fault["loc"][1:])
        message = _printable(fault["msg"][:200])
        found.append(f"{place}: {message}" if place else message)
    return f"{'; '.join(found)}; the schema of a command: sagnode schema command"
