"""Wires: bands of physical diameter along densely projected exact curves, in the raw picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.config.span import Conductor
from sagnode.geometry.camera import FloatArray
from sagnode.scene.canvas import Canvas, normal_cdf, normal_pdf
from sagnode.scene.catenary import PartialLoad, PointLoad, WireState, wire_points
from sagnode.scene.noise import Float32, Floats, generator

STEP_PX = 1.0
"""Spacing of the polyline; on a bend of 20 px radius it departs from the curve by 0.006 px."""
Indices = NDArray[np.intp]
ACROSS = (np.arange(64) + 0.5) / 32 - 1
"""Places across a wire, of its half width, where its light is worked out."""
REACH_M = 0.6
"""Wires nearer to the camera than this are not drawn (a pinhole has no near focus)."""


@dataclass(frozen=True)
class WireLook:
    """Greys of a wire before the air: seen against the light, and lit by sky and sun from above."""

    shade: float
    lit: float
    sunlit: float = 0.0
    """By how much the sun brightens what of a wire faces it; 0 for a wire that is alike across."""
    towards: FloatArray | None = None
    """Unit vector to the sun, site frame (3,)."""


@dataclass(frozen=True)
class Seen:
    """How a wire came out in the picture, at points along it, one pixel apart, in the frame and behind nothing."""

    place: FloatArray
    """Fraction of the horizontal span (N,)."""
    share: FloatArray
    """Share of the span (N,) that every point stands for."""
    difference: Floats
    """Its grey minus that of what is behind it (N,), linear greys; what the air leaves of it."""
    width: Floats
    """Its width (N,), px."""
    background: Floats
    """What is behind it (N,), linear greys."""

    def contrast(self, psf_px: float) -> Floats:
        """Difference of its middle in the picture from what is behind it (N,), linear greys, never negative."""
        return np.abs(self.cover(psf_px) * self.difference)

    def cover(self, psf_px: float) -> Floats:
        """How much of its middle is wire and not what is behind it (N,), once blurred."""
        return np.asarray(2 * normal_cdf(self.width / np.float32(2 * psf_px)) - 1)


_UNSEEN = Seen(np.zeros(0), np.zeros(0), *(np.zeros(0, np.float32),) * 3)


def sub_conductor_offsets(conductor: Conductor) -> FloatArray:
    """Places (N, 2) of the sub-conductors about the bundle's centre line: (across, up), m."""
    side = conductor.bundle_spacing_m
    half = side / 2
    layouts: dict[int, list[tuple[float, float]]] = {
        1: [(0.0, 0.0)],
        2: [(-half, 0.0), (half, 0.0)],
        3: [(-half, side / np.sqrt(12)), (half, side / np.sqrt(12)), (0.0, -side / np.sqrt(3))],
        4: [(-half, -half), (half, -half), (-half, half), (half, half)],
    }
    return np.array(layouts[conductor.sub_conductors])


def draw_conductor(
    canvas: Canvas, conductor: Conductor, state: WireState, look: WireLook, seed: int
) -> tuple[Seen, ...]:
    """Draw one conductor with all its sub-conductors, and say how each of them came out."""
    near, far = np.array(conductor.near), np.array(conductor.far)
    chord = far - near
    across = np.array([chord[1], -chord[0], 0.0]) / np.hypot(chord[0], chord[1])
    seen: list[Seen] = []
    for k, (side, up) in enumerate(sub_conductor_offsets(conductor)):
        shift = side * across + np.array([0.0, 0.0, up])
        seen.append(draw_wire(canvas, near + shift, far + shift, state, conductor.diameter_m, look, [seed, k]))
    for load in state.loads:
        if isinstance(load, PointLoad) and load.size_m > 0:
            place = wire_points(near, far, state, np.array([load.at]))[0]
            below = place - np.array([0.0, 0.0, load.size_m])
            canvas.segment(np.stack([place, below]), 0.5 * load.size_m, look.shade)
    return tuple(seen)


