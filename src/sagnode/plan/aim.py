"""Where to point a camera so that it sees most of the span and its landmarks."""

from __future__ import annotations

import numpy as np

from sagnode.config.span import Span
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, inside, project_camera, rotation_from_angles
from sagnode.geometry.conductor import conductor_points

Angles = tuple[float, float]
"""Azimuth and elevation, degrees."""

STEEPEST_DEG = 75.0
NEARLY = 0.15
"""Worth that a wanted direction may lack: of twice the share in view and 0.4 for all landmarks."""
_ROUNDS = ((13, 1.0), (9, 0.25), (9, 0.06))
"""Directions a side, and how much of the field of view they cover, from the first look to the last."""


def best_aim(span: Span, position: FloatArray, intrinsics: Intrinsics, wanted: Angles | None = None) -> Angles:
    """Azimuth and elevation of a level camera that shows as much as can be of every measured conductor.

    The share of a conductor is that of its horizontal length, at its least and its greatest sag; the worst of them
    counts as much as their mean. Landmarks count less, and being in the middle decides between equals. A wanted
    direction is kept unless another shows clearly more.
    """
    wires = _wires(span) - position
    marks = np.array([m.position for m in span.landmarks], dtype=float).reshape(-1, 3) - position
    everything = wires.reshape(-1, 3)
    distance = np.linalg.norm(everything, axis=1)
    # far points stand for the direction of the line; what passes over the lens would turn it upwards
    middle = np.average(everything / distance[:, None], axis=0, weights=np.minimum(distance, np.median(distance)))
    best = _angles(middle)
    field = np.degrees(2 * np.arctan([intrinsics.width / 2 / intrinsics.fx, intrinsics.height / 2 / intrinsics.fy]))
    for count, share in _ROUNDS:
        offsets = np.linspace(-share, share, count)
        trials = [
            (best[0] + da * field[0], float(np.clip(best[1] + de * field[1], -STEEPEST_DEG, STEEPEST_DEG)))
            for da in offsets
            for de in offsets
        ]
        best = max(trials, key=lambda angles: _worth(angles, wires, marks, intrinsics))
    if wanted is not None:
        kept, other = (_worth(angles, wires, marks, intrinsics) for angles in (wanted, best))
        if kept > other - NEARLY:
            return wanted
    return round(_half_turn(float(best[0])), 1), round(float(best[1]), 1)


def _wires(span: Span) -> FloatArray:
    """Points (K, N, 3) of every measured conductor at its least and at its greatest sag."""
    t = np.linspace(0.0, 1.0, 41)
    curves = []
    for conductor in span.conductors:
        if conductor.measured:
            near, far = np.array(conductor.near, dtype=float), np.array(conductor.far, dtype=float)
            sags = np.array([conductor.sag_min_m, conductor.sag_max_m])
            curves.append(conductor_points(near, far, sags, 0.0, t))
    return np.concatenate(curves)


def _angles(direction: FloatArray) -> Angles:
    x, y, z = direction
    return float(np.degrees(np.arctan2(x, y))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


def _half_turn(azimuth: float) -> float:
    """The same azimuth from -180 to 180."""
    return (azimuth + 180.0) % 360.0 - 180.0


def _worth(angles: Angles, wires: FloatArray, marks: FloatArray, intrinsics: Intrinsics) -> float:
    pose = Pose(rotation_from_angles(*angles, 0.0), np.zeros(3))
    pixels, _ = project_camera(intrinsics, wires @ pose.rotation.T)
    share = inside(intrinsics, pixels, 4.0).mean(axis=1)
    seen = np.count_nonzero(inside(intrinsics, project_camera(intrinsics, marks @ pose.rotation.T)[0], 20.0))
    # what is seen lies in the middle rather than at the edge, between directions that show equally much
    size = np.array([intrinsics.width, intrinsics.height])
    off = np.abs(pixels - (size - 1) / 2).max(axis=-1, initial=0.0, where=np.isfinite(pixels)) / size.max()
    centred = float(np.mean((1 - off) * inside(intrinsics, pixels, 4.0)))
    return float(share.min() + share.mean() + 0.4 * seen / max(len(marks), 1) + 0.1 * centred)
