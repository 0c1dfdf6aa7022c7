"""The camera: pinhole with OpenCV's distortion, and its pose in the site frame.

Camera frame (OpenCV's): x right, y down, z forward. Pixels: u right, v down, centres at integers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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

    @property
    def matrix(self) -> FloatArray:
        """K, 3x3."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def without_distortion(self) -> Intrinsics:
        """The same camera with a perfect lens (the paper's Table 8, "before correction")."""
        return replace(self, distortion=(), model="pinhole")


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
    angle = float(np.linalg.norm(rotation_vector))
    x, y, z = rotation_vector
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-12:
        return np.asarray(np.eye(3) + skew)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * skew + (1 - np.cos(angle)) / angle**2 * skew @ skew)


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
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy = x * y
    xd = x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * xy
    return np.asarray(xd), np.asarray(yd)


def undistort(intrinsics: Intrinsics, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalised, undistorted coordinates of pixels, by fixed-point and Newton-like iteration (to about 1e-10)."""
    xd = (u - intrinsics.cx) / intrinsics.fx
    yd = (v - intrinsics.cy) / intrinsics.fy
    if not any(intrinsics.distortion):
        return xd, yd
    x, y = xd.copy(), yd.copy()
    for _ in range(40):
        ex, ey = distort(intrinsics, x, y)
        dx, dy = xd - ex, yd - ey
        x, y = x + dx, y + dy
        if max(float(np.max(np.abs(dx), initial=0.0)), float(np.max(np.abs(dy), initial=0.0))) < 1e-12:
            break
    return x, y


def field_radius(intrinsics: Intrinsics) -> float:
    """Largest normalised undistorted radius inside the frame, with 10 % to spare.

    Beyond it a distortion polynomial may fold back into the frame, so nothing is projected there.
    """
    w, h = intrinsics.width - 1, intrinsics.height - 1
    edge = np.linspace(0.0, 1.0, 9)
    u = np.concatenate([edge * w, edge * w, np.zeros(9), np.full(9, w)])
    v = np.concatenate([np.zeros(9), np.full(9, h), edge * h, edge * h])
    x, y = undistort(intrinsics, u, v)
    return 1.1 * float(np.max(np.hypot(x, y)))


def project(intrinsics: Intrinsics, pose: Pose, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (..., 2) and depths (...) of points (..., 3) of the site frame.

    Points behind the camera, or beyond :func:`field_radius` of a lens with distortion, become NaN pixels.
    """
    camera = (points - pose.position) @ pose.rotation.T
    depth = camera[..., 2]
    ahead = depth > 1e-9
    safe = np.where(ahead, depth, 1.0)
    x, y = camera[..., 0] / safe, camera[..., 1] / safe
    if any(intrinsics.distortion):
        ahead = ahead & (x * x + y * y <= field_radius(intrinsics) ** 2)
        x, y = distort(intrinsics, np.where(ahead, x, 0.0), np.where(ahead, y, 0.0))
    pixels = np.stack([intrinsics.fx * x + intrinsics.cx, intrinsics.fy * y + intrinsics.cy], axis=-1)
    return np.where(ahead[..., None], pixels, np.nan), depth


def inside(intrinsics: Intrinsics, pixels: FloatArray, margin: float = 0.0) -> NDArray[np.bool_]:
    """Which pixels (..., 2) lie in the frame, at least ``margin`` px from its edge; NaN is outside."""
    u, v = pixels[..., 0], pixels[..., 1]
    with np.errstate(invalid="ignore"):
        result: NDArray[np.bool_] = (
            (u >= margin) & (v >= margin) & (u <= intrinsics.width - 1 - margin) & (v <= intrinsics.height - 1 - margin)
        )
    return result
