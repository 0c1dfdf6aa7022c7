"""Pictures from files and buffers as 8-bit grey, whole or not at all.

The grey of a colour picture is Rec. 601 luma. Pixels stay in the sensor's own orientation: a file's EXIF rotation is
not applied, since the intrinsics belong to the sensor.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import threading
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.headers import DamagedError, Header, read_header
from sagnode.capture.port import GreyImage
from sagnode.errors import FrameError, SagnodeError
from sagnode.outfile import whole
from sagnode.quality import Cause

MAX_PIXELS = 64_000_000
"""Largest picture that is decoded: five times the largest Raspberry Pi camera's, and 64 MB of grey."""
MAX_DECODED_BYTES = 3 * MAX_PIXELS
"""8-bit colour, or 16-bit grey, of that size; a small file may claim four channels of 16 bits."""
MIN_SIDE = 16
MAX_FILE_BYTES = 8 * MAX_PIXELS
"""No uncompressed picture of MAX_PIXELS is larger (4 channels of 16 bits)."""

_REMEDY = "take or copy the picture again"
_KINDS_REMEDY = "give a JPEG, PNG, TIFF or binary PGM/PPM picture"
_RIGHT_ALIGNED = 4096
_STRAY_BYTES = re.compile(r"Corrupt JPEG data: (\d+) extraneous bytes before marker 0xd9")
_COMPLAINTS = ("Corrupt JPEG data", "Premature end of JPEG", "Inconsistent progression", "libpng error")
_TIFF_COMPLAINT = re.compile(r"TIFF_(Error|Warning (\w*Decode|JPEGLib)).*|OpenCV TIFF: (?!TIFFReadDir|TIFFFetch).*")
_NOT_TO_HAND_ON = (*_COMPLAINTS, "libpng", "[ WARN", "[ERROR", "[DEBUG", "[ INFO", "imdecode_", "OpenCV TIFF")
_PADDING = range(4, 33)
"""Zeros at the end of a scan with which some cameras fill it up. Fewer may be the picture's own, more a hole in it."""

_stderr_lock = threading.Lock()


