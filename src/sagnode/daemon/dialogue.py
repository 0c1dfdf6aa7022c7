"""What the node says besides its readings, and what it does when it is asked: alarms, pictures, commands."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from sagnode.daemon.alarms import ALARMS_FILE, Alarms, Debounce
from sagnode.daemon.clock import VirtualClock
from sagnode.daemon.commands import Asked, Inbox
from sagnode.daemon.journal import Journal
from sagnode.daemon.link import Link
from sagnode.daemon.rules import configured_rules
from sagnode.daemon.uplink import Wording
from sagnode.errors import JournalError
from sagnode.exchange import AlarmMessage, MeasureCommand, PictureCommand, ResendCommand
from sagnode.message import ReadingHeader

log = logging.getLogger(__name__)

PICTURE_MAX_BYTES = 4_000_000
"""A larger overlay is not sent; links to towers are thin."""
RESEND_MAX = 10_000
"""Readings that one command has sent again; marking more would keep a slow card busy for longer than the loop waits."""


@dataclass(frozen=True)
class _Picture:
    path: Path
    sequence: int
    acquired_at: datetime


class Dialogue:
    """Alarms go out, commands are carried out.

    Args:
        alarms: of the node.
        inbox: commands; None where none are taken.
        journal: for what is to be sent again.
        link: to the broker; None where there is none.
        conductors: that are measured.
        picture_on_alarm: whether an alarm is sent with its picture.
    """

    def __init__(
        self,
        alarms: Alarms,
        inbox: Inbox | None,
        *,
        journal: Journal,
        link: Link | None,
        conductors: Sequence[str],
        picture_on_alarm: bool,
    ) -> None:
        self._alarms = alarms
        self._inbox = inbox
        self._journal = journal
        self._link = link
        self._conductors = tuple(conductors)
        self._picture_on_alarm = picture_on_alarm
        self._pictures: dict[str, _Picture] = {}
        self._to_measure: list[Asked] = []
        alarms.show()

    @property
    def active(self) -> list[AlarmMessage]:
        """Alarms in force."""
        return self._alarms.active

    def recorded(self, readings: Sequence[ReadingHeader], overlays: Mapping[str, str], now: datetime) -> None:
        """A burst is in the journal; ``overlays`` are the pictures that were drawn of it, by conductor."""
        for reading in readings:
            if reading.conductor in overlays:
                path = Path(overlays[reading.conductor])
                self._pictures[reading.conductor] = _Picture(path, reading.sequence, reading.acquired_at)
        self._alarmed(readings, now)
        asked, self._to_measure = self._to_measure, []
        for one in asked:
            assert self._inbox is not None  # noqa: S101 - it came out of it
            self._inbox.answer(
                one,
                sequences={r.conductor: r.sequence for r in readings},
                validities={r.conductor: str(r.quality.validity) for r in readings},
            )

    def idle(self, now: datetime) -> None:
        """Time has passed without a reading."""
        self._alarmed((), now)

    def wanted(self) -> bool:
        """Carry out the commands that came; True when one of them wants a reading now."""
        while self._inbox is not None and (asked := self._inbox.take()) is not None:
            match asked.command:
                case MeasureCommand():
                    self._to_measure.append(asked)
                case PictureCommand(conductor=conductor):
                    self._send_asked_picture(asked, conductor)
                case ResendCommand():
                    self._resend(asked, asked.command)
        return bool(self._to_measure)

    # -- within

    def _alarmed(self, readings: Sequence[ReadingHeader], now: datetime) -> None:
        news = self._alarms.look(readings, now)
        if self._picture_on_alarm:
            for conductor in dict.fromkeys(alarm.conductor for alarm in news.raised):
                trouble = self._send_picture(conductor)
                if trouble:
                    log.info("alarm of %s goes without a picture: %s", conductor, trouble)

    def _send_asked_picture(self, asked: Asked, conductor: str) -> None:
        assert self._inbox is not None  # noqa: S101 - it came out of it
        if conductor not in self._conductors:
            self._inbox.answer(asked, error=f"no conductor {conductor}; there are {', '.join(self._conductors)}")
            return
        trouble = self._send_picture(conductor)
        if trouble:
            self._inbox.answer(asked, error=trouble)
        else:
            self._inbox.answer(asked, picture_of=self._pictures[conductor].sequence)

    def _send_picture(self, conductor: str) -> str:
        """Send the newest overlay; returns why not, or nothing."""
        picture = self._pictures.get(conductor)
        if picture is None or self._link is None:
            return f"no picture of {conductor} since the start; storage.pictures must be true, and a reading made"
        limit = min(PICTURE_MAX_BYTES, self._link.packet_max - 1000)
        try:
            size = picture.path.stat().st_size
            if size > limit:
                return f"the picture has {size} bytes, and {limit} can be sent"
            jpeg = picture.path.read_bytes()
        except OSError as error:
            return f"picture {picture.path.name}: {error.strerror}; wait for the next reading"
        about = (("sequence", str(picture.sequence)), ("acquired_at", picture.acquired_at.isoformat()))
        self._link.say(f"picture/{conductor}", jpeg, content_type="image/jpeg", about=about)
        return ""

    def _resend(self, asked: Asked, command: ResendCommand) -> None:
        assert self._inbox is not None  # noqa: S101 - it came out of it
        newest = self._journal.next_sequence - 1
        last = newest if command.to_sequence is None else min(command.to_sequence, newest)
        if command.from_sequence > last:
            text = f"nothing from {command.from_sequence} to {last}; the newest reading is {newest}"
            self._inbox.answer(asked, error=text)
            return
        if last - command.from_sequence >= RESEND_MAX:
            wanted = last - command.from_sequence + 1
            self._inbox.answer(asked, error=f"{wanted} readings; {RESEND_MAX} at most at a time, ask in parts")
            return
        try:
            count = self._journal.owe_again(command.from_sequence, last)
        except JournalError as error:
            self._inbox.answer(asked, error=str(error))
            return
        self._inbox.answer(asked, resent=count)
        if self._link is not None and count:
            self._link.look_again()


def configured_dialogue(
    wording: Wording,
    past: Sequence[ReadingHeader],
    journal: Journal,
    link: Link | None,
    inbox: Inbox | None,
    state_dir: Path,
) -> Dialogue:
    """The dialogue of a configuration, with its alarms as they were left and what the journal remembers."""
    loaded, clock = wording.loaded, wording.clock
    node = loaded.node
    alarms = Alarms(
        wording.identity,
        configured_rules(loaded.span, node.alarms),
        Debounce(node.alarms.raise_after, node.alarms.clear_after),
        file=state_dir / ALARMS_FILE,
        publish=link.show if link is not None else _to_nobody,
        test=node.unit.commissioning,
        passed_s=clock.passed_s,
    )
    alarms.remember(past, "" if isinstance(clock, VirtualClock) else wording.boot_id)
    return Dialogue(
        alarms,
        inbox,
        journal=journal,
        link=link,
        conductors=[c.id for c in loaded.span.conductors if c.measured],
        picture_on_alarm=node.alarms.pictures,
    )


def _to_nobody(topic: str, payload: bytes) -> None:
    """Without a broker alarms are shown by ``sagnode status`` alone."""
    del topic, payload
