"""Runs the picamera2 back end on the real Picamera2 and libcamera, whose "virtual" pipeline plays picture files.

Needs libcamera 0.4 or later with that pipeline (Debian 13: python3-libcamera, libcamera-ipa) and picamera2; run by
``bare_root.sh trixie picamera2``, not by make test. Picamera2 itself is not changed; what the virtual pipeline and a
kernel without /dev/dma_heap lack is put underneath it by :func:`prepare`. Not to be had this way: other formats than
NV12, exposure, gain and focus, and the Raspberry Pi's own image processor.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
import types
from itertools import pairwise
from pathlib import Path
from typing import Any

WIDTH, HEIGHT, PICTURES = 640, 480, 20
SCENE_WIDTH, SCENE_HEIGHT = 1456, 1088
CONFIGURATION = Path("/usr/share/libcamera/pipeline/virtual/virtual.yaml")
STALLED = Path("/tmp/virtual-camera-stalled")  # noqa: S108 - a switch inside a throw-away root
PERIOD_S = 1 / 30
REPEATS = 4  # the virtual pipeline shows each picture file four times over


def write_camera(folder: Path) -> None:
    """Two cameras: one plays pictures of distinct brightness, the other rendered scenes of the demonstration's noon."""
    import cv2
    import numpy as np

    folder.mkdir(parents=True, exist_ok=True)
    scenes = folder.with_name("virtual-scenes")
    scenes.mkdir(exist_ok=True)
    for i, file in enumerate(scene_files()):
        shutil.copy(file, scenes / f"{i}.jpg")
    for i in range(PICTURES):
        noise = np.random.default_rng(i).integers(0, 20, (HEIGHT, WIDTH, 3), np.uint8)
        cv2.imwrite(str(folder / f"{i:02d}.jpg"), noise + np.uint8(10 * i + 20))
    CONFIGURATION.parent.mkdir(parents=True, exist_ok=True)
    CONFIGURATION.write_text(
        "%YAML 1.1\n---\n"
        + "".join(
            f'"{name}":\n  supported_formats:\n  - width: {width}\n    height: {height}\n'
            f'  frames:\n    path: "{path}/"\n  model: "{name}"\n'
            for name, width, height, path in [
                ("Virtual0", WIDTH, HEIGHT, folder),
                ("Virtual1", SCENE_WIDTH, SCENE_HEIGHT, scenes),
            ]
        )
    )


def site_directory() -> Path:
    """The demonstration's survey, lens and frames."""
    import sagnode.demo

    return Path(sagnode.demo.__file__).parent / "site"


def scene_files() -> list[Path]:
    """Three rendered frames, in the order in which the camera plays them."""
    return sorted((site_directory() / "frames").glob("20260621T1[234]0000Z.jpg"))


def prepare() -> None:
    """Close four gaps below Picamera2; import nothing of it before."""
    import libcamera

    # Its preview for a screen, which a daemon never opens, is imported all the same.
    screen = types.ModuleType("pykms")
    screen.PixelFormat = type("PixelFormat", (), {"__getattr__": lambda _, name: name})()  # type: ignore[attr-defined]
    sys.modules.setdefault("pykms", screen)

    # Picamera2 asks for a raw stream when it opens a camera; the virtual pipeline knows viewfinders alone.
    generate = libcamera.Camera.generate_configuration
    raw, view = libcamera.StreamRole.Raw, libcamera.StreamRole.Viewfinder
    libcamera.Camera.generate_configuration = lambda camera, roles: generate(
        camera, [view if role == raw else role for role in roles]
    )

    # libcamera 0.4 leaves the status of virtual frames to chance, and Picamera2 drops what is not Success.
    if libcamera.CameraManager.singleton().version.startswith("v0.4"):
        libcamera.FrameMetadata.status = property(lambda _: libcamera.FrameMetadata.Status.Success)

    # The pipeline runs as fast as it is asked; a real sensor has a period, and a broken one gives nothing at all.
    queue_request, last = libcamera.Camera.queue_request, [0.0]

    def paced(camera: Any, request: Any) -> Any:
        if STALLED.exists():
            return None
        time.sleep(max(0.0, last[0] + PERIOD_S - time.monotonic()))
        last[0] = time.monotonic()
        return queue_request(camera, request)

    libcamera.Camera.queue_request = paced

    # It writes luma and chroma into two planes, where Picamera2 makes buffers of one.
    whole = libcamera.FrameBuffer

    class TwoPlanes(whole):  # type: ignore[misc,valid-type]
        def __init__(self, planes: list[Any]) -> None:
            if len(planes) == 1:
                luma, chroma = planes[0], whole.Plane()
                size = luma.length * 2 // 3
                chroma.fd, chroma.offset, chroma.length = luma.fd, luma.offset + size, luma.length - size
                luma.length = size
                planes = [luma, chroma]
            super().__init__(planes)

    libcamera.FrameBuffer = TwoPlanes
    if not Path("/dev/dma_heap/linux,cma").exists():
        _buffers_without_dma_heap()