def draw_wire(
    canvas: Canvas,
    near: FloatArray,
    far: FloatArray,
    state: WireState,
    diameter_m: float,
    look: WireLook,
    seed: list[int],
) -> Seen:
    """Draw one wire; things that stand nearer (trees, buildings) hide it."""
    curve = _Polyline.of(canvas, near, far, state)
    if curve is None:
        return _UNSEEN
    focal = (canvas.intrinsics.fx + canvas.intrinsics.fy) / 2
    width = (focal * diameter_m / curve.depth + focal * _sleeve(curve.s, state) / curve.depth).astype(np.float32)
    grey = _greys(canvas, curve, look, seed)
    reach = width / 2 + 3.5 * canvas.psf_px
    seen = _seen(canvas, curve, width, grey)
    row, column, segment, beside = _nearest(canvas, curve, reach)
    if row.size == 0:
        return _UNSEEN
    s = np.float32(canvas.psf_px)
    half = width[segment] / 2
    cover = normal_cdf((beside + half) / s) - normal_cdf((beside - half) / s)
    free = canvas.distance[row, column] > curve.depth[segment]
    background = canvas.grey[row, column]
    painted = background + free * cover * (grey[segment] - background)
    if look.sunlit and look.towards is not None:
        lit_side = _lit_side(canvas, curve, look.sunlit, look.towards)[segment]
        ramp = (beside * cover + s * (normal_pdf((beside + half) / s) - normal_pdf((beside - half) / s))) / half
        painted += free * ramp * lit_side
    canvas.grey[row, column] = painted
    return seen


def _seen(canvas: Canvas, curve: _Polyline, width: Floats, grey: Floats) -> Seen:
    """What can be seen of a wire, before it is drawn."""
    column, row = np.rint(curve.pixels).astype(int).T
    kept = (column >= 0) & (column < canvas.intrinsics.width) & (row >= 0) & (row < canvas.intrinsics.height)
    kept[kept] = canvas.distance[row[kept], column[kept]] > curve.depth[kept]
    background = canvas.grey[row[kept], column[kept]]
    return Seen(curve.s[kept], curve.share[kept], grey[kept] - background, width[kept], background)


def _sleeve(s: FloatArray, state: WireState) -> Float32:
    """By how much ice makes the wire thicker (N,) at the fractions ``s``, m."""
    sleeve = np.zeros(s.shape, np.float32)
    for load in state.loads:
        if isinstance(load, PartialLoad):
            sleeve[(s >= load.start) & (s <= load.end)] += np.float32(load.sleeve_m)
    return sleeve


@dataclass(frozen=True)
class _Polyline:
    """A projected curve: pixels (N, 2), depth (N,), view elevation (N,) rad, share of the span per point (N,)."""

    points: FloatArray
    """Site frame (N, 3), m."""
    pixels: FloatArray
    depth: Float32
    elevation: Float32
    s: FloatArray
    share: FloatArray
    joined: NDArray[np.bool_]
    """Whether point i is joined to point i + 1 (the curve may leave the frame and return)."""

    @classmethod
    def of(cls, canvas: Canvas, near: FloatArray, far: FloatArray, state: WireState) -> _Polyline | None:
        size = max(canvas.intrinsics.width, canvas.intrinsics.height)
        coarse = np.linspace(0.0, 1.0, 4001)
        pixels, _ = canvas.project(wire_points(near, far, state, coarse))
        steps = np.hypot(*np.diff(pixels, axis=0).T)
        # Far outside the frame nothing is resolved; a step there counts little.
        outside = np.max(np.abs(pixels[:-1] - size / 2), axis=1) > 1.5 * size
        steps = np.where(np.isfinite(steps) & ~outside, steps, 0.0)
        length = np.concatenate([[0.0], np.cumsum(steps)])
        if length[-1] < 1:
            return None
        wanted = np.arange(0.0, length[-1], STEP_PX)
        rising = np.concatenate([[True], np.diff(length) > 0])
        s = np.interp(wanted, length[rising], coarse[rising])
        points = wire_points(near, far, state, s)
        pixels, depth = canvas.project(points)
        w, h = canvas.intrinsics.width, canvas.intrinsics.height
        with np.errstate(invalid="ignore"):
            kept = (depth > REACH_M) & (pixels[:, 0] > -60) & (pixels[:, 0] < w + 60)
            kept &= (pixels[:, 1] > -60) & (pixels[:, 1] < h + 60)
        if kept.sum() < 2:
            return None
        offset = points - canvas.pose.position
        elevation = np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1]))
        index = np.flatnonzero(kept)
        share = np.gradient(s)[index]
        return cls(
            points[index],
            pixels[index],
            np.linalg.norm(offset, axis=1)[index].astype(np.float32),
            elevation[index].astype(np.float32),
            s[index],
            share,
            np.append(np.diff(index) == 1, False),
        )