def read_grey(path: Path | str) -> GreyImage:
    """Read a picture file.

    Returns:
        8-bit grey, (height, width), C-contiguous.

    Raises:
        FrameError: (bad-frame) missing, a directory, pipe or device, unreadable, empty, cut off, damaged, not a
            picture, smaller than MIN_SIDE or larger than MAX_PIXELS, or of a sample type that is not 8 or 16 bits;
            (dark) see to_grey8.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise _bad(f"picture {path} is a directory", "name the picture files in it")
        if path.exists() and not path.is_file():  # a pipe may never answer, a device may never end
            raise _bad(f"picture {path} is a pipe or a device and no file", "write the picture into a file first")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise _bad(f"picture {path} has {path.stat().st_size} bytes, more than {MAX_FILE_BYTES}", _KINDS_REMEDY)
        data = path.read_bytes()
    except FileNotFoundError:
        raise _bad(f"picture {path} does not exist", "check the path") from None
    except OSError as error:
        raise _bad(f"picture {path} cannot be read: {error.strerror}", "check its permissions and the disk") from None
    return decode_grey(data, f"picture {path}")


def decode_grey(data: bytes, source: str) -> GreyImage:
    """The same for a picture in memory; ``source`` names it in errors."""
    try:
        header = read_header(data)
    except DamagedError as error:
        raise _bad(f"{source} {error}", _KINDS_REMEDY if str(error).startswith("is not") else _REMEDY) from None
    _check_size(header, source)
    pixels, said = _decode(data, source)
    complaint = _complaint(said, header.padding)
    if complaint:
        raise _bad(f"{source} is damaged: {complaint}", _REMEDY)
    if pixels is None:
        raise _bad(f"{source} is damaged or of a kind of {header.kind} that cannot be decoded", _REMEDY)
    if pixels.shape[:2] != (header.height, header.width):
        raise _bad(
            f"{source} is damaged: its header says {header.width}x{header.height} px, its data another size", _REMEDY
        )
    return to_grey8(pixels, source, header.full_scale)


def to_grey8(array: NDArray[Any], source: str, full_scale: int | None = None) -> GreyImage:
    """8-bit grey of grey (h, w), BGR (h, w, 3) or BGRA (h, w, 4; alpha ignored) samples of 8 or 16 bits.

    16-bit samples are scaled by a *constant*, ``255 / full_scale`` (default 65535, rounded to nearest), never by the
    frame's own maximum: a bird or a lamp must not change the contrast of every other pixel. 10- and 12-bit samples in
    16-bit files without a stated maximum therefore would come out black; they are refused with that explanation. A PGM
    states its maximum, and it is used.

    Raises:
        FrameError: (bad-frame) another shape or sample type; (dark) 16-bit samples that never reach 1/16 of full scale.
    """
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    channels = 1 if array.ndim == 2 else array.shape[2] if array.ndim == 3 else 0
    if channels not in {1, 3, 4} or array.size == 0:
        raise _bad(f"{source} has the shape {array.shape}; grey, BGR or BGRA is read", _KINDS_REMEDY)
    if array.dtype not in (np.uint8, np.uint16):
        raise _bad(f"{source} has samples of type {array.dtype}; 8- and 16-bit whole numbers are read", _KINDS_REMEDY)
    if channels > 1:
        array = cv2.cvtColor(array, cv2.COLOR_BGR2GRAY if channels == 3 else cv2.COLOR_BGRA2GRAY)
    if array.dtype == np.uint16:
        white = full_scale or 65535
        brightest = int(array.max())
        if full_scale is None and brightest < _RIGHT_ALIGNED:
            raise FrameError(
                f"{source}: its brightest 16-bit sample is {brightest} of 65535, so it is dark or holds 10- or 12-bit"
                " samples without scaling",
                "store samples scaled to 16 bits, or as PGM with their maximum",
                Cause.DARK,
            )
        array = cv2.convertScaleAbs(array, alpha=255.0 / white)
    elif full_scale not in (None, 255):
        array = cv2.convertScaleAbs(array, alpha=255.0 / full_scale)
    return np.ascontiguousarray(array, dtype=np.uint8)


def _bad(what: str, remedy: str) -> FrameError:
    return FrameError(what, remedy, Cause.BAD_FRAME)


def _check_size(header: Header, source: str) -> None:
    if header.width * header.height > MAX_PIXELS:
        raise _bad(
            f"{source} claims {header.width}x{header.height} px; at most {MAX_PIXELS // 1_000_000} megapixels are read",
            "use the camera's own size",
        )
    decoded = header.width * header.height * header.pixel_bytes
    if decoded > MAX_DECODED_BYTES:
        raise _bad(f"{source} would take {decoded} bytes, more than {MAX_DECODED_BYTES}", "store it as 8-bit grey")
    if min(header.width, header.height) < MIN_SIDE:
        raise _bad(f"{source} is {header.width}x{header.height} px; at least {MIN_SIDE} a side are needed", _REMEDY)


def _complaint(said: list[str], padding: int) -> str | None:
    """What the decoders said that means picture data were lost.

    libjpeg says only the first thing that it finds. Bytes that are left over at the picture's end can be known for
    padding; anywhere else, or of another value, they show that one wrong bit has shifted what follows.
    """
    for line in said:
        if line.startswith(_COMPLAINTS):
            stray = _STRAY_BYTES.match(line)
            if stray is None or padding not in _PADDING or int(stray[1]) > padding:
                return line
        of_tiff = _TIFF_COMPLAINT.search(line)
        if of_tiff is not None:
            return of_tiff[0]
    return None


def _decode(data: bytes, source: str) -> tuple[NDArray[Any] | None, list[str]]:
    """Decode, and keep what the decoders write to file descriptor 2, their only way to tell of lost data.

    What another thread writes to standard error in these milliseconds is handed on afterwards.

    Raises:
        FrameError: what they say could not be kept, so that nobody would know of damage.
    """
    buffer = np.frombuffer(data, np.uint8)
    with _stderr_lock:
        try:
            with _Overheard() as heard:
                pixels = _imdecode(buffer)
        except OSError as error:
            what = f"{source} could not be looked at for damage: {error.strerror or error}"
            raise _bad(
                what, "restart the program; if it happens again, look for what uses up memory or files"
            ) from None
    said = heard.said
    others = [line for line in said if line and not line.startswith(_NOT_TO_HAND_ON)]
    if others:
        with contextlib.suppress(OSError):
            os.write(2, "\n".join([*others, ""]).encode())
    return pixels, said


class _Overheard:
    """Standard error in a file of memory's: no disk can be full, and no directory missing.

    Raises:
        OSError: it could not be kept whole, from the first line to the last.
    """

    _FIRST, _LAST = b"-- from here\n", b"\n-- to here\n"

    def __init__(self) -> None:
        self.said: list[str] = []

    def __enter__(self) -> Self:
        self._sink = _above_standard(os.memfd_create("decoder-says"))
        self._kept: int | None = None
        try:
            try:
                self._kept = fcntl.fcntl(2, fcntl.F_DUPFD_CLOEXEC, 3)
            except OSError as error:
                if error.errno != errno.EBADF:
                    raise
            os.dup2(self._sink, 2)
        except OSError:
            os.close(self._sink)
            raise
        with contextlib.suppress(OSError):  # the end shows that it is missing
            os.write(2, self._FIRST)
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            os.write(2, self._LAST)
        if self._kept is None:
            os.close(2)
        else:
            os.dup2(self._kept, 2)
            os.close(self._kept)
        with os.fdopen(self._sink, "rb") as sink:
            sink.seek(0)
            heard = sink.read()
        if not (heard.startswith(self._FIRST) and heard.endswith(self._LAST)):
            raise OSError(errno.EIO, "what the decoder said was lost")
        self.said = heard[len(self._FIRST) : -len(self._LAST)].decode("utf-8", "replace").splitlines()


def _above_standard(descriptor: int) -> int:
    """The same file under a number that no standard stream has, for those may be closed."""
    if descriptor > 2:
        return descriptor
    try:
        return fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(descriptor)


def _imdecode(buffer: NDArray[np.uint8]) -> NDArray[Any] | None:
    """Decode with OpenCV speaking as loud as it takes to hear libtiff, which OPENCV_LOG_LEVEL may have hushed.

    OpenCV 4.11, Bookworm's, keeps the log's level elsewhere, and says to nobody but those who debug what libtiff finds.
    """
    log: Any = getattr(cv2.utils, "logging", None)
    log, audible = (cv2, 5) if log is None else (log, log.LOG_LEVEL_WARNING)
    level = log.getLogLevel()
    log.setLogLevel(max(level, audible))
    try:
        return cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    finally:
        log.setLogLevel(level)


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write a grey or BGR picture (height, width[, 3]) as PNG, making its directory where needed.

    Raises:
        SagnodeError: it cannot be written.
    """
    _, encoded = cv2.imencode(".png", picture)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as stream:
            stream.write(encoded.tobytes())
    except OSError as error:
        raise SagnodeError(f"cannot write {path}: {error.strerror}", "choose another place") from None
