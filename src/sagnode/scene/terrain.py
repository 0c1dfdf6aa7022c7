"""The ground: the true profile carried sideways, with grass, fields, a track and the surveyed roads."""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.scene.canvas import Canvas, normal_cdf
from sagnode.scene.light import Light
from sagnode.scene.noise import Float32, Floats, sample, tile
from sagnode.scene.spec import Scene, SpanFrame, ground_height
from sagnode.scene.truth import ground_and_obstacles

_SCALES = ((0.22, 14.0, 0.35, 20.0), (1.8, 9.0, 0.6, 30.0), (18.0, 9.0, 0.8, 64.0))
"""Texel (m), contrast (grey levels), slope and coarsest texels of the layers of grass, tufts and fields."""
_FAR_M = 6000.0


def paint_ground(canvas: Canvas, scene: Scene, frame: SpanFrame, light: Light) -> None:
    """Paint everything below the horizon.

    Args:
        canvas: the picture.
        scene: the scene; its true ground profile is used.
        frame: axes of the true span.
        light: and season.
    """
    along_direction = canvas.direction[..., 0]
    horizontal = np.hypot(along_direction, canvas.direction[..., 1])
    falling = canvas.direction[..., 2] < np.float32(-1.2 / _FAR_M) * horizontal
    rows = np.flatnonzero(falling.any(axis=1))
    if rows.size == 0:
        return
    window = slice(int(rows[0]), int(rows[-1]) + 1)
    direction = canvas.direction[window]
    falling, horizontal = falling[window], horizontal[window]
    origin = frame.to_span(canvas.pose.position)
    reach = _reach(scene, origin, direction, horizontal)
    along = np.float32(origin[0]) + direction[..., 0] / horizontal * reach
    across = np.float32(origin[1]) + direction[..., 1] / horizontal * reach
    pixel = reach * np.float32(1 / canvas.intrinsics.fx)
    height = max(float(origin[2]) - float(ground_height(scene.true, np.array([origin[0]]))[0]), 1.0)
    footprint = pixel * np.maximum(reach / np.float32(height), 1.0)
    grey = np.full(reach.shape, light.snowed(96.0 + 22.0 * light.bare, 0.9), np.float32)
    for k, (texel, contrast, fall, coarsest) in enumerate(_SCALES):
        weight = np.clip(np.float32(1.6) - footprint / np.float32(1.5 * texel), 0.0, 1.0)
        texture = tile(scene.seed, f"ground{k}", slope=fall, coarsest=coarsest, finest=2.2)
        layer = sample(texture, across / np.float32(texel), along / np.float32(texel))
        if k == 2:
            # fields: two crops with a border between them
            layer = np.tanh(layer * np.float32(2.5))
        grey += weight * np.float32(contrast * (0.75 + 0.5 * light.sun) * (1 - 0.6 * light.snow)) * layer
    grey += _strip(across - _track(along), 1.1, pixel) * (np.float32(138.0) - grey) * np.float32(0.8)
    for obstacle in scene.true.ground.obstacles:
        middle, half = sum(obstacle.along_m) / 2, (obstacle.along_m[1] - obstacle.along_m[0]) / 2
        grey += _strip(along - np.float32(middle), half, footprint) * (np.float32(128.0) - grey)
        grey += _strip(along - np.float32(middle), 0.08, footprint) * np.float32(60.0)
    slope = np.hypot(horizontal, direction[..., 2]) / horizontal
    grey = canvas.air.veil(grey, reach * slope)
    edge = np.clip(-direction[..., 2] / horizontal * np.float32(canvas.intrinsics.fx / 2), 0.0, 1.0)
    if scene.world.forest_m > 0:
        # the forest has been painted, and stands before the land behind it
        foot = np.float32(scene.world.horizon_m)
        edge *= np.clip((foot - reach) / np.maximum(footprint, np.float32(0.1)) + np.float32(0.5), 0.0, 1.0)
    target = canvas.grey[window]
    target += np.where(falling, edge, np.float32(0.0)) * (grey - target)


def _track(along: Floats) -> Float32:
    """Where the farm track runs: across, m."""
    return np.asarray(np.float32(-9.0) + np.float32(3.0) * np.sin(along / np.float32(55.0)), np.float32)


def _strip(offset: Floats, half_width: float, footprint: Floats) -> Float32:
    """Coverage of a strip of the ground seen with a footprint (m) per pixel."""
    s = footprint * np.float32(0.75)
    return np.asarray(
        normal_cdf((offset + np.float32(half_width)) / s) - normal_cdf((offset - np.float32(half_width)) / s)
    )


def _reach(scene: Scene, origin: FloatArray, direction: Floats, horizontal: Floats) -> Float32:
    """Horizontal distance (m) from the camera to the ground along every ray."""
    slope = direction[..., 2] / horizontal
    forward = direction[..., 0] / horizontal
    if float(np.min(np.abs(forward))) > 0.5:
        # Looking along the span: where a ray meets the ground depends on one number, its rise per metre along.
        sense = 1.0 if float(forward.flat[0]) > 0 else -1.0
        steps = np.concatenate([np.arange(0.5, 400.0, 0.25), np.geomspace(400.0, 2 * _FAR_M, 400)])
        ground = _surface(scene, origin[0] + sense * steps)
        rise = np.maximum.accumulate((ground - origin[2]) / steps)
        per_metre = slope / np.abs(forward)
        along = np.interp(per_metre, rise, steps).astype(np.float32)
        return np.asarray(along / np.abs(forward), np.float32)
    # Looking across it: the height changes slowly along a ray, and a few rounds settle it.
    fall = np.minimum(slope, np.float32(-1 / _FAR_M))
    reach = np.full(slope.shape, np.float32(origin[2] - ground_height(scene.true, origin[:1])[0])) / -fall
    for _ in range(3):
        height = _surface(scene, (np.float32(origin[0]) + forward * reach).astype(np.float64))
        wanted = np.float32(height - origin[2]) / fall
        reach = np.clip((reach + wanted) / 2, 0.3, _FAR_M).astype(np.float32)
    return np.asarray(reach, np.float32)


def _surface(scene: Scene, along: FloatArray) -> FloatArray:
    """The visible surface: the profile with its obstacles inside the span."""
    return ground_and_obstacles(scene.true, along)
