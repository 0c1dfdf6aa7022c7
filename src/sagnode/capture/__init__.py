"""Capture: frames from files, V4L2 devices and Raspberry Pi cameras, behind one small port."""

from __future__ import annotations

from sagnode.capture.port import FrameSource
from sagnode.config.node import Camera
from sagnode.errors import ConfigError


def open_source(camera: Camera) -> FrameSource:
    """The configured back end, not yet opened; only its own module is imported.

    Raises:
        ConfigError: the back end's table is missing or contradicts itself.
    """
    if camera.backend == "replay":
        from sagnode.capture.replay import Replay

        if camera.replay is None:
            raise ConfigError('camera: backend = "replay" without a table [camera.replay]', "add it, with a path")
        return Replay(camera.replay)
    if camera.backend == "v4l2":
        from sagnode.capture.v4l2 import V4l2

        return V4l2(camera.v4l2)
    from sagnode.capture.picamera2 import Picamera

    return Picamera(camera.picamera2)
