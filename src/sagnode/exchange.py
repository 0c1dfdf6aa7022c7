"""Messages besides readings and health: alarms, and the commands that a node takes with its replies to them.

This module imports neither NumPy nor OpenCV.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field, TypeAdapter

from sagnode.message import FORM, Identity, Strict

COMMAND_MAX_BYTES = 2048
"""A longer command is refused unread."""
CORRELATION_MAX = 128
"""Characters."""


class AlarmKind(StrEnum):
    """What an alarm is about; the last level of its topic."""

    CLEARANCE = "clearance"
    SAG = "sag"
    ICE_SUSPECT = "ice-suspect"
    SWING = "swing"
    CAMERA_MOVED = "camera-moved"
    STALE = "stale"


class AlarmMessage(Identity):
    """Retained on ``alarm/<conductor>/<kind>`` while it lasts; an empty message ends it.

    ``value`` with its interval is that of the newest reading that has one, ``worst`` the worst since it was raised.
    """

    schema_version: Literal["sagnode.alarm/1"] = Field(default="sagnode.alarm/1", description=FORM)
    conductor: str = Field(description="id of the conductor in the span file")
    kind: AlarmKind = Field(description="what it is about")
    event_id: str = Field(description="the same from raising to clearing, also across restarts; never used again")
    since: AwareDatetime = Field(description="acquisition of the first reading that showed it")
    updated_at: AwareDatetime = Field(description="acquisition of the newest reading that was looked at")
    sequence: int | None = Field(default=None, description="of the newest reading that has a value")
    quantity: str | None = Field(default=None, description="field of the reading that is held against the limit")
    limit: float | None = Field(default=None, description="in the quantity's unit")
    value: float | None = Field(default=None, description="of the quantity, in the newest reading that has one")
    u: float | None = Field(default=None, description="standard uncertainty of value")
    lo: float | None = Field(default=None, description="lower end of the 95 % interval of value")
    hi: float | None = Field(default=None, description="upper end of the 95 % interval of value")
    worst: float | None = Field(default=None, description="the quantity at its worst since it was raised")
    worst_at: AwareDatetime | None = Field(default=None, description="acquisition of the reading with the worst")
    test: bool = Field(default=False, description="raised while the unit is being commissioned")
    text: str = Field(description="one sentence with the numbers")


class _Command(Strict):
    correlation: str | None = Field(
        default=None,
        max_length=CORRELATION_MAX,
        description="repeated in the reply; MQTT 5 correlation data is repeated as such",
    )


class MeasureCommand(_Command):
    """Make a reading of all conductors now; it is published as every reading is."""

    command: Literal["measure"] = Field(description="a reading of all conductors now")


class PictureCommand(_Command):
    """Send the overlay of a conductor's newest reading on ``picture/<conductor>``."""

    command: Literal["picture"] = Field(description="the overlay of the newest reading")
    conductor: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$", description="id in the span file")


class ResendCommand(_Command):
    """Publish readings once more that were acknowledged already, in order and marked as backfill."""

    command: Literal["resend"] = Field(description="readings once more")
    from_sequence: int = Field(ge=1, le=2**62, strict=True, description="the first")
    to_sequence: int | None = Field(
        default=None, ge=1, le=2**62, strict=True, description="the last; default: the newest"
    )


Command = Annotated[MeasureCommand | PictureCommand | ResendCommand, Field(discriminator="command")]
COMMAND: TypeAdapter[MeasureCommand | PictureCommand | ResendCommand] = TypeAdapter(Command)


class ReplyMessage(Strict):
    """Answer to one command, on ``reply``; a command that is refused changes nothing."""

    schema_version: Literal["sagnode.reply/1"] = Field(default="sagnode.reply/1", description=FORM)
    at: AwareDatetime = Field(description="when it was answered")
    command: str | None = Field(description="which; null where it could not be made out")
    ok: bool = Field(description="whether it was done")
    error: str | None = Field(default=None, description="what was wrong with it, and what would be right")
    correlation: str | None = Field(default=None, description="that of the command, where its payload had one")
    sequences: dict[str, int] = Field(default={}, description="measure: number of the reading of each conductor")
    validities: dict[str, str] = Field(default={}, description="measure: validity of the reading of each conductor")
    picture_of: int | None = Field(default=None, description="picture: number of the reading that it shows")
    resent: int | None = Field(default=None, description="resend: so many readings will be published again")
