"""The real worker with a camera that does what cameras do when they fail; started by the daemon in place of the worker.

    faulty_camera.py LEDGER KIND,KIND... CONFIG REQUESTS_FD REPLIES_FD PARENT

Frames are the demonstration's. Like the live back ends it shows every frame to ``check_frame`` before it is believed.
"""

import os
import sys
import time
from pathlib import Path

import numpy as np

import sagnode.capture
from sagnode.capture.checks import check_frame
from sagnode.capture.port import Frame, FrameSource
from sagnode.capture.replay import Replay
from sagnode.errors import FrameError
from sagnode.worker.child import main

ledger, kinds, config, requests, replies, parent = sys.argv[1:]
KINDS = kinds.split(",")


def note(text):
    with Path(ledger).open("a") as stream:
        stream.write(f"{time.monotonic():.6f} {text}\n")


def noted():
    return sum(1 for line in Path(ledger).read_text().splitlines() if " F " in line)


class FaultyCamera(FrameSource):
    """Every second burst fails, in another way each time."""

    def __init__(self, camera):
        self._frames = Replay(camera.replay)
        self._previous = None
        self._faulty = False
        self._gone_until = 0.0

    def open(self):
        if time.monotonic() < self._gone_until:
            raise FrameError("camera: no such device", "check the cable")
        self._frames.open()

    def close(self):
        self._frames.close()

    def burst(self, count, interval_s):
        frame = self._frames.burst(1, interval_s)[0]
        image, kind = frame.image, "fine"
        if self._faulty:
            kind = KINDS[noted() % len(KINDS)]
            note(f"F {kind}")
            image = self._spoilt(kind, image)
        else:
            note("G 0")
        self._faulty = not self._faulty
        check_frame(image, self._previous, "camera")
        self._previous = image
        return [Frame(image, frame.utc, time.monotonic(), f"{frame.source} {kind}")]

    def first_frame_at(self):
        return self._frames.first_frame_at()

    def skip_until(self, utc):
        self._frames.skip_until(utc)

    def _spoilt(self, kind, image):
        before = self._previous if self._previous is not None else image
        spoilt = image.copy()
        half = len(image) // 2
        if kind == "stall":
            time.sleep(60)
        if kind in {"timeout", "vanish"}:
            self._gone_until = time.monotonic() + (0.3 if kind == "vanish" else 0.0)
            raise FrameError("camera: no frame in 5 s", "check the cable")
        if kind == "stale":
            return before.copy()
        if kind == "black":
            return np.zeros_like(image)
        if kind == "burnt-out":
            return np.full_like(image, 255)
        if kind == "half-black":
            spoilt[half:] = 0
        elif kind == "half-old":
            spoilt[half:] = before[half:]
        elif kind == "upper-half-old":
            spoilt[:half] = before[:half]
        elif kind == "torn":  # the lines are shifted from some row on, as when a transfer lost bytes
            spoilt[half:] = np.roll(spoilt[half:], 137, axis=1)
        elif kind == "noise":
            spoilt = np.random.default_rng(noted()).integers(0, 256, image.shape, np.uint8)
        elif kind == "bands":
            spoilt[::4] = 128
        return spoilt


sagnode.capture.open_source = FaultyCamera
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.exit(main(["--config", config, "--requests-fd", requests, "--replies-fd", replies, "--parent", parent]))
