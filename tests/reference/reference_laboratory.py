"""The paper's laboratory as a site, and a picture of a wire in it drawn apart from the package's own scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.port import GreyImage
from sagnode.config.node import Measure, Method
from sagnode.config.span import CameraSurvey, Conductor, Ground, Span
from sagnode.geometry.camera import Intrinsics
from sagnode.site import Site, load_site

K = Intrinsics(960, 540, 691.634, 686.796, 468.717, 270.928)
SPAN, DEPTH, HEIGHT, CAMERA_HEIGHT = 2.7, 2.5, 1.6, 0.9
SAG = 0.31
GROUND = 1.05
OVERSAMPLING = 8


def site(folder: Path, method: Method, rise: float = 0.0, intrinsics: Intrinsics = K, undistort: bool = True) -> Site:
    """The span along east at y = 2.5 m, the camera at its middle, looking north and level."""
    file = folder / "camera.yaml"
    save_intrinsics(file, intrinsics)
    conductor = Conductor(
        id="right",
        near=(0.0, DEPTH, HEIGHT),
        far=(SPAN, DEPTH, HEIGHT + rise),
        diameter_m=0.004,
        sag_min_m=0.15,
        sag_max_m=0.45,
    )
    span = Span(
        name="laboratory",
        conductors=(conductor,),
        ground=Ground(profile=((0.0, GROUND), (SPAN, GROUND))),
        camera=CameraSurvey(position=(SPAN / 2, 0.0, CAMERA_HEIGHT), azimuth_deg=0, elevation_deg=0, intrinsics=file),
    )
    return load_site(span, Measure(method=method, undistort=undistort))


def catenary_pixels(sag: float, rise: float = 0.0) -> np.ndarray:
    """Pixels (N, 2) of the wire through the perfect lens, by plain arithmetic: level camera, wire in one depth."""
    # a from the mid-chord sag, by bisection of a (cosh(L/2a) - 1) = sag; exact for level supports, and sheared by rise
    low, high = 0.1, 1000.0
    for _ in range(200):
        a = 0.5 * (low + high)
        low, high = (a, high) if a * (np.cosh(SPAN / 2 / a) - 1) > sag else (low, a)
    x = np.linspace(0, SPAN, 2001)
    z = HEIGHT + rise * x / SPAN - sag + a * (np.cosh((x - SPAN / 2) / a) - 1)
    return np.stack([K.cx + K.fx * (x - SPAN / 2) / DEPTH, K.cy - K.fy * (z - CAMERA_HEIGHT) / DEPTH], axis=1)


def picture(pixels: np.ndarray, noise: float = 2.0, width_px: float = 1.2) -> GreyImage:
    """A dark wire on a bright ground, anti-aliased by area, with noise."""
    big = np.full((K.height * OVERSAMPLING, K.width * OVERSAMPLING), 190, np.uint8)
    # centre of pixel i lies at (i + 0.5) * OVERSAMPLING - 0.5 of the big picture
    points = np.round(((pixels + 0.5) * OVERSAMPLING - 0.5) * 16).astype(np.int32)
    cv2.polylines(big, [points.reshape(-1, 1, 2)], False, 60, round(width_px * OVERSAMPLING), cv2.LINE_8, 4)
    small = cv2.resize(big, (K.width, K.height), interpolation=cv2.INTER_AREA).astype(float)
    small += np.random.default_rng(7).normal(0, noise, small.shape)
    return np.clip(np.round(small), 0, 255).astype(np.uint8)


def with_distortion() -> Intrinsics:
    """The camera with a barrel distortion, as that of the camera which the paper put aside (section 3.3)."""
    return replace(K, distortion=(-0.25, 0.08, 0.0002, 0.0001, 0.0))
