"""What a replay shows, frame by frame: a list of picture files, or a video."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2

from sagnode.capture.images import MAX_PIXELS, read_grey, to_grey8
from sagnode.capture.port import GreyImage
from sagnode.capture.taken import name_time, taken_at
from sagnode.errors import FrameError
from sagnode.quality import Cause

PICTURES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".pgm", ".ppm"})
VIDEOS = frozenset({".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm", ".ts", ".mjpg", ".mjpeg", ".h264"})
_DAMAGED = "take that frame out, or record it again"


def find_track(path: str) -> Track:
    """The pictures of a directory or glob in natural order, or a video.

    Raises:
        FrameError: nothing there, or nothing that is a picture or video.
    """
    place = Path(path)
    pictures = Pictures(path)
    if place.suffix.lower() in VIDEOS and place.is_file():
        return Video(place)
    if pictures.count() == 0:
        kinds = ", ".join(sorted(PICTURES | VIDEOS))
        if place.is_dir() or _is_glob(path):
            raise FrameError(f"replay {path}: no pictures there", f"known are {kinds}")
        if place.exists():
            raise FrameError(f"replay {path}: neither a picture nor a video", f"known are {kinds}")
        raise FrameError(
            f"replay {path}: no such file or directory", "check the path; in a node file it is camera.replay.path"
        )
    return pictures


class Track(ABC):
    """Frames by index; :meth:`count` may grow or shrink as files come or a video turns out shorter than it said."""

    @abstractmethod
    def count(self) -> int:
        """Frames known now."""

    @abstractmethod
    def own_time(self, index: int) -> tuple[datetime, str]:
        """UTC of a frame and where that was found; raises FrameError."""

    @abstractmethod
    def read(self, index: int) -> tuple[GreyImage, str]:
        """A frame and its name; raises FrameError."""

    def look_again(self) -> None:  # noqa: B027 - a video does not grow
        """Find frames that were added after the last."""

    def close(self) -> None:  # noqa: B027 - pictures hold nothing open
        """Release what is open."""


def natural_key(name: str) -> tuple[str | int, ...]:
    """Sorts ``frame2`` before ``frame10``: text and numbers by turns."""
    return tuple(int(part) if part.isdigit() else part.lower() for part in re.split(r"([0-9]+)", name))


class Pictures(Track):
    """Picture files of a directory, glob or single path."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._files = self._list()

    def _list(self) -> list[Path]:
        try:
            return self._found()
        except OSError as error:
            raise FrameError(f"replay {self._path}: {error.strerror}", "check who may read it, and the disk") from None

    def _found(self) -> list[Path]:
        place = Path(self._path)
        if place.is_dir():
            found = list(place.iterdir())
        elif _is_glob(self._path):
            root = Path(place.anchor or ".")
            found = list(root.glob(str(place.relative_to(place.anchor)) if place.anchor else self._path))
        else:
            found = [place]
        # Hidden files are pictures that someone is still writing.
        pictures = [f for f in found if f.suffix.lower() in PICTURES and not f.name.startswith(".") and f.is_file()]
        return sorted(pictures, key=lambda f: natural_key(str(f)))

    def count(self) -> int:
        """Pictures found."""
        return len(self._files)

    def own_time(self, index: int) -> tuple[datetime, str]:
        """From name, EXIF or modification time."""
        file = self._files[index]
        try:
            return taken_at(file)
        except OSError as error:
            raise FrameError(f"picture {file} cannot be read: {error.strerror}", _DAMAGED, Cause.BAD_FRAME) from None

    def read(self, index: int) -> tuple[GreyImage, str]:
        """One file, whole."""
        return read_grey(self._files[index]), str(self._files[index])

    def look_again(self) -> None:
        """Add files that sort after the last one."""
        last = natural_key(str(self._files[-1]))
        self._files += [f for f in self._list() if natural_key(str(f)) > last]


class Video(Track):
    """A video file; frames are decoded in order, and passed over without conversion when some are skipped."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._open()
        self._rate = self._capture.get(cv2.CAP_PROP_FPS)
        if not 0 < self._rate < 1000:
            raise FrameError(
                f"replay {path}: the video states no frame rate", "give camera.replay.cadence_s and pictures"
            )
        self._count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if self._count < 1:  # raw streams state no length
            self._count = sum(iter(self._capture.grab, False))
            self._open()
        first = name_time(path.stem)
        self._origin = "modified" if first is None else "name"
        length = timedelta(seconds=self._count / self._rate)
        self._first = first or datetime.fromtimestamp(path.stat().st_mtime, UTC) - length

    def _open(self) -> None:
        self._capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        self._at = 0
        if not self._capture.isOpened():
            raise FrameError(
                f"replay {self._path}: the video cannot be opened; it is damaged or of an unknown kind",
                "convert it, for example: ffmpeg -i IN -c:v libx264 OUT.mp4",
                Cause.BAD_FRAME,
            )
        width, height = (int(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MAX_PIXELS:
            what = f"replay {self._path} claims frames of {width}x{height} px"
            raise FrameError(
                what,
                f"at most {MAX_PIXELS // 1_000_000} megapixels are read; use the camera's own size",
                Cause.BAD_FRAME,
            )

    def count(self) -> int:
        """Frames that the file states, or that could be read."""
        return self._count

    def own_time(self, index: int) -> tuple[datetime, str]:
        """The file's time plus the frame's place at the stated rate."""
        return self._first + timedelta(seconds=index / self._rate), self._origin

    def read(self, index: int) -> tuple[GreyImage, str]:
        """One frame; going back begins the file anew."""
        name = f"{self._path} frame {index}"
        if index < self._at:
            self._capture.release()
            self._open()
        while self._at < index and self._capture.grab():
            self._at += 1
        ok, pixels = self._capture.read() if self._at == index else (False, None)
        if not ok or pixels is None:
            said, self._count = self._count, self._at
            what = f"video {self._path} ends after {self._at} of the {said} frames that it states"
            raise FrameError(what, _DAMAGED, Cause.BAD_FRAME)
        self._at += 1
        return to_grey8(pixels, name), name

    def close(self) -> None:
        """Close the file."""
        self._capture.release()


def _is_glob(path: str) -> bool:
    return any(sign in path for sign in "*?[")
