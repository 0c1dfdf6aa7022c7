r"""Quadratic Bézier curves in the picture (sections 3.2.3 and 3.2.4).

::

    P0 *                         * P2      B(t) = (1-t)² P0 + 2(1-t)t P1 + t² P2
        \ `--.           .--' /
         \    `--._.__.-'    /             v grows downwards, so the lowest point has the greatest v
          \       B(t*)     /
           `------ P1 -----'
"""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray

SETTLED_PX = 1e-3
"""A step of P1 this short moves no template pixel."""


def bezier_points(control: FloatArray, t: FloatArray) -> FloatArray:
    """Points (N, 2) of the quadratic Bézier curve with control points (3, 2) at parameters (N,): equation 4."""
    s = t[:, None]
    return np.asarray((1 - s) ** 2 * control[0] + 2 * (1 - s) * s * control[1] + s**2 * control[2])


def stationary_parameters(control: FloatArray) -> tuple[float | None, float | None]:
    """The two solutions of B'(t) = 0, ``t = (P0 - P1)/(P0 - 2P1 + P2)``, by x and by y; None outside 0 ≤ t ≤ 1.

    The paper discards "one solution lying outside this valid domain". Both may lie in it (a curve that also turns back
    in x), and a component that is linear in t has none.
    """
    result: list[float | None] = []
    for p0, p1, p2 in control.T:
        curvature = p0 - 2 * p1 + p2
        t = (p0 - p1) / curvature if abs(curvature) > 1e-12 * (1 + abs(p1)) else np.inf
        result.append(float(t) if 0 <= t <= 1 else None)
    return result[0], result[1]


def lowest_point(control: FloatArray) -> FloatArray:
    """Pixel (2,) of the lowest point of the curve in the picture.

    It is the y solution of B'(t) = 0 where that is a lowest, not a highest, point; otherwise the lower end point, since
    a curve that falls all the way has its lowest point there.
    """
    candidates = [control[0], control[2]]
    _, t = stationary_parameters(control)
    if t is not None:
        candidates.append(bezier_points(control, np.array([t]))[0])
    return np.asarray(max(candidates, key=lambda point: point[1]))


def fitted_handle(curve: FloatArray, rounds: int = 12) -> FloatArray:
    """P1 (2,) of the quadratic Bézier curve that lies closest to a curve (N, 2) and shares its end points.

    Gauss-Newton on the distances across the curve: points of the given curve are compared with the nearest of a dense
    polyline, and only the part of their difference that is normal to it counts.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    even = np.linspace(0.0, arc[-1], 41)
    points = np.stack([np.interp(even, arc, curve[:, 0]), np.interp(even, arc, curve[:, 1])], axis=1)
    start, end = points[0], points[-1]
    t = np.linspace(0.0, 1.0, 241)
    # twice the middle of the curve less the middle of the chord: B(1/2) halfway along the curve
    middle = 2 * points[len(points) // 2] - 0.5 * (start + end)
    reach = 0.25 * arc[-1]
    for _ in range(rounds):
        fitted = bezier_points(np.stack([start, middle, end]), t)
        difference = points[:, None] - fitted[None]
        nearest = np.argmin(np.sum(difference**2, axis=2), axis=1)
        here = t[nearest]
        slope = 2 * np.outer(1 - here, middle - start) + 2 * np.outer(here, end - middle)
        normal = np.stack([-slope[:, 1], slope[:, 0]], axis=1)
        normal = normal / np.maximum(np.hypot(*slope.T), 1e-12)[:, None]
        gap = np.sum((points - fitted[nearest]) * normal, axis=1)
        design = (2 * here * (1 - here))[:, None] * normal
        # a little damping: along a straight curve P1 may slide freely
        step = np.linalg.solve(design.T @ design + 1e-6 * np.eye(2), design.T @ gap)
        length = float(np.hypot(*step))
        middle = middle + step * min(1.0, reach / max(length, 1e-12))
        if length < SETTLED_PX:
            break
    return np.asarray(middle)
