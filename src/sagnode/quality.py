"""Validity and reasons of a reading, in the words of IEC 61850-7-3 and in the node's own.

A reason is what a technician acts on; its ``detail_qual`` is the IEC 61850 word that a SCADA system knows.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Validity(StrEnum):
    """IEC 61850-7-3 validity; ``INVALID`` readings carry null values, never a guess."""

    GOOD = "good"
    QUESTIONABLE = "questionable"
    INVALID = "invalid"


class DetailQual(StrEnum):
    """IEC 61850-7-3 detailQual."""

    OUT_OF_RANGE = "outOfRange"
    BAD_REFERENCE = "badReference"
    OSCILLATORY = "oscillatory"
    FAILURE = "failure"
    OLD_DATA = "oldData"
    INCONSISTENT = "inconsistent"
    INACCURATE = "inaccurate"


class LensLook(StrEnum):
    """What the lens looks like from behind it."""

    CLEAR = "clear"
    DARK = "dark"
    FOGGED = "fogged"
    WET = "wet"
    DIRTY = "dirty"
    UNKNOWN = "unknown"


class Cause(StrEnum):
    """What exactly was wrong; each cause belongs to one :class:`DetailQual`."""

    # the picture
    CAMERA_FAULT = "camera-fault"
    BAD_FRAME = "bad-frame"
    DARK = "dark"
    OVEREXPOSED = "overexposed"
    LOW_CONTRAST = "low-contrast"
    FOG = "fog"
    LENS_WET = "lens-wet"
    LENS_DIRTY = "lens-dirty"
    # the conductor in it
    NO_CONDUCTOR = "no-conductor"
    TOO_LITTLE_VISIBLE = "too-little-visible"
    AMBIGUOUS = "ambiguous"
    # the camera's place
    CAMERA_MOVED = "camera-moved"
    LANDMARKS_LOST = "landmarks-lost"
    BAD_CALIBRATION = "bad-calibration"
    # the estimate
    NOT_CONVERGED = "not-converged"
    UNCERTAIN = "uncertain"
    OUTSIDE_LIMITS = "outside-limits"
    FRAMES_DISAGREE = "frames-disagree"
    WIND_SWING = "wind-swing"
    THERMAL_TREND = "thermal-trend"
    ICE_SUSPECT = "ice-suspect"
    # the node
    DEADLINE = "deadline"
    WORKER_CRASHED = "worker-crashed"
    WORKER_GARBAGE = "worker-garbage"
    STALE_FRAME = "stale-frame"


DETAIL_QUAL: dict[Cause, DetailQual] = {
    Cause.CAMERA_FAULT: DetailQual.FAILURE,
    Cause.BAD_FRAME: DetailQual.FAILURE,
    Cause.DARK: DetailQual.FAILURE,
    Cause.OVEREXPOSED: DetailQual.FAILURE,
    Cause.LOW_CONTRAST: DetailQual.FAILURE,
    Cause.FOG: DetailQual.FAILURE,
    Cause.LENS_WET: DetailQual.FAILURE,
    Cause.LENS_DIRTY: DetailQual.FAILURE,
    Cause.NO_CONDUCTOR: DetailQual.FAILURE,
    Cause.TOO_LITTLE_VISIBLE: DetailQual.FAILURE,
    Cause.AMBIGUOUS: DetailQual.INCONSISTENT,
    Cause.CAMERA_MOVED: DetailQual.BAD_REFERENCE,
    Cause.LANDMARKS_LOST: DetailQual.BAD_REFERENCE,
    Cause.BAD_CALIBRATION: DetailQual.BAD_REFERENCE,
    Cause.NOT_CONVERGED: DetailQual.INCONSISTENT,
    Cause.UNCERTAIN: DetailQual.INACCURATE,
    Cause.OUTSIDE_LIMITS: DetailQual.OUT_OF_RANGE,
    Cause.FRAMES_DISAGREE: DetailQual.OSCILLATORY,
    Cause.WIND_SWING: DetailQual.OSCILLATORY,
    Cause.THERMAL_TREND: DetailQual.INCONSISTENT,
    Cause.ICE_SUSPECT: DetailQual.INCONSISTENT,
    Cause.DEADLINE: DetailQual.FAILURE,
    Cause.WORKER_CRASHED: DetailQual.FAILURE,
    Cause.WORKER_GARBAGE: DetailQual.FAILURE,
    Cause.STALE_FRAME: DetailQual.OLD_DATA,
}


@dataclass(frozen=True)
class Reason:
    """One reason for less than good quality: the cause and a sentence that names numbers and the remedy."""

    cause: Cause
    text: str

    @property
    def detail_qual(self) -> DetailQual:
        """The IEC 61850-7-3 word for this cause."""
        return DETAIL_QUAL[self.cause]
