"""A small, sound configuration that tests damage: 100 m of span seen along the line, six landmarks."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sagnode.calibrate.files import save_intrinsics
from sagnode.config.show import toml_text
from sagnode.geometry.camera import Intrinsics, Pose, project, rotation_from_angles

CAMERA = Intrinsics(1456, 1088, 1739.0, 1739.0, 727.5, 543.5)
MARKS = {
    "peak": (0.0, 100.0, 15.0),
    "arm-left": (-3.0, 100.0, 13.0),
    "arm-right": (3.0, 100.0, 13.0),
    "leg": (1.5, 99.0, 1.0),
    "barn": (-9.0, 70.0, 5.0),
    "pole": (6.0, 40.0, 8.0),
}

NODE: dict[str, Any] = {
    "span_file": "span.toml",
    "unit": {"utility": "u", "line": "l", "span": "T1-T2", "unit": "n1"},
    "camera": {"backend": "replay", "replay": {"path": "frames"}},
    "schedule": {"interval_s": 300.0},
    "mqtt": {"host": "localhost", "port": 1883},
}


def _conductor(name: str, x: float) -> dict[str, Any]:
    return {
        "id": name,
        "near": [x, 0.0, 12.0],
        "far": [x, 100.0, 12.5],
        "diameter_m": 0.02,
        "sag_min_m": 1.0,
        "sag_max_m": 5.0,
    }


def _span() -> dict[str, Any]:
    pose = Pose(rotation_from_angles(0.0, 3.6, 0.0), np.array([1.5, 0.5, 4.0]))
    pixels, _ = project(CAMERA, pose, np.array(list(MARKS.values())))
    return {
        "name": "T1-T2",
        "conductors": [_conductor("L1", -3.0), _conductor("L2", 0.0)],
        "ground": {"profile": [[0.0, 0.0], [100.0, 0.5]]},
        "camera": {
            "position": [1.5, 0.5, 4.0],
            "azimuth_deg": 0.0,
            "elevation_deg": 3.6,
            "intrinsics": "camera.yaml",
            "reference_image": "reference.png",
        },
        "landmarks": [
            {"id": name, "position": list(place), "pixel": pixel.round(1).tolist()}
            for (name, place), pixel in zip(MARKS.items(), pixels, strict=True)
        ],
    }


SPAN = _span()
COUNTRY = cv2.resize(np.random.default_rng(1).integers(40, 216, (136, 182), np.uint8), (CAMERA.width, CAMERA.height))
"""A picture with something to recognise wherever a landmark is clicked."""


class SiteFiles:
    """The files of one configuration in a directory of their own."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.node = directory / "node.toml"
        self.span = directory / "span.toml"
        directory.mkdir(parents=True, exist_ok=True)
        save_intrinsics(directory / "camera.yaml", CAMERA)
        cv2.imwrite(str(directory / "reference.png"), COUNTRY)
        (directory / "frames").mkdir()
        cv2.imwrite(str(directory / "frames" / "one.png"), np.full((1088, 1456), 128, np.uint8))
        self.write()

    def write(
        self,
        node: Callable[[dict[str, Any]], object] | None = None,
        span: Callable[[dict[str, Any]], object] | None = None,
    ) -> SiteFiles:
        """Write both files, after the given changes to fresh copies of their data."""
        for path, data, change in ((self.node, NODE, node), (self.span, SPAN, span)):
            document = copy.deepcopy(data)
            if change is not None:
                change(document)
            path.write_text(toml_text(document), encoding="utf-8")
        return self
