"""Trees and bushes: upright pictures with ragged crowns that turn towards the camera."""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray, project
from sagnode.scene.canvas import Canvas
from sagnode.scene.light import Light
from sagnode.scene.noise import generator, sample, tile
from sagnode.scene.spec import Scene, SpanFrame, Tree, ground_height


def country_trees(scene: Scene, frame: SpanFrame) -> list[Tree]:
    """The trees of a scene: its own, and those that its seed grows beside the corridor."""
    trees = list(scene.world.trees)
    if scene.world.backdrop != "country":
        return trees
    rng = generator(scene.seed, "trees")
    across = [float(c) for p in scene.true.conductors for c in frame.to_span(np.array([p.near, p.far]))[:, 1]]
    left, right = min(across) - 14.0, max(across) + 14.0
    camera = frame.to_span(np.array(scene.true.camera.position))
    left, right = min(left, camera[1] - 14.0), max(right, camera[1] + 14.0)
    marks = frame.to_span(np.array([m.position for m in scene.true.landmarks]).reshape(-1, 3))
    length = frame.length
    for _ in range(80):
        along = float(rng.uniform(0.15, 2.2)) * length
        if scene.world.forest_m > 0:
            along = min(along, float(rng.uniform(0.3, 0.95)) * scene.world.horizon_m)
        side = float(rng.random())
        away = float(rng.gamma(1.4, 22.0)) + scene.world.opening * along
        height = float(rng.uniform(3.0, 12.0)) if rng.random() < 0.55 else float(rng.uniform(0.8, 2.5))
        tree = Tree(
            along,
            left - away if side < 0.5 else right + away,
            height,
            height * float(rng.uniform(0.7, 1.1)),
            tone=float(rng.uniform(44.0, 74.0)),
        )
        if not _hides(tree, marks, camera):
            trees.append(tree)
    return trees


def _hides(tree: Tree, marks: FloatArray, camera: FloatArray) -> bool:
    """Whether a tree stands before a landmark, or so close behind it that leaves would crowd it."""
    away = float(np.hypot(tree.along_m - camera[0], tree.across_m - camera[1]))
    bearing = np.arctan2(tree.across_m - camera[1], tree.along_m - camera[0])
    for mark in marks:
        distance = float(np.hypot(mark[0] - camera[0], mark[1] - camera[1]))
        other = np.arctan2(mark[1] - camera[1], mark[0] - camera[0])
        if away < distance + 3.0 and abs(bearing - other) < (0.6 * tree.width_m + 1.0) / away + 0.012:
            return True
    return False


def draw_tree(canvas: Canvas, scene: Scene, frame: SpanFrame, tree: Tree, light: Light, seed: int) -> None:
    """Draw one tree with its crown from 15 % of its height upwards (a bush reaches the ground)."""
    origin = frame.to_span(canvas.pose.position)
    foot = np.array([tree.along_m, tree.across_m])
    offset = foot - origin[:2]
    distance = float(np.hypot(*offset))
    if distance < 0.3:
        return
    base = float(ground_height(scene.true, foot[:1])[0]) + tree.base_m
    towards = offset / distance
    sideways = np.array([-towards[1], towards[0]])
    half = 0.65 * tree.width_m
    corners = np.array(
        [[*(foot + k * half * sideways), base + z] for k in (-1.0, 1.0) for z in (-0.2, 1.1 * tree.height_m)]
    )
    pixels, depth = canvas.project(frame.to_site(corners))
    if np.any(depth < 0.1):
        return
    # Corners beyond what the lens model covers are far outside the frame: without distortion they are so as well.
    bare, _ = project(canvas.intrinsics.without_distortion(), canvas.pose, frame.to_site(corners))
    pixels = np.where(np.isfinite(pixels), pixels, np.clip(bare, -1e4, 1e4))
    where = canvas.window(pixels, 3.0)
    if where is None:
        return
    direction = canvas.direction[where]
    forward = direction[..., 0] * np.float32(towards[0]) + direction[..., 1] * np.float32(towards[1])
    scale = np.float32(distance) / np.maximum(forward, np.float32(1e-3))
    beside = (direction[..., 0] * np.float32(sideways[0]) + direction[..., 1] * np.float32(sideways[1])) * scale
    z = direction[..., 2] * scale + np.float32(origin[2] - base)
    bush = tree.height_m < 2.6
    low = 0.0 if bush else 0.15 * tree.height_m
    middle, tall = (low + tree.height_m) / 2, (tree.height_m - low) / 2
    pixel_m = distance / canvas.intrinsics.fx
    rng = generator(scene.seed, seed, "tree")
    shift = rng.uniform(0, 400, 4).astype(np.float32)
    clumps = tile(scene.seed, "crowns", slope=1.1, coarsest=24.0, finest=3.0)
    leaves = tile(scene.seed, "leaves", slope=0.7, coarsest=32.0, finest=3.0)
    texel = np.float32(max(tree.width_m / 26.0, 0.6 * pixel_m))
    lumps = sample(clumps, beside / texel + shift[0], z / texel + shift[1])
    x, y = beside / np.float32(tree.width_m / 2), (z - np.float32(middle)) / np.float32(tall)
    inside = 1 - np.sqrt(x * x + y * y) + np.float32(0.13) * lumps
    soft = np.float32(2.2 * canvas.psf_px * pixel_m / (tree.width_m / 2))
    cover = np.clip(inside / soft + np.float32(0.5), 0.0, 1.0)
    fine = sample(leaves, beside / np.float32(1.7 * pixel_m) + shift[2], z / np.float32(1.7 * pixel_m) + shift[3])
    contrast = min(0.16, 0.03 + 1.0 * pixel_m)
    tone = np.float32(light.snowed(tree.tone + 20.0 * light.bare, 0.5)) * (
        1 + np.float32(0.17) * lumps + np.float32(contrast) * fine
    )
    tone *= np.float32(0.78) + np.float32(0.32 * (0.4 + light.sun)) * np.clip(y + np.float32(0.4) * x, -1.0, 1.0)
    if not bush:
        trunk = (np.abs(beside) < 0.02 * tree.height_m) & (z > -0.2) & (z < middle)
        tone = np.where(trunk & (cover < 0.5), np.float32(48.0), tone)
        cover = np.maximum(cover, np.where(trunk, np.float32(min(1.0, 0.04 * tree.height_m / pixel_m)), 0.0))
    canvas.blend(where, np.asarray(cover, np.float32), np.maximum(tone, np.float32(8.0)), distance)
