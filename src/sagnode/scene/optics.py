"""From linear greys to the 8-bit picture: light of the hour, lens, rain, noise."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.scene.canvas import rays_of
from sagnode.scene.noise import Float32, Floats, generator
from sagnode.scene.spec import Moment, Scene
from sagnode.scene.wires import Seen

_LONGEST = 2.0e4
"""Largest ratio by which exposure time and gain can be raised over a bright day."""
_TIME_SHARE = 1.5e3
"""The part of it that is exposure time and costs no noise."""
_BLACK = 4.0


def illumination(moment: Moment) -> float:
    """Light relative to a bright noon; falls by five decades between sunrise and the end of twilight."""
    knots = (-18.0, -12.0, -6.0, 0.0, 5.0, 15.0, 40.0, 65.0)
    decades = (-8.0, -7.0, -4.5, -2.4, -1.1, -0.6, -0.1, 0.0)
    clear = math.pow(10.0, float(np.interp(moment.sun_elevation_deg, knots, decades)))
    return clear * (1 - 0.7 * moment.cloud) * (1 - 0.4 * moment.rain)


def sunlight(moment: Moment) -> float:
    """Share of direct light, 0 (overcast, fog, sun down) to 1."""
    height = min(max(math.sin(math.radians(moment.sun_elevation_deg)) * 2.2, 0.0), 1.0)
    return height * math.pow(1 - moment.cloud, 0.8) * math.exp(-moment.fog_per_m * 500.0)


def exposure_and_gain(moment: Moment) -> tuple[float, float]:
    """Brightness relative to a well exposed picture, and the analogue gain that it took."""
    wanted = 1.0 / max(illumination(moment), 1e-12)
    reached = min(wanted, _LONGEST)
    gain = max(1.0, reached / _TIME_SHARE)
    brightness = reached / wanted if moment.exposure is None else moment.exposure
    return brightness, gain


def noise_level(moment: Moment, signal: Floats, gain: float) -> Floats:
    """Standard deviation of the noise (grey levels) at a signal: read noise and shot noise, raised by the gain."""
    read, shot = np.float32(moment.read_noise**2 * gain), np.float32(moment.shot_noise**2 * gain)
    return np.asarray(np.sqrt(read + shot * np.maximum(signal, np.float32(0.0))))


def develop(scene: Scene, moment: Moment, grey: Float32) -> GreyImage:
    """The 8-bit picture that the sensor delivers; deterministic in ``moment.seed``."""
    rng = generator(scene.seed, moment.seed, "sensor")
    brightness, gain = exposure_and_gain(moment)
    light = _through_lens(moment, grey, rng)
    if moment.rain > 0:
        light = _rain(moment, light, rng)
    if moment.glare > 0:
        light = _glare(scene, moment, light)
    signal = light * np.float32(brightness)
    noise = rng.standard_normal(signal.shape, dtype=np.float32)
    signal += noise * noise_level(moment, signal, gain)
    return np.asarray(np.clip(np.rint(signal + np.float32(_BLACK)), 0, 255), dtype=np.uint8)


def _through_lens(moment: Moment, grey: Float32, rng: np.random.Generator) -> Float32:
    """What a covered, fogged or wet lens leaves of the picture."""
    height, width = grey.shape
    if moment.lens == "covered":
        # something lies on the glass: only a little stray light at one edge
        edge = np.linspace(0.0, 1.0, width, dtype=np.float32) ** 6
        return np.asarray(np.float32(3.0) + np.float32(10.0) * edge[None, :] * np.ones((height, 1), np.float32))
    if moment.lens == "fogged":
        small = cv2.resize(grey, (width // 8, height // 8), interpolation=cv2.INTER_AREA)
        soft = cv2.GaussianBlur(small, (0, 0), max(width / 45.0 / 8, 1.0))
        soft = cv2.resize(soft, (width, height), interpolation=cv2.INTER_CUBIC)
        return np.asarray(np.float32(0.35) * soft + np.float32(110.0), np.float32)
    if moment.lens == "drops":
        grey = grey.copy()
        for _ in range(14):
            u, v = int(rng.uniform(0, width)), int(rng.uniform(0, height))
            radius = int(rng.uniform(0.012, 0.05) * width)
            top, left = max(v - radius, 0), max(u - radius, 0)
            part = grey[top : v + radius, left : u + radius]
            y, x = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
            inside = 1 - np.hypot(x - u, y - v) / max(radius, 1)
            cover = np.clip(inside * 4, 0.0, 1.0).astype(np.float32)
            part += cover * (cv2.GaussianBlur(part, (0, 0), radius / 3) + np.float32(6.0) - part)
    return grey


def _rain(moment: Moment, light: Float32, rng: np.random.Generator) -> Float32:
    """Short bright slanting streaks, and the fall in contrast of a wet afternoon."""
    height, width = light.shape
    drops = np.zeros_like(light)
    count = int(moment.rain * 1.1e-3 * height * width)
    v, u = rng.integers(0, height, count), rng.integers(0, width, count)
    np.add.at(drops, (v, u), rng.gamma(2.0, 20.0, count).astype(np.float32))
    length = max(height // 60, 5)
    kernel = np.zeros((length, length), np.float32)
    for k in range(length * 4):
        t = k / (length * 4)
        kernel[int(t * length), int(length / 2 + 0.25 * (t - 0.5) * length)] += 1.0
    kernel /= kernel.sum()
    streaks = cv2.GaussianBlur(cv2.filter2D(drops, -1, kernel), (0, 0), 0.7)
    return np.asarray(light + streaks * np.float32(3.0), np.float32)


def _glare(scene: Scene, moment: Moment, light: Float32) -> Float32:
    """Veil of a sun in or near the frame: everywhere a little, around the sun much."""
    x, y, z = (scene.pose_at(moment).rotation @ sun_direction(moment)).astype(np.float32)
    rays = rays_of(scene.intrinsics).camera
    cosine = (rays[..., 0] * x + rays[..., 1] * y + z) / np.sqrt(
        rays[..., 0] ** 2 + rays[..., 1] ** 2 + np.float32(1.0)
    )
    return np.asarray(light + _veil(moment, cosine), np.float32)


def _veil(moment: Moment, cosine: Floats) -> Floats:
    """Stray light of the sun (linear greys) in directions of that cosine to it."""
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    veil = np.float32(60.0) + np.float32(900.0) / (1 + (angle / np.float32(3.0)) ** 2)
    return np.asarray(np.float32(moment.glare) * veil, np.float32)


def sun_direction(moment: Moment) -> FloatArray:
    """Unit vector (3,) towards the sun, site frame."""
    azimuth, elevation = math.radians(moment.sun_azimuth_deg), math.radians(moment.sun_elevation_deg)
    return np.array(
        [math.sin(azimuth) * math.cos(elevation), math.cos(azimuth) * math.cos(elevation), math.sin(elevation)]
    )


def developed(scene: Scene, moment: Moment, seen: Seen, points: FloatArray) -> Seen:
    """How a wire came out when the sun's veil lies over it and the sensor has no more levels.

    Args:
        scene: of the frame.
        moment: of the frame.
        seen: how it came out before that.
        points: where it is in space (N, 3), site frame.
    """
    background = seen.background
    if moment.glare > 0:
        rays = points - scene.pose_at(moment).position
        cosine = rays @ sun_direction(moment) / np.linalg.norm(rays, axis=1)
        background = background + _veil(moment, cosine.astype(np.float32))
    full = np.float32((255 - _BLACK) / max(exposure_and_gain(moment)[0], 1e-6))
    cover = np.maximum(seen.cover(moment.psf_px), np.float32(1e-6))
    left = np.minimum(background + cover * seen.difference, full) - np.minimum(background, full)
    return replace(seen, background=background, difference=np.asarray(left / cover, np.float32))
