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


def handle(start: FloatArray, start_tangent: FloatArray, end: FloatArray, end_tangent: FloatArray) -> FloatArray | None:
    """P1 (2,) of the curve between two points (2,) with these directions (2,) there; None if they are parallel.

    The end tangents of a quadratic Bézier curve meet in its handle.
    """
    system = np.stack([start_tangent, -end_tangent], axis=1)
    scale = float(np.linalg.norm(start_tangent) * np.linalg.norm(end_tangent))
    if abs(float(np.linalg.det(system))) < 1e-9 * max(scale, 1e-300):
        return None
    way = np.linalg.solve(system, end - start)
    return np.asarray(start + way[0] * start_tangent)
