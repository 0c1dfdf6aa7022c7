"""Template library: conductor curves for a grid of sag and swing, seen by the camera at its present pose.

A space Bézier seen in perspective is a rational quadratic Bézier whose weights are the depths of its control points
(design: §2), so a template is indexed by what we want to know and needs no perspective step of its own. The catenary's
departure from its parabola is added in space before projection, and distortion after it point by point: both exact.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, project
from sagnode.geometry.conductor import conductor_points, control_points
from sagnode.native import kernels

SAMPLES = 128
STEP_PX = 1.6
"""Largest movement of any visible point of the curve from one template to the next; a wire's response is ±1 px wide."""

NODES = 160
NEAREST_SHARE = 0.005
"""Depth nearer than which a curve is not followed closely, as a share of its greatest depth."""


@dataclass(frozen=True)
class View:
    """A conductor as a camera sees it: everything a curve in the picture depends on but sag and swing."""

    intrinsics: Intrinsics
    pose: Pose
    near: FloatArray
    far: FloatArray
    diameter: float
    """Of one wire, m."""
    load: tuple[float, ...] = ()
    """Terms of an uneven load (:mod:`sagnode.geometry.conductor`); none for an even one."""
    members: FloatArray = field(default_factory=lambda: np.zeros((1, 3)))
    """Sub-conductors about the centre line (m, 3), m; a single wire is its own."""

    def pixels(self, sag: float, swing: float, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, 2) and depths (N,) of one curve; NaN where it is not ahead of the camera."""
        if kernels is not None:
            pixels, depth = np.empty((len(t), 2)), np.empty(len(t))
            kernels.curve_pixels(*self.words(sag, swing), t, pixels, depth)
            return pixels, depth
        return project(self.intrinsics, self.pose, conductor_points(self.near, self.far, sag, swing, t, self.load))

    def words(self, sag: float, swing: float) -> tuple[Any, ...]:
        """One curve, as compiled functions take it."""
        return (*self._fixed, sag, swing, self._load)

    @cached_property
    def _fixed(self) -> tuple[FloatArray, ...]:
        own = (self.pose.rotation, self.pose.position, self.near, self.far)
        return (self.intrinsics.packed, *(np.asarray(part, dtype=np.float64) for part in own))

    @cached_property
    def _load(self) -> FloatArray:
        return np.array(self.load, dtype=np.float64)

    def across(self, sag: float, swing: float, t: FloatArray, normal: FloatArray) -> FloatArray:
        """Offsets (m, N) of the sub-conductors from the curve along its normals (N, 2), px.

        For samples that follow each other closely: where a sub-conductor crosses a normal is another place along it
        than the curve's own.
        """
        if len(self.members) == 1:
            return np.zeros((1, len(t)))
        points = conductor_points(self.near, self.far, sag, swing, t, self.load)
        pixels, _ = project(self.intrinsics, self.pose, points)
        moved, _ = project(self.intrinsics, self.pose, points + self.members[:, None, :])
        return np.stack([_crossing(pixels, normal, wire) for wire in np.nan_to_num(moved)])

    def width_px(self, depth: FloatArray) -> FloatArray:
        """Projected width of one wire, px, at depths (N,) m."""
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


@lru_cache(maxsize=16)
def even_shares(count: int) -> FloatArray:
    """So many places evenly from 0 to 1, kept since they are asked for some dozens of times a frame."""
    shares = np.linspace(0.0, 1.0, count)
    shares.setflags(write=False)
    return shares


def even_parameters(
    view: View, sag: float, swing: float, count: int, margin: float = 3.0, span_share: float = 0.0
) -> FloatArray:
    """Curve parameters (count,) over the visible part of one curve, evenly spaced in the picture.

    ``span_share`` of the spacing is even along the span instead: in a view along the line the near metres take most of
    the picture and the far half of the span a few pixels. Fewer than two parameters come back when nothing is visible.
    """
    arc, t = visible_part(view, sag, swing, margin)
    if not arc.size:
        return np.empty(0)
    share = arc / arc[-1]
    if span_share:
        along = np.concatenate([[0.0], np.cumsum(np.where(np.diff(arc) > 0, np.diff(t), 0.0))])
        share = (1 - span_share) * share + span_share * along / along[-1]
    return np.asarray(np.interp(even_shares(count), share, t))


def visible_part(view: View, sag: float, swing: float, margin: float = 3.0) -> tuple[FloatArray, FloatArray]:
    """Length along the visible part of a curve (K,), px, and the curve parameters there (K,), both rising.

    Hidden stretches have no length, so that two parameters share one. Empty where nothing is visible.
    """
    if kernels is not None:
        both = np.empty((2, 4 * NODES))
        found = kernels.curve_visible(*view.words(sag, swing), margin, NODES, NEAREST_SHARE, *both)
        return both[0, :found], both[1, :found]
    t = _nodes(view)
    pixels, _ = view.pixels(sag, swing, t)
    first, step = pixels[:-1], pixels[1:] - pixels[:-1]
    corner = np.array([view.intrinsics.width - 1.0, view.intrinsics.height - 1.0]) - margin
    # each piece between two nodes is clipped to the frame (Liang and Barsky)
    slope = np.where(np.abs(step) < 1e-9, 1e-9, step)
    with np.errstate(invalid="ignore"):
        low, high = (margin - first) / slope, (corner - first) / slope
        enter = np.maximum(*np.minimum(low, high).T)
        leave = np.minimum(*np.maximum(low, high).T)
        enter, leave = (np.minimum(np.maximum(end, 0.0), 1.0) for end in (enter, leave))
        length = (leave - enter) * np.sqrt(step[:, 0] ** 2 + step[:, 1] ** 2)
        seen = length > 0
    if not seen.any():
        return np.empty(0), np.empty(0)
    arc = np.concatenate([[0.0], np.cumsum(length[seen])])
    start, stretch = t[:-1][seen], np.diff(t)[seen]
    ends = np.stack([start + enter[seen] * stretch, start + leave[seen] * stretch], axis=1)
    return np.stack([arc[:-1], arc[1:]], axis=1).ravel(), ends.ravel()


def _nodes(view: View) -> FloatArray:
    """Curve parameters dense enough to follow a curve in the picture: even along the span, and even in 1/depth.

    In a view along the line the near metres take most of the picture, in proportion to 1/depth.
    """
    near, far = (float((end - view.pose.position) @ view.pose.rotation[2]) for end in (view.near, view.far))
    even = np.linspace(0.0, 1.0, NODES)
    least = NEAREST_SHARE * max(near, far)
    if least <= 0 or min(near, far) > 0.5 * max(near, far):
        return even
    inverse = np.linspace(1 / max(near, least), 1 / max(far, least), NODES)
    return np.unique(np.concatenate([even, np.clip((1 / inverse - near) / (far - near), 0.0, 1.0)]))


def _crossing(pixels: FloatArray, normal: FloatArray, wire: FloatArray) -> FloatArray:
    """Where the normals (N, 2) of a curve (N, 2) cross a wire beside it, sampled at the same parameters (N, 2), px."""
    tangent = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
    step = np.gradient(wire, axis=0)
    index = np.arange(len(wire), dtype=np.float64)

    def ahead(place: FloatArray, way: FloatArray) -> FloatArray:
        """Samples to go from there until the wire meets the normal."""
        pace = np.sum(way * tangent, axis=1)
        return np.asarray(-np.sum((place - pixels) * tangent, axis=1) / np.where(np.abs(pace) < 1e-3, np.inf, pace))

    meeting = np.clip(index + ahead(wire, step), 0.0, len(wire) - 1.0)
    there, way = (np.stack([np.interp(meeting, index, part[:, i]) for i in (0, 1)], axis=1) for part in (wire, step))
    return np.asarray(np.sum((there + ahead(there, way)[:, None] * way - pixels) * normal, axis=1))
