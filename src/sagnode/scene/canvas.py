r"""The picture while it is painted: linear greys, the distance of what stands there, and exact anti-aliased shapes.

Shapes are painted as the camera would see them through its point spread (a Gaussian of standard deviation s): a band
of width w at the distance d of a pixel covers ``Φ((d + w/2)/s) - Φ((d - w/2)/s)`` of it, whatever fraction of a pixel
w is.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, project, undistort
from sagnode.scene.noise import Float32, Floats

_TABLE_STEP = 1 / 512
_TABLE_END = 6.0


def _normal_cdf_table() -> Float32:
    x = np.arange(-_TABLE_END, _TABLE_END + _TABLE_STEP, _TABLE_STEP)
    density = np.exp(-x * x / 2) / np.sqrt(2 * np.pi)
    # Simpson's rule on a fine grid; error below 1e-8
    middle = np.exp(-((x[:-1] + _TABLE_STEP / 2) ** 2) / 2) / np.sqrt(2 * np.pi)
    steps = (density[:-1] + 4 * middle + density[1:]) / 6 * _TABLE_STEP
    return np.asarray(np.concatenate([[0.0], np.cumsum(steps)]), dtype=np.float64).astype(np.float32)


class _Cdf:
    table: Float32 | None = None


def normal_cdf(x: Floats) -> Float32:
    """Φ(x) by table and linear interpolation (absolute error below 1e-6), any shape."""
    if _Cdf.table is None:
        _Cdf.table = _normal_cdf_table()
    table = _Cdf.table
    position = np.clip((np.asarray(x, dtype=np.float32) + _TABLE_END) / _TABLE_STEP, 0, len(table) - 2)
    index = position.astype(np.int32)
    low = table[index]
    return np.asarray(low + (table[index + 1] - low) * (position - index), dtype=np.float32)


def normal_pdf(x: Floats) -> Float32:
    """φ(x), any shape."""
    return np.asarray(np.exp(-0.5 * np.asarray(x, dtype=np.float32) ** 2) / np.float32(np.sqrt(2 * np.pi)))


@dataclass(frozen=True)
class Rays:
    """Direction of every raw pixel in the camera frame, (H, W, 3) float32 with z = 1, and its pixel coordinates."""

    camera: Float32
    u: Float32
    v: Float32


_RAYS: dict[Intrinsics, Rays] = {}


def rays_of(intrinsics: Intrinsics) -> Rays:
    """The rays of a camera; kept for the few cameras that a process uses."""
    if intrinsics not in _RAYS:
        if len(_RAYS) >= 4:
            _RAYS.pop(next(iter(_RAYS)))
        v, u = np.mgrid[0 : intrinsics.height, 0 : intrinsics.width].astype(np.float64)
        x, y = undistort(intrinsics, u, v)
        camera = np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)
        _RAYS[intrinsics] = Rays(camera, u.astype(np.float32), v.astype(np.float32))
    return _RAYS[intrinsics]


@dataclass(frozen=True)
class Air:
    """What the air does to colours: extinction per metre towards the grey of the horizon."""

    extinction_per_m: float
    light: float

    def veil(self, grey: Floats | float, distance: Floats | float) -> Float32:
        """Grey after ``distance`` metres of air."""
        clear = np.exp(-np.float32(self.extinction_per_m) * np.asarray(distance, dtype=np.float32))
        return np.asarray(np.float32(self.light) + (np.asarray(grey, np.float32) - np.float32(self.light)) * clear)


@dataclass(frozen=True)
class Canvas:
    """The picture in linear grey levels and the distance (m) of opaque things in it.

    ``direction`` holds the direction of every pixel in span coordinates (along, across, up), not normalised.
    """

    grey: Float32
    distance: Float32
    direction: Float32
    intrinsics: Intrinsics
    pose: Pose
    psf_px: float
    air: Air

    @classmethod
    def blank(cls, intrinsics: Intrinsics, pose: Pose, span_rotation: FloatArray, psf_px: float, air: Air) -> Canvas:
        """An empty picture of a camera at ``pose``; ``span_rotation`` is site to span coordinates (3x3)."""
        shape = (intrinsics.height, intrinsics.width)
        turn = (pose.rotation @ span_rotation.T).astype(np.float32)
        rays = rays_of(intrinsics).camera
        direction = cv2.transform(rays, np.ascontiguousarray(turn.T))
        return cls(
            np.full(shape, air.light, np.float32),
            np.full(shape, np.inf, np.float32),
            np.asarray(direction, dtype=np.float32),
            intrinsics,
            pose,
            psf_px,
            air,
        )

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Raw pixels (N, 2) and depths (N,) of site points (N, 3); NaN behind the camera."""
        return project(self.intrinsics, self.pose, points)

    def window(self, pixels: FloatArray, margin: float) -> tuple[slice, slice] | None:
        """Rows and columns around pixels (N, 2), or None if they miss the frame (or are not finite)."""
        if not np.all(np.isfinite(pixels)):
            return None
        low = np.floor(pixels.min(axis=0) - margin).astype(int)
        high = np.ceil(pixels.max(axis=0) + margin).astype(int) + 1
        rows = slice(max(int(low[1]), 0), min(int(high[1]), self.intrinsics.height))
        columns = slice(max(int(low[0]), 0), min(int(high[0]), self.intrinsics.width))
        return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None

    def blend(self, where: tuple[slice, slice], cover: Floats, grey: Floats | float, distance: float) -> None:
        """Lay ``grey``, seen through ``distance`` metres of air, over a window by its coverage (0 to 1)."""
        target = self.grey[where]
        target += cover * (self.air.veil(grey, distance) - target)
        held = self.distance[where]
        np.copyto(held, np.asarray(distance, np.float32), where=cover > 0.5)

    def segment(
        self, ends: FloatArray, width_m: float, grey: float, *, opaque: bool = True, minimum_px: float = 0.0
    ) -> None:
        """A straight bar between two site points (2, 3) of physical width; skipped where it passes the camera plane."""
        pixels, depths = self.project(ends)
        if not (np.all(depths > 0.3) and np.all(np.isfinite(pixels))):
            return
        depth = float(depths.mean())
        width = max(width_m * (self.intrinsics.fx + self.intrinsics.fy) / 2 / depth, minimum_px)
        where = self.window(pixels, width / 2 + 4 * self.psf_px)
        if where is None:
            return
        rays = rays_of(self.intrinsics)
        (u0, v0), (u1, v1) = pixels
        length = max(float(np.hypot(u1 - u0, v1 - v0)), 1e-6)
        cu, cv = np.float32((u1 - u0) / length), np.float32((v1 - v0) / length)
        du, dv = rays.u[where] - np.float32(u0), rays.v[where] - np.float32(v0)
        along, beside = du * cu + dv * cv, du * cv - dv * cu
        s = np.float32(self.psf_px)
        cover = normal_cdf((beside + np.float32(width / 2)) / s) - normal_cdf((beside - np.float32(width / 2)) / s)
        cover *= normal_cdf(along / s) - normal_cdf((along - np.float32(length)) / s)
        if opaque:
            self.blend(where, cover, grey, depth)
        else:
            target = self.grey[where]
            target += cover * (self.air.veil(grey, depth) - target)

    def polygon(self, corners: FloatArray, grey: float) -> None:
        """A convex plane polygon of site points (N, 3), either sense of rotation."""
        covered = self._covered(corners)
        if covered is not None:
            where, cover, depth = covered
            self.blend(where, cover, grey, depth)

    def shade(self, corners: FloatArray, factor: float) -> None:
        """Darken a convex plane polygon of site points (N, 3) by a factor."""
        covered = self._covered(corners)
        if covered is not None:
            where, cover, _ = covered
            self.grey[where] *= 1 - cover * np.float32(1 - factor)

    def _covered(self, corners: FloatArray) -> tuple[tuple[slice, slice], Float32, float] | None:
        """Window, coverage and depth of a convex polygon; None where nothing of it is seen."""
        pixels, depths = self.project(corners)
        if not (np.all(depths > 0.3) and np.all(np.isfinite(pixels))):
            return None
        where = self.window(pixels, 4 * self.psf_px)
        if where is None:
            return None
        rays = rays_of(self.intrinsics)
        following = np.roll(pixels, -1, axis=0)
        area = float(np.sum(pixels[:, 0] * following[:, 1] - following[:, 0] * pixels[:, 1]))
        sense = np.float32(1.0 if area > 0 else -1.0)
        cover = np.ones(rays.u[where].shape, np.float32)
        for (u0, v0), (u1, v1) in zip(pixels, following, strict=True):
            length = float(np.hypot(u1 - u0, v1 - v0))
            if length < 1e-6:
                continue
            nu, nv = sense * np.float32(-(v1 - v0) / length), sense * np.float32((u1 - u0) / length)
            inwards = (rays.u[where] - np.float32(u0)) * nu + (rays.v[where] - np.float32(v0)) * nv
            cover *= normal_cdf(inwards / np.float32(self.psf_px))
        return where, cover, float(depths.mean())


def hull(points: FloatArray) -> NDArray[np.intp]:
    """Indices of the convex hull of points (N, 2) in order (monotone chain)."""
    order = np.lexsort((points[:, 1], points[:, 0]))

    def chain(indices: NDArray[np.intp]) -> list[int]:
        kept: list[int] = []
        for i in indices:
            while len(kept) >= 2:
                a, b = points[kept[-2]], points[kept[-1]]
                if (b[0] - a[0]) * (points[i][1] - a[1]) - (b[1] - a[1]) * (points[i][0] - a[0]) > 0:
                    break
                kept.pop()
            kept.append(int(i))
        return kept[:-1]

    return np.array(chain(order) + chain(order[::-1]), dtype=np.intp)
