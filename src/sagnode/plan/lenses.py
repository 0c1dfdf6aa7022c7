"""Sensors and lenses that have only been read about: from millimetres on a data sheet to pixels."""

from __future__ import annotations

import re
from dataclasses import dataclass

from sagnode.errors import ConfigError
from sagnode.geometry.camera import Intrinsics

USUAL_FOCAL_MM = (4.0, 6.0, 8.0, 12.0, 16.0, 25.0, 35.0, 50.0)
"""Focal lengths that C- and S-mount lenses for these sensors are sold with."""
FEWEST_PX, MOST_PX = 64, 20_000


@dataclass(frozen=True)
class Sensor:
    """An image sensor in the mode that is used: pixels, and their pitch in micrometres (binning counted in)."""

    name: str
    width: int
    height: int
    pitch_um: float


SENSORS = (
    Sensor("imx296", 1456, 1088, 3.45),
    Sensor("imx477", 4056, 3040, 1.55),
    Sensor("imx477-binned", 2028, 1520, 3.10),
    Sensor("imx708", 4608, 2592, 1.40),
    Sensor("imx708-binned", 2304, 1296, 2.80),
    Sensor("imx219", 3280, 2464, 1.12),
    Sensor("ov5647", 2592, 1944, 1.40),
)
"""The Raspberry Pi's global shutter camera, HQ camera, camera modules 3, 2 and 1 (their documentation's sizes)."""


def named_sensor(text: str) -> Sensor:
    """A sensor by name, or described as ``WIDTHxHEIGHTxPITCH`` such as ``1456x1088x3.45`` (px, px, um).

    Raises:
        ConfigError: it is neither.
    """
    for sensor in SENSORS:
        if text.lower() == sensor.name:
            return sensor
    found = re.fullmatch(r"(\d{2,5})x(\d{2,5})x(\d+(?:\.\d+)?)", text.lower())
    if found is not None:
        sensor = Sensor(text, int(found[1]), int(found[2]), float(found[3]))
        small, large = sorted((sensor.width, sensor.height))
        if small >= FEWEST_PX and large <= MOST_PX and 0.3 <= sensor.pitch_um <= 50:
            return sensor
    names = ", ".join(sensor.name for sensor in SENSORS)
    raise ConfigError(
        f"--sensor {text}: no such sensor", f"one of {names}, or width x height x pitch in um, such as 1456x1088x3.45"
    )


def sensor_of(intrinsics: Intrinsics) -> Sensor | None:
    """The known sensor that takes pictures of this size; None where none does."""
    size = (intrinsics.width, intrinsics.height)
    return next((s for s in SENSORS if (s.width, s.height) == size), None)


def lens_on(sensor: Sensor, focal_mm: float) -> Intrinsics:
    """A perfect lens of that focal length before the middle of a sensor."""
    focal_px = focal_mm * 1000 / sensor.pitch_um
    middle = ((sensor.width - 1) / 2, (sensor.height - 1) / 2)
    return Intrinsics(sensor.width, sensor.height, focal_px, focal_px, *middle)
