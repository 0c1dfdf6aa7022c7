"""Runs in the virtual machine (vm.sh run vm_v4l2.py): the V4L2 back end on real devices of the kernel.

vivid is a camera that the kernel plays, with faults on request; v4l2loopback carries pictures that are fed into it, so
that what comes out can be compared with the files.
"""

from __future__ import annotations

import fcntl
import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np

from sagnode.capture.images import read_grey
from sagnode.capture.v4l2 import V4l2
from sagnode.config.load import load_node
from sagnode.config.node import V4l2Source
from sagnode.errors import FrameError
from sagnode.pipeline import load_site, measure_burst
from sagnode.quality import Cause, Validity

SITE = Path("/etc/sagnode")
LOOPBACK = "/dev/video9"
TIMEOUT_S = 4.0
VIVID_DRIVER = Path("/sys/bus/platform/drivers/vivid")
_VIDIOC_S_FMT = (3 << 30) | (208 << 16) | (ord("V") << 8) | 5


def ok(text: str) -> None:
    """One line of the table."""
    print(f"ok    {text}", flush=True)


def run(*words: str) -> str:
    """A command that must succeed."""
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


def refused(action: Callable[[], object], says: str, cause: Cause = Cause.CAMERA_FAULT) -> FrameError:
    """The FrameError that the action must raise."""
    try:
        action()
    except FrameError as error:
        assert says in str(error), f"{error} does not say {says!r}"
        assert error.cause is cause, error.cause
        assert error.remedy, error
        return error
    raise AssertionError(f"no fault where one was due: {says}")


def wait_for(path: str, *, there: bool) -> None:
    """Until udev has made or removed a node."""
    until = time.monotonic() + 30
    while Path(path).exists() is not there:
        assert time.monotonic() < until, path
        time.sleep(0.1)


# -- vivid


def vivid() -> None:
    """Frames at rate, refusals, controls, disconnection, unbinding."""
    run("modprobe", "vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0")
    wait_for("/dev/video0", there=True)
    show_noise()
    config = {"device": "/dev/video0", "width": 320, "height": 180, "pixel_format": "YUYV", "timeout_s": TIMEOUT_S}

    def camera(**changes: object) -> V4l2:
        return V4l2(V4l2Source.model_validate(config | changes))

    source = camera(fps=30.0)
    source.open()
    frames = source.burst(60, 0.0)
    rate = 59 / (frames[-1].monotonic_s - frames[0].monotonic_s)
    ok(f"{source.describe()}: 60 frames, {rate:.1f} a second by the driver's own times")
    assert all(b.monotonic_s > a.monotonic_s for a, b in pairwise(frames))
    assert abs(time.monotonic() - frames[-1].monotonic_s) < 2
    apart = source.burst(4, 0.3)
    assert all(b.monotonic_s - a.monotonic_s >= 0.29 for a, b in pairwise(apart))
    time.sleep(1.0)
    asked = time.monotonic()
    assert source.burst(1, 0.0)[0].monotonic_s >= asked, "a frame that waited in the queue was taken for a new one"
    ok("a frame asked for is exposed after it was asked for")

    run("v4l2-ctl", "-d", "/dev/video0", "-c", "disconnect=1")
    began = time.monotonic()
    error = refused(lambda: source.burst(1, 0.0), "/dev/video0")
    ok(f"disconnected while it is open: told after {time.monotonic() - began:.1f} s ({error.what})")
    rebind()
    source.open()
    source.burst(1, 0.0)
    ok("and opened anew")

    (VIVID_DRIVER / "unbind").write_text("vivid.0")
    wait_for("/dev/video0", there=False)
    refused(lambda: source.burst(1, 0.0), "/dev/video0")
    refused(source.open, "does not exist")
    (VIVID_DRIVER / "bind").write_text("vivid.0")
    wait_for("/dev/video0", there=True)
    show_noise()
    source.open()
    source.burst(1, 0.0)
    source.close()
    ok("unbound: the device is missed by name; bound again: opened anew")

    refused(camera(pixel_format="MJPG").open, "not MJPG")
    refused(camera(width=1456, height=1088).open, "not 1456x1088")
    ok("another format or size than asked for is refused")
    refused(camera(exposure=20.0).open, "does not take")
    fixed = camera(pixel_format="GREY", gain=50.0)
    try:
        fixed.open()
        ok(f"gain as asked: {fixed.burst(1, 0.0)[0].metadata}")
    except FrameError as error:
        ok(f"a control that it does not have is told: {error.what}")
    fixed.close()
    held = camera()
    held.open()
    refused(camera().open, "/dev/video0")
    held.close()
    ok("a camera that another has is told to be busy")


