"""Template library: conductor curves for a grid of sag and swing, seen by the camera at its present pose.

A space Bézier seen in perspective is a rational quadratic Bézier whose weights are the depths of its control points
(design: §2), so a template is indexed by what we want to know and needs no perspective step of its own. The catenary's
departure from its parabola is added in space before projection, and distortion after it point by point: both exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, inside, project
from sagnode.geometry.conductor import conductor_points, control_points

SAMPLES = 128
STEP_PX = 1.6
"""Largest movement of any visible point of the curve from one template to the next; a wire's response is ±1 px wide."""


@dataclass(frozen=True)
class View:
    """A conductor as a camera sees it: everything a curve in the picture depends on but sag and swing."""

    intrinsics: Intrinsics
    pose: Pose
    near: FloatArray
    far: FloatArray
    diameter: float
    """Of the wire, or the outer width of the bundle, m."""
    load: tuple[float, ...] = ()
    """Terms of an uneven load (:mod:`sagnode.geometry.conductor`); none for an even one."""

    def pixels(self, sag: float, swing: float, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, 2) and depths (N,) of one curve; NaN where it is not ahead of the camera."""
        return project(self.intrinsics, self.pose, conductor_points(self.near, self.far, sag, swing, t, self.load))

    def width_px(self, depth: FloatArray) -> FloatArray:
        """Projected width of the conductor, px, at depths (N,) m."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.where(depth > 1e-3, self.diameter * self.intrinsics.fx / depth, np.nan))

    def rational_bezier(self, sag: float, swing: float) -> tuple[FloatArray, FloatArray]:
        """Control points (3, 2) px and weights (3,) of the parabola's picture through a perfect lens.

        A weight is a control point's depth; it is negative for one behind the camera, where the curve stays valid.
        """
        skew = 0.5 + self.load[0] / 6 if self.load else 0.5
        space = control_points(self.near, self.far, sag, swing, skew)
        camera = (space - self.pose.position) @ self.pose.rotation.T
        homogeneous = camera @ self.intrinsics.matrix.T
        weights = homogeneous[:, 2]
        return np.asarray(homogeneous[:, :2] / weights[:, None]), np.asarray(weights)


def even_parameters(
    view: View, sag: float, swing: float, count: int, margin: float = 3.0, span_share: float = 0.0
) -> FloatArray:
    """Curve parameters (count,) over the visible part of one curve, evenly spaced in the picture.

    ``span_share`` of the spacing is even along the span instead: in a view along the line the near metres take most of
    the picture and the far half of the span a few pixels. Fewer than two parameters come back when nothing is visible.
    """
    # uneven start: in a view along the line the near metres take most of the picture
    t = np.concatenate([np.linspace(0.0, 0.2, 800, endpoint=False), np.linspace(0.2, 1.0, 800)])
    pixels, _ = view.pixels(sag, swing, t)
    seen = inside(view.intrinsics, pixels, margin)
    if np.count_nonzero(seen) < 2:
        return np.empty(0)
    both = seen[1:] & seen[:-1]
    step = np.where(both, np.hypot(*np.diff(np.nan_to_num(pixels), axis=0).T), 0.0)
    if not step.any():
        return np.empty(0)
    along = np.where(both, np.diff(t), 0.0)
    step = (1 - span_share) * step / step.sum() + span_share * along / along.sum()
    arc = np.concatenate([[0.0], np.cumsum(step)])
    wanted = np.linspace(0.0, arc[-1], count)
    # arc is flat where the curve is hidden: keep the ends of its rising stretches
    rising = np.diff(arc) > 0
    ends = np.concatenate([rising, [False]]) | np.concatenate([[False], rising])
    return np.asarray(np.interp(wanted, arc[ends], t[ends]))
