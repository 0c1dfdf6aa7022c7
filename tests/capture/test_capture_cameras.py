"""Camera back ends as far as they can be exercised without a camera.

No capture device and no libcamera exist on a build machine. The V4L2 tests meet real files and device nodes that are no
cameras. For Picamera2 a stand-in takes the place of its class here, since no part of the real one can run without
libcamera; ``tests/platform/picamera2_virtual.py`` runs the same back end on the real class where libcamera is.
"""

from __future__ import annotations

import sys
import threading
import time
import types
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sagnode.capture import open_source
from sagnode.capture.bounded import BoundedCalls
from sagnode.capture.picamera2 import Picamera, monotonic_of_sensor, plain_metadata
from sagnode.capture.v4l2 import V4l2
from sagnode.config.node import Camera, Picamera2Source, V4l2Source
from sagnode.errors import FrameError
from sagnode.quality import Cause


def test_a_call_that_hangs_is_given_up_in_time() -> None:
    calls, release = BoundedCalls("test"), threading.Event()
    assert calls.call(lambda: 7, 1.0) == 7
    with pytest.raises(ZeroDivisionError):
        calls.call(lambda: 1 // 0, 1.0)
    with pytest.raises(TimeoutError):
        calls.call(release.wait, 0.05)
    release.set()
    assert calls.call(lambda: 8, 1.0) == 8
    calls.end()


@pytest.mark.parametrize(
    ("device", "says"),
    [("/dev/video97", "does not exist"), ("{tmp}/file", "is not a device"), ("/dev/null", "cannot be opened")],
)
def test_what_is_no_v4l2_camera_is_named_with_a_remedy(device: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x")
    device = device.format(tmp=tmp_path)
    source = V4l2(V4l2Source(device=device, timeout_s=2.0))
    with pytest.raises(FrameError, match=says) as caught:
        source.open()
    assert device in str(caught.value) and caught.value.remedy
    assert caught.value.cause is Cause.CAMERA_FAULT
    source.close()
    source.close()
    with pytest.raises(FrameError, match="closed"):
        source.burst(1, 0.0)
    assert source.describe().endswith("closed")


def test_without_picamera2_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "picamera2", None)
    source = open_source(Camera.model_validate({"backend": "picamera2"}))
    with pytest.raises(FrameError, match="cannot be imported") as caught:
        source.open()
    assert "apt install python3-picamera2" in caught.value.remedy
    assert "--system-site-packages" in caught.value.remedy


W, H, STRIDE = 64, 48, 80


class StandIn:
    """What the back end uses of Picamera2, with a format that was adjusted and frames that are already old."""

    sensor_format = "SRGGB10_CSI2P"
    last: StandIn

    def __init__(self, number: int) -> None:
        if number > 0:
            raise RuntimeError("No camera number found")
        self.said: list[str] = []
        self.asked: list[dict[str, object]] = []
        self.camera_controls = {"ExposureTime": (1, 100000, 0), "AnalogueGain": (1, 16, 1), "AeEnable": (0, 1, 1)}
        self.controls: dict[str, object] = {"ExposureTime": 12000, "AnalogueGain": 2.0}
        self.stalled = False
        self.late = 0
        self._frames = 0
        StandIn.last = self

    def create_still_configuration(self, **config: object) -> dict[str, object]:
        return config

    def configure(self, config: dict[str, object]) -> None:
        self.config = config

    def camera_configuration(self) -> dict[str, object]:
        return {"main": {"format": "NV12", "size": (W, H), "stride": STRIDE}, "raw": None}

    def start(self) -> None:
        self.said.append("start")

    def set_controls(self, controls: dict[str, object]) -> None:
        self.said.append(f"controls {sorted(controls)}")
        self.asked.append(controls)
        self.controls.update({key: value for key, value in controls.items() if value})

    def capture_request(self, wait: float) -> StandInRequest:
        if self.stalled:
            time.sleep(min(wait, 0.2))
            raise TimeoutError
        time.sleep(0.005)
        self._frames += 1
        self.late -= 1
        stamp = time.monotonic_ns() - (2_000_000_000 if self.late >= 0 else 0)
        return StandInRequest(self._frames, {**self.controls, "SensorTimestamp": stamp, "ColourGains": (1.5, 2.0)})

    def cancel_all_and_flush(self) -> None:
        self.said.append("cancel")

    def stop(self) -> None:
        self.said.append("stop")

    def close(self) -> None:
        self.said.append("close")


class StandInRequest:
    open_requests = 0

    def __init__(self, number: int, metadata: dict[str, object]) -> None:
        StandInRequest.open_requests += 1
        self._number, self._metadata = number, metadata

    def make_buffer(self, stream: str) -> np.ndarray:
        assert stream == "main"
        rows = np.random.default_rng(self._number).integers(0, 256, (H * 3 // 2, STRIDE), np.uint8)
        rows[0, 0] = self._number
        return rows.reshape(-1)

    def get_metadata(self) -> dict[str, object]:
        return self._metadata

    def release(self) -> None:
        StandInRequest.open_requests -= 1


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> type[StandIn]:
    module = types.ModuleType("picamera2")
    module.Picamera2 = StandIn  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "picamera2", module)
    StandInRequest.open_requests = 0
    return StandIn


def picamera(**config: object) -> Picamera:
    return Picamera(Picamera2Source.model_validate({"width": W, "height": H, "timeout_s": 1.0, **config}))


def test_the_negotiated_format_is_read_and_the_exposure_locked(stand_in: type[StandIn]) -> None:
    source = picamera(warmup_frames=3)
    source.open()
    assert source.describe() == "picamera2 0 main 64x48 NV12"
    stand_in.last.late = 3  # one for the lock, two that were exposed before they were asked for
    frames = source.burst(3, 0.0)
    assert [int(b.image[0, 0]) - int(a.image[0, 0]) for a, b in pairwise(frames)] == [1, 1]
    assert frames[0].image.shape == (H, W)
    assert frames[0].metadata["ExposureTime"] == 12000
    assert frames[0].metadata["ColourGains"] == [1.5, 2.0]
    assert abs(frames[-1].monotonic_s - time.monotonic()) < 1.0
    assert stand_in.last.said == [
        "start",
        "controls ['AeEnable', 'AnalogueGain', 'ExposureTime']",
        "controls ['AeEnable', 'AnalogueGain', 'ExposureTime']",
    ]
    assert StandInRequest.open_requests == 0
    source.close()


def test_white_balance_and_focus_are_held_where_they_have_settled(
    stand_in: type[StandIn], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = stand_in.__init__

    def with_lens(self: StandIn, number: int) -> None:
        real(self, number)
        self.camera_controls |= {"AwbEnable": (0, 1, 1), "AfMode": (0, 2, 0), "LensPosition": (0, 15, 1)}
        self.controls["LensPosition"] = 0.3

    monkeypatch.setattr(stand_in, "__init__", with_lens)
    source = picamera()
    source.open()
    source.burst(2, 0.0)
    held, freed = stand_in.last.asked
    assert held == {
        "AeEnable": False, "ExposureTime": 12000, "AnalogueGain": 2.0,
        "AwbEnable": False, "ColourGains": (1.5, 2.0), "AfMode": 0, "LensPosition": 0.3,
    }  # fmt: skip
    # Day and night differ in light; the intrinsics hold for one focus.
    assert freed == {"AeEnable": True, "ExposureTime": 0, "AnalogueGain": 0, "AwbEnable": True}
    source.close()

    fixed = picamera(exposure_us=8000, gain=1.5, lens_position=0.25)
    fixed.open()
    assert stand_in.last.config["controls"] == {
        "ExposureTime": 8000, "AnalogueGain": 1.5, "LensPosition": 0.25, "AeEnable": False, "AfMode": 0,
    }  # fmt: skip
    fixed.burst(1, 0.0)
    assert not {"ExposureTime", "AnalogueGain", "LensPosition"} & set(stand_in.last.asked[0])
    fixed.close()


def test_another_crop_than_asked_for_is_refused(stand_in: type[StandIn], monkeypatch: pytest.MonkeyPatch) -> None:
    crop = (8, 0, 1448, 1088)
    with pytest.raises(FrameError, match="has no control ScalerCrop"):
        picamera(crop=crop).open()
    real = stand_in.__init__

    def with_crop(self: StandIn, number: int) -> None:
        real(self, number)
        self.camera_controls["ScalerCrop"] = ((0, 0, 64, 64), (0, 0, 1456, 1088), (0, 0, 1456, 1088))
        self.controls["ScalerCrop"] = crop

    monkeypatch.setattr(stand_in, "__init__", with_crop)
    source = picamera(crop=crop)
    source.open()
    assert stand_in.last.config["controls"]["ScalerCrop"] == crop
    assert source.burst(1, 0.0)[0].metadata["ScalerCrop"] == list(crop)
    source.close()
    with pytest.raises(FrameError, match="not \\[0, 0, 1456, 1088\\]") as caught:
        picamera(crop=(0, 0, 1456, 1088)).open()
    assert "crop = [8, 0, 1448, 1088]" in caught.value.remedy


def test_a_stalled_camera_is_cancelled_before_it_is_stopped(stand_in: type[StandIn]) -> None:
    source = picamera(warmup_frames=1)
    source.open()
    stand_in.last.stalled = True
    with pytest.raises(FrameError, match="no frame or answer") as caught:
        source.burst(1, 0.0)
    assert caught.value.cause is Cause.CAMERA_FAULT
    assert stand_in.last.said[-3:] == ["cancel", "stop", "close"]
    source.open()
    assert len(source.burst(1, 0.0)) == 1
    source.close()


@pytest.mark.parametrize(
    ("config", "says"),
    [
        ({"width": 1456, "height": 1088}, "gives 64x48 px, not 1456x1088"),
        ({"lens_position": 0.0}, "has no control LensPosition"),
        ({"stream": "raw"}, "has no raw stream"),
        ({"camera": 3}, "No camera number"),
    ],
)
def test_what_this_camera_cannot_do_is_said(stand_in: type[StandIn], config: dict[str, object], says: str) -> None:
    with pytest.raises(FrameError, match=says) as caught:
        picamera(**config).open()
    assert caught.value.remedy


def test_sensor_times_belong_to_a_clock_of_this_machine_or_to_none() -> None:
    stamp = monotonic_of_sensor(time.monotonic_ns() - 3_000_000_000)
    assert stamp is not None and abs(time.monotonic() - stamp - 3.0) < 0.2
    assert monotonic_of_sensor(12) is None or time.monotonic() < 600
    assert monotonic_of_sensor(None) is None


def test_metadata_is_what_json_can_hold() -> None:
    kept = plain_metadata({"Lux": 1.5, "ColourGains": (1.0, 2.0), "AfState": object(), "Matrix": [object()]})
    assert kept == {"Lux": 1.5, "ColourGains": [1.0, 2.0]}
