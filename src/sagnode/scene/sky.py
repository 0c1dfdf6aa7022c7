"""The sky: a gradient, clouds on a layer above the ground, distant hills and the forest at the horizon."""

from __future__ import annotations

import numpy as np

from sagnode.scene.canvas import Canvas
from sagnode.scene.light import Light
from sagnode.scene.noise import Float32, Floats, sample, tile
from sagnode.scene.spec import Moment, Scene

CLOUD_BASE_M = 1400.0
CLOUD_TEXEL_M = 45.0
_EARLIEST_SLOPE = 0.02
"""Clouds nearer to the horizon than this slope melt into the haze."""


def air_light(moment: Moment) -> float:
    """Grey of the horizon and of fog."""
    return 196.0 - 34.0 * moment.cloud


def paint_sky(canvas: Canvas, scene: Scene, moment: Moment) -> None:
    """Paint sky and clouds above the horizon."""
    rows = _rows_above(canvas, -0.03)
    if rows is None:
        return
    direction = canvas.direction[rows]
    horizontal = np.hypot(direction[..., 0], direction[..., 1])
    up = direction[..., 2] / horizontal
    zenith = np.float32(150.0 - 25.0 * moment.cloud)
    grey = zenith + (np.float32(canvas.air.light) - zenith) * np.exp(-np.maximum(up, 0.0) / np.float32(0.16))
    if moment.cloud > 0:
        layer = np.float32(CLOUD_BASE_M / CLOUD_TEXEL_M) / np.maximum(up, np.float32(_EARLIEST_SLOPE)) / horizontal
        east, north = (d / CLOUD_TEXEL_M for d in moment.cloud_drift_m)
        texture = tile(scene.seed, "clouds", slope=1.45, coarsest=200.0, finest=2.5)
        x, y = direction[..., 1] * layer - np.float32(east), direction[..., 0] * layer - np.float32(north)
        density = sample(texture, x, y) + np.float32(3.2 * moment.cloud - 1.7)
        cover = np.clip(density * np.float32(0.7 * moment.cloud_contrast), 0.0, 1.0)
        # thick clouds are dark below; thin ones shine
        dark = np.float32(32.0 * moment.cloud_contrast) * np.clip(density - 0.4, 0.0, 1.2)
        tone = np.float32(222.0 - 30.0 * moment.cloud) - dark
        fade = np.clip((up - np.float32(_EARLIEST_SLOPE)) / np.float32(0.10), 0.0, 1.0)
        grey += cover * fade * (tone - grey)
    if moment.fog_per_m > 1e-3:
        # a layer of fog some hundred metres deep
        grey = canvas.air.veil(grey, np.float32(150.0) / np.maximum(up, np.float32(0.05)))
    canvas.grey[rows] = grey


def paint_horizon(canvas: Canvas, scene: Scene, season: Light) -> None:
    """Paint hills far away and the forest edge, as cylinders about the camera's place."""
    world = scene.world
    layers: list[tuple[str, float, float, float, float]] = [("hills", 8000.0, 105.0, 57.0, season.snowed(78.0, 0.6))]
    if world.forest_m > 0:
        forest = season.snowed(52.0 + 24.0 * season.bare, 0.45)
        layers.append(("forest", world.horizon_m, world.forest_m, 0.10 * world.forest_m, forest))
    camera_height = float(canvas.pose.position[2])
    foot = min(z for _, z in scene.true.ground.profile)
    for name, distance, height, roughness, tone in layers:
        rows = _rows_above(canvas, (foot - camera_height) / distance - 0.005)
        if rows is None:
            continue
        direction = canvas.direction[rows]
        up = direction[..., 2] / np.hypot(direction[..., 0], direction[..., 1])
        band = np.flatnonzero((up < (height + 4 * roughness) / distance).any(axis=1))
        if band.size == 0:
            continue
        rows = slice(rows.start + int(band[0]), rows.start + int(band[-1]) + 1)
        direction, up = canvas.direction[rows], up[band[0] : band[-1] + 1]
        bearing = np.arctan2(direction[..., 1], direction[..., 0])
        metres = bearing * np.float32(distance)
        skyline = _skyline(scene.seed, name, metres, height, roughness)
        z = np.float32(camera_height) + up * np.float32(distance)
        pixel_m = distance / canvas.intrinsics.fx
        cover = np.clip((skyline - z) / np.float32(2.2 * canvas.psf_px * pixel_m) + np.float32(0.5), 0.0, 1.0)
        texture = tile(scene.seed, "leaves", slope=0.7, coarsest=32.0, finest=3.0)
        rough = sample(texture, metres / np.float32(1.6 * pixel_m), z / np.float32(1.6 * pixel_m))
        light = np.float32(tone) * (1 + np.float32(0.09 if name == "forest" else 0.04) * rough)
        light *= np.float32(0.8) + np.float32(0.3) * np.clip((z - foot) / np.float32(height), 0.0, 1.3)
        target = canvas.grey[rows]
        target += cover * (canvas.air.veil(light, distance) - target)


def _skyline(seed: int, name: str, metres: Floats, height: float, roughness: float) -> Float32:
    """Height (m) of a silhouette at the metres along it: two scales of noise."""
    texture = tile(seed, name, slope=1.2, coarsest=120.0, finest=3.0)
    scale = 1.3 if name == "forest" else 115.0
    line = np.zeros_like(metres)
    fine = sample(texture, metres / np.float32(scale), line)
    coarse = sample(texture, metres / np.float32(14 * scale), line + np.float32(200.0))
    return np.asarray(np.float32(height) + np.float32(roughness) * (np.float32(0.55) * fine + coarse), np.float32)


def _rows_above(canvas: Canvas, slope: float) -> slice | None:
    """The rows that hold any direction steeper than ``slope`` (a rolled camera has slanting limits)."""
    direction = canvas.direction
    edge = direction[:, :: max(direction.shape[1] // 16, 1)]
    steep = (edge[..., 2] > slope * np.hypot(edge[..., 0], edge[..., 1])).any(axis=1)
    found = np.flatnonzero(steep)
    return slice(int(found[0]), int(found[-1]) + 1) if found.size else None
