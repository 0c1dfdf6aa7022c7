"""The few exceptions that cross a boundary; each says what is wrong, where, and what to do."""

from __future__ import annotations

from sagnode.quality import Cause, Reason


class SagnodeError(Exception):
    """Something a person can mend.

    Args:
        what: what is wrong and where (file, key, device, value).
        remedy: what to do about it.
    """

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.what}; {self.remedy}" if self.remedy else self.what


class ConfigError(SagnodeError):
    """The configuration, the survey or a calibration file cannot be used; ``faults`` holds every fault found."""

    def __init__(self, what: str, remedy: str = "", faults: tuple[str, ...] = ()) -> None:
        super().__init__(what, remedy)
        self.faults = faults or (what,)


class FrameError(SagnodeError):
    """A frame or picture cannot be had or cannot be read; becomes an invalid reading with this cause."""

    def __init__(self, what: str, remedy: str = "", cause: Cause = Cause.CAMERA_FAULT) -> None:
        super().__init__(what, remedy)
        self.cause = cause

    @property
    def reason(self) -> Reason:
        """The reason that an invalid reading carries."""
        return Reason(self.cause, str(self))


class EndOfFrames(FrameError):
    """A replay has shown its last frame."""


class JournalError(SagnodeError):
    """The journal cannot be opened, read or written."""


class DiskError(JournalError):
    """The disk under the journal refuses: full, read-only, damaged or gone; it may be better later."""
