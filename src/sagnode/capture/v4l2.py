"""A V4L2 device through OpenCV, with every wait bounded and nothing about the frames assumed.

OpenCV is asked for the driver's own bytes (CONVERT_RGB off) and they are turned into grey here: so a half transferred
JPEG is noticed, and luma is not converted to colour and back. What OpenCV does not tell, the padding of rows, is asked
of the driver itself.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import stat
import struct
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

from sagnode.capture.bounded import BoundedCalls
from sagnode.capture.checks import check_frame
from sagnode.capture.pixels import Buffer, grey_of_buffer, known_format, row_bytes
from sagnode.capture.port import Frame, FrameSource, GreyImage
from sagnode.config.node import V4l2Source
from sagnode.errors import FrameError
from sagnode.quality import Cause

Result = TypeVar("Result")

_BUFFERS = 4
_CLOSE_S = 3.0
_MANUAL_EXPOSURE = 1.0  # V4L2_EXPOSURE_MANUAL
_CABLE = "check the camera's cable and power; the next reading opens it anew"

# struct v4l2_format: u32 type, then a union that is aligned as its pointers are; 200 bytes of it (linux/videodev2.h).
_UNION_AT = struct.calcsize("P")
_FORMAT_BYTES = _UNION_AT + 200
_VIDIOC_G_FMT = (3 << 30) | (_FORMAT_BYTES << 16) | (ord("V") << 8) | 4
_VIDEO_CAPTURE = 1


class _Negotiated(NamedTuple):
    """What the driver settled on."""

    width: int
    height: int
    pixel_format: str
    stride: int


class V4l2(FrameSource):
    """One V4L2 capture device. A fault closes it; :meth:`open` opens it anew."""

    def __init__(self, config: V4l2Source) -> None:
        self._config = config
        self._calls: BoundedCalls | None = None
        self._capture: cv2.VideoCapture | None = None
        self._negotiated: _Negotiated | None = None
        self._controls: dict[str, float] = {}
        self._monotonic_stamps = False
        self._previous: GreyImage | None = None

    def open(self) -> None:
        """Open, negotiate, set the controls, and let automatic exposure settle over the warm-up frames.

        Raises:
            FrameError: no such device, no right to it, busy, another size or format than configured, a control that it
                does not take, or no frame in time.
        """
        self.close()
        config = self._config
        _check_device(config.device)
        self._calls = BoundedCalls(f"v4l2 {config.device}")
        try:
            self._capture = self._call(self._open_capture, 2 * config.timeout_s)
            self._negotiated = self._call(self._negotiate, config.timeout_s)
            self._controls = self._call(self._set_controls, config.timeout_s)
            for _ in range(max(1, config.warmup_frames)):
                self._grab(time.monotonic() + config.timeout_s)
            stamp = self._call(self._stamp, config.timeout_s)
            self._monotonic_stamps = abs(time.monotonic() - stamp) < config.timeout_s
        except FrameError:
            self.close()
            raise

    def burst(self, count: int, interval_s: float) -> list[Frame]:
        """Take frames that were exposed after they were asked for, at least ``interval_s`` apart.

        Raises:
            FrameError: (camera-fault) no frame within timeout_s; (bad-frame, dark, stale-frame) see check_frame.
        """
        frames: list[Frame] = []
        for i in range(count):
            if i:
                time.sleep(max(0.0, frames[-1].monotonic_s + interval_s - time.monotonic()))
            frames.append(self._take())
        return frames

    def close(self) -> None:
        """Release the device; a driver that hangs is left to its thread."""
        capture, calls = self._capture, self._calls
        self._capture = self._calls = self._previous = None
        if calls is None:
            return
        if capture is not None:
            with contextlib.suppress(TimeoutError, cv2.error):  # then its thread releases it when the driver lets go
                calls.call(capture.release, _CLOSE_S)
        calls.end()

    def describe(self) -> str:
        """Back end, device and negotiated format."""
        if self._negotiated is None or self._capture is None:
            return f"v4l2 {self._config.device}, closed"
        n = self._negotiated
        return f"v4l2 {self._config.device} {n.width}x{n.height} {n.pixel_format}"

    def _take(self) -> Frame:
        config, negotiated = self._config, self._negotiated
        if self._capture is None or negotiated is None:
            raise FrameError(f"camera {config.device} is closed", "open it first")
        deadline = time.monotonic() + config.timeout_s
        try:
            stamp = self._grab_fresh(deadline)
            data = self._call(self._retrieve, max(0.1, deadline - time.monotonic()))
        except FrameError:
            self.close()
            raise
        source = f"camera {config.device}"
        image = grey_of_buffer(
            data, negotiated.pixel_format, negotiated.width, negotiated.height, negotiated.stride, source
        )
        previous, self._previous = self._previous, image
        check_frame(image, previous, source)
        utc = datetime.now(UTC) - timedelta(seconds=time.monotonic() - stamp)
        metadata = {"pixel_format": negotiated.pixel_format, **self._controls}
        return Frame(image, utc, stamp, source, metadata)

    def _grab_fresh(self, deadline: float) -> float:
        """Grab until a frame is newer than this moment: the driver's queue holds frames of the last burst."""
        asked = time.monotonic()
        if not self._monotonic_stamps:
            for _ in range(_BUFFERS):
                self._grab(deadline)
            self._grab(deadline)
            return time.monotonic()
        while True:
            self._grab(deadline)
            stamp = self._call(self._stamp, max(0.1, deadline - time.monotonic()))
            if stamp >= asked:
                return stamp

    def _grab(self, deadline: float) -> None:
        assert self._capture is not None  # noqa: S101 - for the type checker; _take and open see to it
        left = deadline - time.monotonic()
        if left <= 0 or not self._call(self._capture.grab, left):
            raise FrameError(f"camera {self._config.device} gives no frame within {self._config.timeout_s:g} s", _CABLE)

    def _call(self, function: Callable[[], Result], timeout_s: float) -> Result:
        """One call into OpenCV, bounded; its errors as FrameError."""
        device = self._config.device
        if self._calls is None:
            raise FrameError(f"camera {device} is closed", "open it first")
        try:
            return self._calls.call(function, timeout_s)
        except TimeoutError:
            raise FrameError(f"camera {device} does not answer within {timeout_s:.3g} s", _CABLE) from None
        except (cv2.error, OSError) as error:
            raise FrameError(f"camera {device}: {str(error).strip()}", _CABLE) from None

    # What follows runs in the camera's own thread.

    def _open_capture(self) -> cv2.VideoCapture:
        config = self._config
        # Read by OpenCV when it opens: without it a silent camera holds the thread for ten seconds.
        os.environ["OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"] = str(max(1, math.ceil(config.timeout_s)))
        capture = cv2.VideoCapture(config.device, cv2.CAP_V4L2)
        if not capture.isOpened():
            raise FrameError(
                f"camera {config.device} cannot be opened: busy, or no capture device",
                f"see who has it: fuser -v {config.device}; see what it is: v4l2-ctl -d {config.device} --all",
            )
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*config.pixel_format))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, config.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, config.height)
        if config.fps is not None:
            capture.set(cv2.CAP_PROP_FPS, config.fps)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, _BUFFERS)
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        return capture

    def _negotiate(self) -> _Negotiated:
        config = self._config
        got = _driver_format(config.device)
        listing = f"v4l2-ctl -d {config.device} --list-formats-ext shows what it can"
        if (got.width, got.height) != (config.width, config.height):
            raise FrameError(
                f"camera {config.device} gives {got.width}x{got.height} px, not {config.width}x{config.height}", listing
            )
        if got.pixel_format.strip() != config.pixel_format.strip():
            raise FrameError(f"camera {config.device} gives {got.pixel_format}, not {config.pixel_format}", listing)
        if not known_format(got.pixel_format):
            raise FrameError(f"camera {config.device}: pixel format {got.pixel_format} is not known here", listing)
        wanted = row_bytes(got.pixel_format, got.width)
        if wanted and got.stride not in (0, wanted):
            raise FrameError(
                f"camera {config.device} pads its rows to {got.stride} bytes, which OpenCV does not follow",
                f"choose a width that fills its rows; {listing}",
            )
        return got._replace(stride=wanted)

    def _set_controls(self) -> dict[str, float]:
        config = self._config
        wanted = [("gain", cv2.CAP_PROP_GAIN, config.gain)]
        if config.exposure is not None:
            self._set("auto_exposure", cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
            wanted.append(("exposure", cv2.CAP_PROP_EXPOSURE, config.exposure))
        return {name: self._set(name, control, value) for name, control, value in wanted if value is not None}

    def _set(self, name: str, control: int, value: float) -> float:
        """Set a control and read it back; drivers clamp without a word."""
        assert self._capture is not None  # noqa: S101 - open sets it first
        taken = self._capture.set(control, value)
        got = self._capture.get(control)
        if not taken or abs(got - round(value)) > max(1.0, 0.02 * abs(value)):
            raise FrameError(
                f"camera {self._config.device} does not take {name} = {value:g}"
                + (f", it has {got:g}" if taken else ""),
                f"v4l2-ctl -d {self._config.device} --list-ctrls shows its range; or unset camera.v4l2.{name}",
            )
        return float(got)

    def _stamp(self) -> float:
        """The driver's time of the last grabbed frame, s; of the monotonic clock in all but old drivers."""
        assert self._capture is not None  # noqa: S101 - open sets it first
        return float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0

    def _retrieve(self) -> Buffer:
        assert self._capture is not None  # noqa: S101 - open sets it first
        ok, pixels = self._capture.retrieve()
        if not ok or pixels is None or pixels.size == 0:
            raise FrameError(f"camera {self._config.device} gave an empty frame", _CABLE, Cause.BAD_FRAME)
        return np.ascontiguousarray(pixels).reshape(-1).view(np.uint8)


def _check_device(device: str) -> None:
    try:
        mode = os.stat(device).st_mode  # noqa: PTH116 - the name is a device node, not a file of ours
    except OSError:
        known = ", ".join(sorted(str(p) for p in Path("/dev").glob("video*"))) or "none"
        raise FrameError(
            f"camera {device} does not exist (there are: {known})", "check cable and driver; v4l2-ctl --list-devices"
        ) from None
    if not stat.S_ISCHR(mode):
        raise FrameError(f"camera {device} is not a device", "check camera.v4l2.device; replay shows files")
    if not os.access(device, os.R_OK | os.W_OK):
        raise FrameError(f"camera {device} may not be opened", "add the user to its group: usermod -aG video USER")


def _driver_format(device: str) -> _Negotiated:
    """The driver's own word on size, pixel format and bytes from row to row (VIDIOC_G_FMT)."""
    request = bytearray(_FORMAT_BYTES)
    struct.pack_into("I", request, 0, _VIDEO_CAPTURE)
    handle = os.open(device, os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(handle, _VIDIOC_G_FMT, request)
    finally:
        os.close(handle)
    width, height, code, _field, stride = struct.unpack_from("5I", request, _UNION_AT)
    return _Negotiated(width, height, code.to_bytes(4, "little").decode("ascii", "replace"), stride)