def show_noise() -> None:
    """vivid's pattern of noise, as a sensor's: bars that stand still are rightly taken for a frozen camera."""
    menu = run("v4l2-ctl", "-d", "/dev/video0", "--list-ctrls-menus").splitlines()
    entry = next(line for line in menu if "Noise" in line)
    run("v4l2-ctl", "-d", "/dev/video0", "-c", f"test_pattern={entry.split(':')[0].strip()}")


def rebind() -> None:
    """What plugging in again does."""
    for step in ("unbind", "bind"):
        (VIVID_DRIVER / step).write_text("vivid.0")
        time.sleep(0.5)
    wait_for("/dev/video0", there=True)
    show_noise()


# -- v4l2loopback


class Feeder:
    """Feeds pictures into the loopback device, one after the other, until it is told to stop."""

    def __init__(self, pictures: list[np.ndarray], period_s: float) -> None:
        self._pictures, self._period_s = pictures, period_s
        height, width = pictures[0].shape
        self._handle = os.open(LOOPBACK, os.O_RDWR)
        layout = struct.pack("I4x5I", 2, width, height, int.from_bytes(b"GREY", "little"), 1, width)
        layout += struct.pack("2I", width * height, 8)
        fcntl.ioctl(self._handle, _VIDIOC_S_FMT, layout.ljust(208, b"\0"))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._feed, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """The feeder ends, as a camera's process that dies."""
        self._stop.set()
        self._thread.join()
        os.close(self._handle)

    def _feed(self) -> None:
        at = 0
        while not self._stop.wait(self._period_s):
            os.write(self._handle, self._pictures[at].tobytes())
            at = (at + 1) % len(self._pictures)


@contextmanager
def fed(pictures: list[np.ndarray]) -> Iterator[Feeder]:
    """A feeder that is stopped in any case."""
    feeder = Feeder(pictures, 0.2)
    try:
        time.sleep(1.0)
        yield feeder
    finally:
        feeder.stop()


def loopback() -> None:
    """Rendered scenes through the device: the same pixels, the same readings; a feeder that stops."""
    run("modprobe", "v4l2loopback", "devices=1", "video_nr=9", "exclusive_caps=1", "max_buffers=2")
    wait_for(LOOPBACK, there=True)
    loaded = load_node(SITE)
    site = load_site(loaded.span, loaded.node.measure)
    files = sorted((SITE / "frames").glob("*.jpg"))[:3]
    pictures = [read_grey(file) for file in files]
    height, width = pictures[0].shape
    source = V4l2(V4l2Source(device=LOOPBACK, width=width, height=height, timeout_s=TIMEOUT_S, warmup_frames=1))
    with fed(pictures):
        source.open()
        seen = [source.burst(1, 0.0)[0].image for _ in range(6)]
    ok(f"{source.describe()}: 6 pictures of rendered scenes")
    same = [next((i for i, p in enumerate(pictures) if np.array_equal(image, p)), None) for image in seen]
    assert None not in same, f"pixels differ from the files: {same}"
    ok(f"every pixel is the file's: {[files[i].stem for i in same if i is not None]}")
    began = time.monotonic()
    error = refused(lambda: source.burst(1, 0.0), LOOPBACK)
    ok(f"the feeder stopped: told after {time.monotonic() - began:.1f} s ({error.what})")
    assert time.monotonic() - began < TIMEOUT_S + 3
    with fed(pictures):
        source.open()
        image = source.burst(1, 0.0)[0].image
        source.close()
    ok("the feeder is back: opened anew")
    worst = 0.0
    file = next(i for i, picture in enumerate(pictures) if np.array_equal(image, picture))
    for live, replay in zip(measure_burst(site, [image]), measure_burst(site, [pictures[file]]), strict=True):
        assert live.validity is replay.validity is not Validity.INVALID, (live, replay)
        for stem, estimate in live.estimates.items():
            worst = max(worst, abs(estimate.value - replay.estimates[stem].value) / replay.estimates[stem].u)
    ok(f"readings equal those of the file within {worst:.3f} u")
    assert worst <= 0.1


def feed() -> None:
    """Feed the loopback device until the process is ended (vm_stall.sh)."""
    with fed([read_grey(file) for file in sorted((SITE / "frames").glob("*.jpg"))]):
        threading.Event().wait()


def main(words: list[str]) -> int:
    """All of it, or only the feeder."""
    if words == ["feed"]:
        feed()
    run("systemctl", "stop", "sagnode")  # it would share the processor
    vivid()
    loopback()
    print("V4L2 FINE")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
