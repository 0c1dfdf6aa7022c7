"""A Raspberry Pi camera through Picamera2, configured once, its exposure locked for each burst.

The stream's format is read after configuration and never assumed: libcamera adjusts what it cannot give. Every call is
bounded; after a frame that does not come the pending job is cancelled before the camera is stopped, since ``stop``
would wait behind it for ever.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

import numpy as np

from sagnode.capture.bounded import BoundedCalls
from sagnode.capture.checks import check_frame
from sagnode.capture.pixels import grey_of_buffer, known_format
from sagnode.capture.port import Frame, FrameSource, GreyImage
from sagnode.config.node import Picamera2Source
from sagnode.errors import FrameError

Result = TypeVar("Result")

_BUFFERS = 2  # one exposing while one is read; more only cost memory that the Pi's CMA area may not have
_MARGIN_S = 2.0
_CLOSE_S = 5.0
_SETTLE_FRAMES = 10  # controls take effect a few frames after they are set
_CABLE = "check the ribbon cable and power; the next reading opens it anew; if it goes on, restart the node"
_MISSING = "apt install python3-picamera2, and make the environment with: python3 -m venv --system-site-packages"
_DRIVER_FAULTS = (RuntimeError, OSError, IndexError, KeyError, ValueError, TypeError, AttributeError)


class Picamera(FrameSource):
    """One camera of libcamera. A fault closes it; :meth:`open` opens it anew."""

    def __init__(self, config: Picamera2Source) -> None:
        self._config = config
        self._calls: BoundedCalls | None = None
        self._camera: Any = None
        self._stream: Mapping[str, Any] = {}
        self._previous: GreyImage | None = None

    @property
    def _name(self) -> str:
        return f"camera picamera2:{self._config.camera}"

    def open(self) -> None:
        """Configure a still stream, start, and let exposure, gain, white balance and focus settle over the warm-up.

        Raises:
            FrameError: Picamera2 is not installed, no such camera, busy, another size or an unknown format, a control
                or crop that this camera does not have, or no frame in time.
        """
        self.close()
        picamera2 = _import_picamera2()
        self._calls = BoundedCalls(self._name)
        timeout_s = self._config.timeout_s
        try:
            self._camera = self._call(lambda: picamera2(self._config.camera), timeout_s)
            self._stream = self._call(self._configure, timeout_s)
            self._call(self._camera.start, timeout_s)
            metadata: dict[str, Any] = {}
            for _ in range(max(1, self._config.warmup_frames)):
                metadata = self._request(time.monotonic() + timeout_s, lambda request: dict(request.get_metadata()))
            self._check_crop(metadata.get("ScalerCrop"))
        except FrameError:
            self.close()
            raise

    def burst(self, count: int, interval_s: float) -> list[Frame]:
        """Take frames that were exposed after they were asked for, with one exposure, at least ``interval_s`` apart.

        Raises:
            FrameError: (camera-fault) no frame within timeout_s; (bad-frame, dark, stale-frame) see check_frame.
        """
        if self._camera is None:
            raise FrameError(f"{self._name} is closed", "open it first")
        frames: list[Frame] = []
        try:
            unlocked = self._lock()
            for i in range(count):
                if i:
                    time.sleep(max(0.0, frames[-1].monotonic_s + interval_s - time.monotonic()))
                frames.append(self._take())
            if unlocked:
                self._call(lambda: self._camera.set_controls(unlocked), _MARGIN_S)
        except FrameError:
            self.close()
            raise
        for frame in frames:
            previous, self._previous = self._previous, frame.image
            check_frame(frame.image, previous, self._name)
        return frames

    def close(self) -> None:
        """Cancel what is pending, stop and close; a driver that hangs is left to its thread."""
        camera, calls = self._camera, self._calls
        self._camera = self._calls = self._previous = None
        if calls is None:
            return
        if camera is not None:
            for step in (camera.cancel_all_and_flush, camera.stop, camera.close):
                try:
                    calls.call(step, _CLOSE_S)
                except (TimeoutError, *_DRIVER_FAULTS):
                    continue  # a camera in this state is beyond mending from here; the others may still succeed
        calls.end()

    def describe(self) -> str:
        """Back end, camera, negotiated size and format."""
        if self._camera is None:
            return f"picamera2 {self._config.camera}, closed"
        width, height = self._stream["size"]
        return f"picamera2 {self._config.camera} {self._config.stream} {width}x{height} {self._stream['format']}"

    def _configure(self) -> Mapping[str, Any]:
        config, camera = self._config, self._camera
        size = (config.width, config.height)
        wants_raw = config.stream == "raw"
        # Uncompressed: the Pi 5 would otherwise compress raw frames in a format of its own.
        raw = {"size": size, "format": _uncompressed(str(camera.sensor_format))} if wants_raw else None
        still = camera.create_still_configuration(
            main={"size": size, "format": "YUV420"},
            raw=raw,
            buffer_count=_BUFFERS,
            queue=False,
            display=None,
            encode=None,
            controls=self._first_controls(camera.camera_controls),
        )
        camera.configure(still)
        stream = camera.camera_configuration()[config.stream]
        if stream is None:
            raise FrameError(f"{self._name} has no {config.stream} stream", 'set camera.picamera2.stream = "main"')
        if tuple(stream["size"]) != size:
            width, height = stream["size"]
            raise FrameError(
                f"{self._name} gives {width}x{height} px, not {size[0]}x{size[1]}",
                "rpicam-hello --list-cameras shows its sizes; the intrinsics must belong to the same size",
            )
        if not known_format(str(stream["format"])):
            remedy = 'set camera.picamera2.stream = "main"' if wants_raw else "report this format"
            raise FrameError(f"{self._name}: pixel format {stream['format']} is not known here", remedy)
        return dict(stream)

    def _first_controls(self, available: Mapping[str, object]) -> dict[str, object]:
        """What is fixed from the start; raises where the configuration wants what this camera does not have."""
        config = self._config
        keys = {
            "ExposureTime": "exposure_us",
            "AnalogueGain": "gain",
            "LensPosition": "lens_position",
            "ScalerCrop": "crop",
        }
        asked = {control: getattr(config, key) for control, key in keys.items()}
        controls: dict[str, object] = {}
        for control, value in asked.items():
            if value is None:
                continue
            if control not in available:
                key = f"camera.picamera2.{keys[control]}"
                raise FrameError(f"{self._name} has no control {control}", f"take {key} out of the configuration")
            controls[control] = value
        if config.exposure_us is not None and config.gain is not None and "AeEnable" in available:
            controls["AeEnable"] = False
        if config.lens_position is not None and "AfMode" in available:
            controls["AfMode"] = 0  # manual
        return controls

    def _check_crop(self, got: object) -> None:
        """Refuse a crop that libcamera has moved, as it does without a word: the intrinsics hold for one only."""
        wanted = self._config.crop
        if wanted is None or got == wanted:
            return
        if not isinstance(got, tuple):
            raise FrameError(f"{self._name} does not tell its crop", "take camera.picamera2.crop out")
        what = f"{self._name} shows {list(got)} of the sensor, not {list(wanted)}"
        raise FrameError(what, f"set camera.picamera2.crop = {list(got)} and calibrate with it, or choose another size")

    def _lock(self) -> dict[str, object]:
        """Hold exposure, gain, colour gains and focus where they have settled; returns what sets them free again.

        Day and night need different exposures, so they are free between bursts unless the configuration fixes them.
        """
        available = self._camera.camera_controls
        config = self._config
        now = self._request(time.monotonic() + config.timeout_s, lambda request: dict(request.get_metadata()))
        locked: dict[str, object] = {}
        free: dict[str, object] = {}
        if config.exposure_us is None or config.gain is None:
            for control, fixed in (("ExposureTime", config.exposure_us), ("AnalogueGain", config.gain)):
                if fixed is None and control in available and control in now:
                    locked[control] = now[control]
                    free[control] = 0  # libcamera's word for automatic
            if locked and "AeEnable" in available:
                locked["AeEnable"], free["AeEnable"] = False, True
        if "AwbEnable" in available and "ColourGains" in now:
            locked["AwbEnable"], locked["ColourGains"], free["AwbEnable"] = False, now["ColourGains"], True
        if config.lens_position is None and "LensPosition" in available and "LensPosition" in now:
            # Not set free again: intrinsics hold for one focus only.
            locked["AfMode"], locked["LensPosition"] = 0, now["LensPosition"]
        if locked:
            self._call(lambda: self._camera.set_controls(locked), _MARGIN_S)
            self._wait_for_exposure(locked)
        return free

    def _wait_for_exposure(self, locked: Mapping[str, object]) -> None:
        wanted = locked.get("ExposureTime")
        if not isinstance(wanted, int | float):
            return
        deadline = time.monotonic() + self._config.timeout_s
        for _ in range(_SETTLE_FRAMES):
            got = self._request(deadline, lambda request: request.get_metadata().get("ExposureTime"))
            # Sensors count exposure in lines: a line of a slow mode is some 30 us.
            if isinstance(got, int | float) and abs(got - wanted) <= max(50.0, 0.02 * wanted):
                return

    def _take(self) -> Frame:
        """A frame whose exposure began after now."""
        asked = time.monotonic()
        deadline = asked + self._config.timeout_s
        while True:
            data, metadata = self._request(deadline, self._read_out)
            stamp = monotonic_of_sensor(metadata.get("SensorTimestamp"))
            if stamp is None or stamp >= asked:
                break
        width, height = self._stream["size"]
        pixel_format = str(self._stream["format"])
        stride = int(self._stream["stride"])
        image = grey_of_buffer(data, pixel_format, width, height, stride, self._name)
        taken = time.monotonic() if stamp is None else stamp
        utc = datetime.now(UTC) - timedelta(seconds=time.monotonic() - taken)
        return Frame(image, utc, taken, self._name, {"pixel_format": pixel_format, **plain_metadata(metadata)})

    def _read_out(self, request: Any) -> tuple[np.ndarray, dict[str, Any]]:
        return np.asarray(request.make_buffer(self._config.stream), dtype=np.uint8), dict(request.get_metadata())

    def _request(self, deadline: float, use: Callable[[Any], Result]) -> Result:
        """The next completed request, given back to the camera after its use."""

        def capture() -> Result:
            # The wait is Picamera2's own: a job that it has given up can be cancelled, one that we give up cannot.
            request = self._camera.capture_request(wait=max(0.1, deadline - time.monotonic()))
            try:
                return use(request)
            finally:
                request.release()

        return self._call(capture, max(0.1, deadline - time.monotonic()) + _MARGIN_S)

    def _call(self, function: Callable[[], Result], timeout_s: float) -> Result:
        """One call into Picamera2, bounded; its errors as FrameError."""
        if self._calls is None:
            raise FrameError(f"{self._name} is closed", "open it first")
        try:
            return self._calls.call(function, timeout_s)
        except TimeoutError:
            what = f"{self._name} gives no frame or answer in time (timeout_s = {self._config.timeout_s:g})"
            raise FrameError(what, _CABLE) from None
        except _DRIVER_FAULTS as error:
            said = str(error).strip() or type(error).__name__
            cause = f" ({error.__cause__})" if error.__cause__ else ""
            remedy = "rpicam-hello --list-cameras shows what is connected; no other program may have the camera"
            raise FrameError(f"{self._name}: {said}{cause}", remedy) from None


def _import_picamera2() -> Any:
    try:
        from picamera2 import Picamera2
    except ImportError as error:
        raise FrameError(f"camera: Picamera2 cannot be imported ({error})", _MISSING) from None
    except ValueError as error:  # a module compiled against another NumPy
        remedy = "install numpy and OpenCV by deploy/constraints-bookworm.txt or -trixie.txt"
        raise FrameError(f"camera: Picamera2 cannot be imported ({error})", remedy) from None
    return Picamera2


def monotonic_of_sensor(stamp_ns: object) -> float | None:
    """A SensorTimestamp (ns) on Python's monotonic clock, s; None where it belongs to no clock of this machine.

    libcamera defines it on CLOCK_BOOTTIME, drivers fill it from CLOCK_MONOTONIC; they differ by the time asleep.
    """
    if not isinstance(stamp_ns, int) or stamp_ns <= 0:
        return None
    for clock in (time.CLOCK_MONOTONIC, time.CLOCK_BOOTTIME):
        age_s = (time.clock_gettime_ns(clock) - stamp_ns) / 1e9
        if -0.5 <= age_s <= 600.0:
            return time.monotonic() - age_s
    return None


def plain_metadata(metadata: Mapping[str, object]) -> dict[str, object]:
    """The metadata that JSON can hold: numbers, text, and lists of numbers."""
    plain: dict[str, object] = {}
    for key, value in metadata.items():
        if isinstance(value, bool | int | float | str):
            plain[key] = value
        elif isinstance(value, tuple | list) and all(isinstance(x, bool | int | float | str) for x in value):
            plain[key] = list(value)
    return plain


def _uncompressed(sensor_format: str) -> str:
    """The unpacked form of a sensor's raw format: ``SRGGB10_CSI2P`` becomes ``SRGGB10``."""
    return sensor_format.removesuffix("_CSI2P")