def _greys(canvas: Canvas, curve: _Polyline, look: WireLook, seed: list[int]) -> Float32:
    """Grey of the wire at every point: dark where one looks up at its shaded side, lit where one looks down at it."""
    lit = 0.5 - 0.5 * np.tanh((curve.elevation - np.float32(0.012)) / np.float32(0.035))
    rng = generator(*seed, "wire")
    waves = sum(
        np.sin(2 * np.pi * (k * curve.s + rng.random())) * rng.standard_normal() / np.sqrt(k) for k in (3, 7, 13, 29)
    )
    grey = look.shade + (look.lit - look.shade) * lit * (1 + 0.12 * np.tanh(waves))
    return canvas.air.veil(grey.astype(np.float32), curve.depth)


def _lit_side(canvas: Canvas, curve: _Polyline, sunlit: float, towards: FloatArray) -> Float32:
    """By how much more a wire is lit at its edge than in its middle, towards :func:`_nearest`'s positive side (N,).

    That of a matt cylinder (Lambert). Only what is not alike on both sides is taken, as a slope.
    """
    along = np.gradient(curve.points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    in_picture = np.gradient(curve.pixels, axis=0)
    right, down = canvas.pose.rotation[:2]
    beside = in_picture[:, 1, None] * right - in_picture[:, 0, None] * down
    facing = canvas.pose.position - curve.points

    def sun_on(side: FloatArray) -> FloatArray:
        across = side - np.sum(side * along, axis=1)[:, None] * along
        return np.asarray(across @ towards / np.maximum(np.linalg.norm(across, axis=1), 1e-12))

    on_beside, on_facing = sun_on(beside), sun_on(facing)
    light = np.maximum(on_facing[:, None] * np.sqrt(1 - ACROSS**2) + on_beside[:, None] * ACROSS, 0.0)
    slope = light @ ACROSS / (ACROSS @ ACROSS)
    bright = (sunlit * slope).astype(np.float32)
    return canvas.air.veil(bright, curve.depth) - canvas.air.veil(np.zeros_like(bright), curve.depth)


def _nearest(canvas: Canvas, curve: _Polyline, reach: Floats) -> tuple[Indices, Indices, Indices, Float32]:
    """Every pixel within reach of the curve once: row, column, nearest segment, signed distance (px)."""
    w, h = canvas.intrinsics.width, canvas.intrinsics.height
    rows, columns, segments, distances = [], [], [], []
    start = np.flatnonzero(curve.joined)
    # Segments of about the same reach are treated together, so that thin far parts do not pay for the near ones.
    size = np.ceil(reach[start] + STEP_PX).astype(int)
    for radius in np.unique(size):
        chosen = start[size == radius]
        window = np.arange(-radius, radius + 1)
        dv, du = (g.ravel() for g in np.meshgrid(window, window, indexing="ij"))
        a, b = curve.pixels[chosen], curve.pixels[chosen + 1]
        centre = np.rint(a).astype(int)
        column = centre[:, 0, None] + du
        row = centre[:, 1, None] + dv
        ab = b - a
        length = np.maximum(np.hypot(ab[:, 0], ab[:, 1]), 1e-9)[:, None]
        pu, pv = column - a[:, 0, None], row - a[:, 1, None]
        cu, cv = ab[:, 0, None] / length, ab[:, 1, None] / length
        along = np.clip(pu * cu + pv * cv, 0.0, length)
        beside = pu * cv - pv * cu
        distance = np.copysign(np.hypot(pu - along * cu, pv - along * cv), beside)
        good = (np.abs(distance) <= radius) & (column >= 0) & (column < w) & (row >= 0) & (row < h)
        rows.append(row[good])
        columns.append(column[good])
        segments.append(np.broadcast_to(chosen[:, None], good.shape)[good])
        distances.append(distance[good].astype(np.float32))
    if not any(found.size for found in rows):
        none = np.zeros(0, np.intp)
        return none, none, none, np.zeros(0, np.float32)
    row, column = np.concatenate(rows), np.concatenate(columns)
    segment, distance = np.concatenate(segments), np.concatenate(distances)
    pixel = row * w + column
    order = np.lexsort((segment, np.abs(distance), pixel))
    first = order[np.concatenate([[True], np.diff(pixel[order]) > 0])]
    return row[first], column[first], segment[first], distance[first]
