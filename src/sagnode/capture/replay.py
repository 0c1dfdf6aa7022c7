"""Frames from files, with the files' own times or at a given cadence."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from sagnode.capture.port import Frame, FrameSource
from sagnode.capture.tracks import Track, find_track
from sagnode.config.node import ReplaySource
from sagnode.errors import EndOfFrames, FrameError
from sagnode.quality import Cause

_CHECKED_TIMES = 200


class Replay(FrameSource):
    """Shows the frames of a directory, glob or video in natural order, each once.

    A burst takes consecutive frames, fewer at the end. A damaged file costs its burst: FrameError, and the next burst
    begins after it. With ``at_end = "loop"`` the times of every further round go on after those of the last, so that
    time never runs back. With ``"hold"`` files that are added later are shown too.
    """

    def __init__(self, config: ReplaySource) -> None:
        self._config = config
        self._start = None if config.start is None else datetime.fromisoformat(config.start).astimezone(UTC)
        self._track: Track | None = None
        self._next = 0  # counts on through the rounds of a loop

    def open(self) -> None:
        """Find the files; raises FrameError when there are none or their times do not ascend."""
        self.close()
        self._track = find_track(self._config.path)
        self._next = 0
        if self._config.cadence_s is None:
            self._check_times(self._track)

    def burst(self, count: int, interval_s: float) -> list[Frame]:
        """The next ``count`` frames; ``interval_s`` is the files' own.

        Raises:
            EndOfFrames: all have been shown (``at_end = "stop"``).
            FrameError: (stale-frame) all have been shown (``"hold"``); (bad-frame) a file of this burst is damaged.
        """
        return list(self.frames(count, interval_s))

    def frames(self, count: int, interval_s: float) -> Iterator[Frame]:  # noqa: ARG002 - the port's
        """The same, each file read when its frame is asked for: no more than one is in memory."""
        track = self._opened()
        if self._config.at_end == "hold" and self._next >= track.count():
            track.look_again()
        shown = self._next
        left = count if self._config.at_end == "loop" else min(count, track.count() - shown)
        if left <= 0:
            raise self._ended(track)
        self._next += left
        for i in range(left):
            # a video may turn out shorter than it said
            if not self._beyond(track, shown + i):
                yield self._frame(track, shown + i)
            elif i == 0:
                raise self._ended(track)

    def close(self) -> None:
        """Close the video, if one is open."""
        if self._track is not None:
            self._track.close()
            self._track = None

    def describe(self) -> str:
        """Back end, path, and how far it is."""
        if self._track is None:
            return f"replay {self._config.path}, closed"
        count = self._track.count()
        rounds, frame = divmod(self._next, count) if self._config.at_end == "loop" else (0, min(self._next, count))
        return f"replay {self._config.path}, frame {frame} of {count}" + (f", round {rounds + 1}" if rounds else "")

    def first_frame_at(self) -> datetime | None:
        """Time of the next frame; None after the last."""
        track = self._opened()
        if self._beyond(track, self._next):
            return None
        return self._time(track, self._next)[0]

    def skip_until(self, utc: datetime) -> None:
        """Pass over frames whose time is not later than ``utc``."""
        track = self._opened()
        if self._config.at_end == "loop":
            rounds = (utc - self._time(track, 0)[0]) / self._period(track)
            self._next = max(self._next, math.floor(rounds) * track.count())
        while not self._beyond(track, self._next) and self._time(track, self._next)[0] <= utc:
            self._next += 1

    def _opened(self) -> Track:
        if self._track is None:
            raise FrameError(f"replay {self._config.path} is closed", "open it first")
        return self._track

    def _beyond(self, track: Track, index: int) -> bool:
        return self._config.at_end != "loop" and index >= track.count()

    def _frame(self, track: Track, index: int) -> Frame:
        utc, origin = self._time(track, index)
        image, name = track.read(index % track.count())
        return Frame(image, utc, time.monotonic(), name, {"file": name, "time_from": origin})

    def _time(self, track: Track, index: int) -> tuple[datetime, str]:
        round_, i = divmod(index, track.count()) if self._config.at_end == "loop" else (0, index)
        later = round_ * self._period(track) if round_ else timedelta(0)
        if self._config.cadence_s is None:
            utc, origin = track.own_time(i)
            return utc + later, origin
        first = self._start or track.own_time(0)[0]
        return first + timedelta(seconds=i * self._config.cadence_s) + later, "cadence"

    def _period(self, track: Track) -> timedelta:
        """How much later the frames of the next round are: one round and one step."""
        last = track.count() - 1
        if self._config.cadence_s is not None:
            return timedelta(seconds=track.count() * self._config.cadence_s)
        if last == 0:
            return timedelta(seconds=1)
        end = track.own_time(last)[0]
        return (end - track.own_time(0)[0]) + (end - track.own_time(last - 1)[0])

    def _ended(self, track: Track) -> FrameError:
        if self._config.at_end == "hold":
            return FrameError(
                f"replay {self._config.path} has no frame after its {track.count()}",
                'add frames, or set camera.replay.at_end to "loop"',
                Cause.STALE_FRAME,
            )
        return EndOfFrames(f"replay {self._config.path} has shown its last frame ({track.count()})")

    def _check_times(self, track: Track) -> None:
        """Time must not run back; equal modification times are those of a copy and tell nothing."""
        times = [track.own_time(i) for i in range(min(track.count(), _CHECKED_TIMES))]
        for i, ((a, _), (b, origin)) in enumerate(itertools.pairwise(times)):
            if b < a or (b == a and origin == "modified"):
                raise FrameError(
                    f"replay {self._config.path}: frame {i + 2} ({b:%Y-%m-%d %H:%M:%S}, from {origin}) is not later"
                    f" than frame {i + 1} ({a:%Y-%m-%d %H:%M:%S})",
                    "name the files by their time (20260621T113000Z.png), or give camera.replay.cadence_s and start",
                )
