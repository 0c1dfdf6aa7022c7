"""The camera: pinhole with OpenCV's distortion, and its pose in the site frame.

Camera frame (OpenCV's): x right, y down, z forward. Pixels: u right, v down, centres at integers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sagnode.native import kernels

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths, principal point (px) and distortion of a camera of ``width`` x ``height`` pixels.

    ``distortion`` is in OpenCV's order: ``k1 k2 p1 p2 [k3 [k4 k5 k6]]`` (pinhole), ``k1 k2 k3 k4`` (fisheye).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    model: Literal["pinhole", "fisheye"] = "pinhole"
    reach: float = 0.0
    """Largest normalised undistorted radius that is projected; 0 computes it, :func:`dataclasses.replace` keeps it."""

    def __post_init__(self) -> None:
        if self.reach == 0.0:
            object.__setattr__(self, "reach", field_radius(self))

    @property
    def matrix(self) -> FloatArray:
        """K, 3x3."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def packed(self) -> FloatArray:
        """All of it (17,), as compiled functions take it."""
        d = self.distortion
        kind = (self.model == "fisheye", any(d))
        lens = (self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.reach)
        return np.array([*kind, *lens, *(*d, *([0.0] * 8))[:8]], dtype=np.float64)

    def without_distortion(self) -> Intrinsics:
        """The same camera with a perfect lens (the paper's Table 8, "before correction")."""
        return replace(self, distortion=(), model="pinhole", reach=0.0)


@dataclass(frozen=True)
class Pose:
    """``x_camera = rotation @ (x_site - position)``: rotation 3x3, position of the centre of projection, metres."""

    rotation: FloatArray
    position: FloatArray


def rotation_from_angles(azimuth_deg: float, elevation_deg: float, roll_deg: float) -> FloatArray:
    """Site-to-camera rotation (3x3) of a camera that looks along azimuth and elevation.

    Azimuth is clockwise from +y (north) as on a compass, elevation up from the horizon, roll clockwise seen from
    behind the camera (the picture's content turns anticlockwise).
    """
    az, el, ro = np.radians([azimuth_deg, elevation_deg, roll_deg])
    forward = np.array([np.sin(az) * np.cos(el), np.cos(az) * np.cos(el), np.sin(el)])
    right = np.array([np.cos(az), -np.sin(az), 0.0])
    down = np.cross(forward, right)
    rolled_right = np.cos(ro) * right + np.sin(ro) * down
    rolled_down = np.cross(forward, rolled_right)
    return np.stack([rolled_right, rolled_down, forward])


def rotation_from_vector(rotation_vector: FloatArray) -> FloatArray:
    """Rodrigues' formula: rotation (3x3) by ``|v|`` radians about ``v`` (3,)."""
    x, y, z = (float(part) for part in rotation_vector)
    angle = math.sqrt(x * x + y * y + z * z)
    # I + a [v]x + b [v]x², and [v]x² = v vᵀ - |v|² I
    a, b = (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2) if angle > 1e-12 else (1.0, 0.0)
    return np.array(
        [
            [1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)],
        ]
    )


def turned(pose: Pose, rotation_vector: FloatArray, shift: FloatArray) -> Pose:
    """The pose after a small rotation in the camera frame (rad, 3) and a shift in the site frame (m, 3)."""
    return Pose(rotation_from_vector(rotation_vector) @ pose.rotation, pose.position + shift)