def _buffers_without_dma_heap() -> None:
    """Plain shared memory in the place of DMA buffers, for kernels that have none."""
    import picamera2.allocators.dmaallocator as allocator
    from picamera2.dma_heap import UniqueFD

    class Heap:
        isValid = True  # noqa: N815 - Picamera2's name

        def alloc(self, name: str, size: int) -> UniqueFD:
            handle = os.memfd_create(name)
            os.ftruncate(handle, size)
            return UniqueFD(handle)

        def close(self) -> None:
            pass

    allocator.DmaHeap = Heap
    # Caches need no synchronising where no device writes.
    allocator.fcntl = types.SimpleNamespace(ioctl=lambda *_: 0)


def number_of(name: str) -> int:
    """A camera's place in Picamera2's list, which is not the "Num" that it shows there."""
    from picamera2 import Picamera2

    return next(i for i, one in enumerate(Picamera2.global_camera_info()) if one["Model"] == name)


def same_readings() -> None:
    """Rendered scenes through the camera: the same pixels, and the same readings as those of the files.

    libcamera's virtual pipeline undoes JPEG with a coarser transform than OpenCV (libyuv asks for libjpeg's fast one),
    which moves grey levels. So the files are undone the same way, and replayed as PNG.
    """
    import cv2
    import numpy as np
    import simplejpeg  # Picamera2 brings it

    from sagnode.capture.images import read_grey
    from sagnode.capture.picamera2 import Picamera
    from sagnode.config.load import load_node
    from sagnode.config.node import Picamera2Source
    from sagnode.errors import FrameError
    from sagnode.pipeline import load_site, measure_burst
    from sagnode.quality import Cause, Validity

    loaded = load_node(site_directory())
    site = load_site(loaded.span, loaded.node.measure)
    replayed = Path("/opt/replayed-scenes")
    replayed.mkdir(exist_ok=True)
    files = []
    for file in scene_files():
        grey = simplejpeg.decode_jpeg(file.read_bytes(), "GRAY", fastdct=True, fastupsample=True)
        png = replayed / f"{file.stem}.png"
        cv2.imwrite(str(png), grey)
        files.append(read_grey(png))
    config = {
        "camera": number_of("Virtual1"),
        "width": SCENE_WIDTH,
        "height": SCENE_HEIGHT,
        "timeout_s": 5.0,
        "warmup_frames": 2,
    }
    source = Picamera(Picamera2Source.model_validate(config))
    source.open()
    print(f"scenes: {source.describe()}")
    taken = []
    until = time.monotonic() + 60.0
    while len(taken) < 6 and time.monotonic() < until:
        try:
            taken += source.burst(1, 0.0)
        except FrameError as error:  # the same picture as a moment ago
            assert error.cause is Cause.STALE_FRAME, error
        time.sleep(1.3 * REPEATS * PERIOD_S)
    source.close()
    by_file: dict[int, np.ndarray] = {}
    for frame in taken:
        distances = [float(np.abs(frame.image.astype(int) - file).mean()) for file in files]
        by_file[int(np.argmin(distances))] = frame.image
    assert len(by_file) >= 2, "at least two of the scenes are seen"
    worst, most = 0.0, 0
    for i, image in by_file.items():
        most = max(most, int(np.abs(image.astype(int) - files[i]).max()))
        for live, replay in zip(measure_burst(site, [image]), measure_burst(site, [files[i]]), strict=True):
            assert live.validity is replay.validity is not Validity.INVALID, (live.reasons, replay.reasons)
            for stem, estimate in live.estimates.items():
                worst = max(worst, abs(estimate.value - replay.estimates[stem].value) / replay.estimates[stem].u)
    print(f"readings of {len(by_file)} scenes equal those of the files within {worst:.4f} u; grey levels within {most}")
    assert worst <= 0.1


