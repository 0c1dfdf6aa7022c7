"""The port that every camera stands behind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

GreyImage = NDArray[np.uint8]


@dataclass(frozen=True)
class Frame:
    """One picture: 8-bit grey (height, width), when it was exposed, and what the camera said about it."""

    image: GreyImage
    utc: datetime
    """Aware UTC of exposure."""
    monotonic_s: float
    """The same instant on the monotonic clock; for files, of reading."""
    source: str
    """File or device, for messages."""
    metadata: Mapping[str, object] = field(default_factory=dict)


class FrameSource(ABC):
    """A source of frames. Every call is bounded in time; a failure is a :class:`sagnode.errors.FrameError`."""

    @abstractmethod
    def open(self) -> None:
        """Open and configure the source; raises FrameError naming the device or path."""

    @abstractmethod
    def burst(self, count: int, interval_s: float) -> list[Frame]:
        """Take ``count`` frames, at least ``interval_s`` apart.

        Raises:
            EndOfFrames: a replay has no more.
            FrameError: nothing usable came in time.
        """

    def frames(self, count: int, interval_s: float) -> Iterator[Frame]:
        """The frames of :meth:`burst` one after the other; none is held here any longer once it is handed on.

        A source whose frames wait for nobody takes all of them first; one that has them in files reads each when it is
        asked for. The errors are those of :meth:`burst`, and may come at any frame.
        """
        taken = self.burst(count, interval_s)
        taken.reverse()
        while taken:
            yield taken.pop()

    @abstractmethod
    def close(self) -> None:
        """Release the device; never raises, may be called twice."""

    def describe(self) -> str:
        """One line for status: back end, device, negotiated format."""
        return type(self).__name__

    def first_frame_at(self) -> datetime | None:
        """Time of the next frame where the source has times of its own (replay), else None."""
        return None

    def skip_until(self, utc: datetime) -> None:  # noqa: B027 - doing nothing is right for live cameras
        """Pass over frames that are not later than ``utc``, so that a new worker goes on where the last one ended.

        Sources without times of their own have nothing to pass over.
        """