def distort(intrinsics: Intrinsics, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distorted normalised coordinates; OpenCV's pinhole and fisheye models, any matching shapes."""
    d = intrinsics.distortion
    if not any(d):
        return x, y
    r2 = x * x + y * y
    if intrinsics.model == "fisheye":
        r = np.sqrt(r2)
        theta = np.arctan(r)
        t2 = theta * theta
        k = (*d, 0.0, 0.0, 0.0, 0.0)[:4]
        theta_d = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        scale = np.where(r > 1e-12, theta_d / np.maximum(r, 1e-12), 1.0)
        return np.asarray(x * scale), np.asarray(y * scale)
    k1, k2, p1, p2, k3, k4, k5, k6 = (*d, *([0.0] * 8))[:8]
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if k4 or k5 or k6:
        radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    if not (p1 or p2):
        return np.asarray(x * radial), np.asarray(y * radial)
    xy = x * y
    xd = x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * xy
    return np.asarray(xd), np.asarray(yd)


def undistort(intrinsics: Intrinsics, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalised, undistorted coordinates of pixels, by Newton's method (to about 1e-10)."""
    xd = (u - intrinsics.cx) / intrinsics.fx
    yd = (v - intrinsics.cy) / intrinsics.fy
    if not any(intrinsics.distortion):
        return xd, yd
    x, y = xd, yd
    if intrinsics.model == "fisheye":
        # the distorted radius is nearly the angle from the axis
        radius = np.maximum(np.hypot(xd, yd), 1e-12)
        x, y = (c * np.tan(np.minimum(radius, 1.5)) / radius for c in (xd, yd))
    for _ in range(30):
        step = 1e-7 * (1 + np.hypot(x, y))
        ex, ey = distort(intrinsics, x, y)
        (ax, ay), (bx, by) = distort(intrinsics, x + step, y), distort(intrinsics, x, y + step)
        xx, yx, xy, yy = (ax - ex) / step, (ay - ey) / step, (bx - ex) / step, (by - ey) / step
        determinant = xx * yy - xy * yx
        # where the polynomial folds back there is no way on; creep instead of jumping
        determinant = np.where(np.abs(determinant) < 1e-3, 1.0, determinant)
        rx, ry = xd - ex, yd - ey
        dx, dy = (yy * rx - xy * ry) / determinant, (xx * ry - yx * rx) / determinant
        limit = 0.5 * (1 + np.hypot(x, y))
        scale = np.minimum(1.0, limit / np.maximum(np.hypot(dx, dy), 1e-300))
        x, y = x + scale * dx, y + scale * dy
        if float(np.max(np.hypot(dx, dy), initial=0.0)) < 1e-13:
            break
    return np.asarray(x), np.asarray(y)


def field_radius(intrinsics: Intrinsics) -> float:
    """Largest normalised undistorted radius inside the frame, with 10 % to spare.

    Beyond it a distortion polynomial may fold back into the frame, so nothing is projected there by a lens that has one
    (or is given one by an estimate of k1: the slightest folds back what passes close to the camera).
    """
    w, h = intrinsics.width - 1, intrinsics.height - 1
    edge = np.linspace(0.0, 1.0, 9)
    u = np.concatenate([edge * w, edge * w, np.zeros(9), np.full(9, w)])
    v = np.concatenate([np.zeros(9), np.full(9, h), edge * h, edge * h])
    x, y = undistort(intrinsics, u, v)
    return 1.1 * float(np.max(np.hypot(x, y)))


def project(intrinsics: Intrinsics, pose: Pose, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (..., 2) and depths (...) of points (..., 3) of the site frame.

    Points behind the camera, or beyond the lens's reach, become NaN pixels.
    """
    if kernels is not None:
        places = np.ascontiguousarray(points, dtype=np.float64)
        flat = places.reshape(-1, 3)
        own = (np.asarray(part, dtype=np.float64) for part in (pose.rotation, pose.position))
        pixels, depth = np.empty((len(flat), 2)), np.empty(len(flat))
        kernels.project(intrinsics.packed, *own, flat, pixels, depth)
        return pixels.reshape(*places.shape[:-1], 2), depth.reshape(places.shape[:-1])
    return project_camera(intrinsics, (points - pose.position) @ pose.rotation.T)


def project_camera(intrinsics: Intrinsics, camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (..., 2) and depths (...) of points (..., 3) of the camera frame, as :func:`project`."""
    depth = camera[..., 2]
    ahead = depth > 1e-9
    every = bool(ahead.all())
    safe = depth if every else np.where(ahead, depth, 1.0)
    x, y = camera[..., 0] / safe, camera[..., 1] / safe
    if any(intrinsics.distortion):
        within = x * x + y * y <= intrinsics.reach**2
        if not within.all():
            ahead, every = ahead & within, False
            x, y = np.where(ahead, x, 0.0), np.where(ahead, y, 0.0)
        x, y = distort(intrinsics, x, y)
    pixels = np.empty((*depth.shape, 2))
    pixels[..., 0] = intrinsics.fx * x + intrinsics.cx
    pixels[..., 1] = intrinsics.fy * y + intrinsics.cy
    if not every:
        pixels[~ahead] = np.nan
    return pixels, depth


def place_derivatives(intrinsics: Intrinsics, pose: Pose, points: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 3) of the pixels of points (N, 3), all of them in view, by their place in the site frame."""
    camera = (points - pose.position) @ pose.rotation.T
    return np.asarray(_by_own_place(intrinsics, camera)[0] @ pose.rotation)


def _by_own_place(intrinsics: Intrinsics, camera: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives (N, 2, 3) of pixels by places (N, 3) in the camera's frame; and those through the lens, x and y."""
    z = camera[:, 2]
    x, y = camera[:, 0] / z, camera[:, 1] / z
    step = 1e-6
    # here, and a step aside in x and in y, in one call
    all_x, all_y = distort(intrinsics, np.stack([x, x + step, x]), np.stack([y, y, y + step]))
    xd, yd = all_x[0], all_y[0]
    by_x, by_y = (((all_x[k] - xd) / step, (all_y[k] - yd) / step) for k in (1, 2))
    focal = (intrinsics.fx, intrinsics.fy)
    by_camera = np.empty((len(camera), 2, 3))
    for row in range(2):
        dx, dy = focal[row] * by_x[row], focal[row] * by_y[row]
        by_camera[:, row, 0], by_camera[:, row, 1] = dx / z, dy / z
        by_camera[:, row, 2] = -(dx * x + dy * y) / z
    return by_camera, xd, yd


def projection_derivatives(intrinsics: Intrinsics, pose: Pose, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the pixels of points (N, 3), all of them in view.

    Returns:
        By the point's place in the site frame (N, 2, 3), px/m; and by the camera's ten parameters (N, 2, 10): turn
        (rad, camera frame), shift (m, site frame), relative focal length, principal point (px), k1.
    """
    camera = (points - pose.position) @ pose.rotation.T
    by_camera, xd, yd = _by_own_place(intrinsics, camera)
    by_point = by_camera @ pose.rotation
    parameters = np.zeros((len(points), 2, 10))
    # a turn by v moves the point by v x camera
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        parameters[:, :, i] = camera[:, None, j] * by_camera[:, :, k] - camera[:, None, k] * by_camera[:, :, j]
    parameters[:, :, 3:6] = -by_point
    parameters[:, 0, 6], parameters[:, 1, 6] = intrinsics.fx * xd, intrinsics.fy * yd
    parameters[:, 0, 7] = parameters[:, 1, 8] = 1.0
    if intrinsics.model == "pinhole":
        x, y = camera[:, 0] / camera[:, 2], camera[:, 1] / camera[:, 2]
        r2 = x * x + y * y
        parameters[:, 0, 9], parameters[:, 1, 9] = intrinsics.fx * x * r2, intrinsics.fy * y * r2
    return by_point, parameters


def inside(intrinsics: Intrinsics, pixels: FloatArray, margin: float = 0.0) -> NDArray[np.bool_]:
    """Which pixels (..., 2) lie in the frame, at least ``margin`` px from its edge; NaN is outside."""
    u, v = pixels[..., 0], pixels[..., 1]
    with np.errstate(invalid="ignore"):
        result: NDArray[np.bool_] = (
            (u >= margin) & (v >= margin) & (u <= intrinsics.width - 1 - margin) & (v <= intrinsics.height - 1 - margin)
        )
    return result