def main() -> int:
    """Frames, their times, a stall, a reopening, readings of rendered scenes; prints PICAMERA2 FINE."""
    write_camera(Path("/opt/virtual-frames"))
    STALLED.unlink(missing_ok=True)
    prepare()
    from sagnode.capture.picamera2 import Picamera
    from sagnode.config.node import Picamera2Source
    from sagnode.errors import FrameError
    from sagnode.quality import Cause

    config = {"camera": number_of("Virtual0"), "width": WIDTH, "height": HEIGHT, "timeout_s": 2.0, "warmup_frames": 3}
    source = Picamera(Picamera2Source.model_validate(config))
    began = time.monotonic()
    source.open()
    print(f"opened in {time.monotonic() - began:.2f} s: {source.describe()}")
    assert source.describe().endswith("640x480 NV12"), "the format that libcamera adjusted to"

    # Three times as long as a picture is shown, so that a machine under load still sees another one each time.
    apart_s = 3 * REPEATS * PERIOD_S
    frames = source.burst(15, apart_s)
    levels = sorted({round(float(frame.image.mean()) / 10) for frame in frames})
    gaps = [b.monotonic_s - a.monotonic_s for a, b in pairwise(frames)]
    print(f"15 frames {frames[0].image.shape}, brightness steps {levels}, {min(gaps):.3f} to {max(gaps):.3f} s apart")
    print(f"metadata: {dict(frames[-1].metadata)}")
    assert len(levels) >= 8, "the picture files are seen"
    assert min(gaps) >= apart_s - PERIOD_S
    assert time.monotonic() - frames[-1].monotonic_s < 1, "sensor times are of this clock"

    time.sleep(1.5)
    # A few pictures go round, so that the next may by chance be the last one again, and be refused for that.
    for _ in range(2 * PICTURES):
        asked = time.monotonic()
        try:
            fresh = source.burst(1, 0.0)[0]
            break
        except FrameError as error:
            assert error.cause is Cause.STALE_FRAME, error
            time.sleep(apart_s)
    assert fresh.monotonic_s >= asked, "a frame that waited in the queue is not taken for a new one"
    try:
        source.burst(2 * REPEATS, 0.0)
        raise AssertionError("the same picture twice was accepted")
    except FrameError as error:
        print(f"repeated: {error}")
        assert error.cause is Cause.STALE_FRAME, error.cause

    STALLED.touch()
    began = time.monotonic()
    try:
        while time.monotonic() - began < 30:
            source.burst(1, 0.0)
            time.sleep(apart_s)
        raise AssertionError("a stalled camera still gave frames")
    except FrameError as error:
        print(f"stalled: told and closed after {time.monotonic() - began:.2f} s: {error}")
        assert error.cause is Cause.CAMERA_FAULT, error.cause
    STALLED.unlink()
    for _ in range(3):
        began = time.monotonic()
        source.open()
        assert len(source.burst(2, apart_s)) == 2
        print(f"reopened, two frames after {time.monotonic() - began:.2f} s")
        source.close()

    for wrong, says in [
        ({"width": 1456, "height": 1088}, "not 1456x1088"),
        ({"camera": 5}, "camera"),
        ({"gain": 2}, "gain"),
    ]:
        try:
            Picamera(Picamera2Source.model_validate(config | wrong)).open()
            raise AssertionError(f"{wrong} was accepted")
        except FrameError as error:
            print(f"refused: {error}")
            assert says in str(error)
    same_readings()
    print("PICAMERA2 FINE")
    return 0


if __name__ == "__main__":
    sys.exit(main())
