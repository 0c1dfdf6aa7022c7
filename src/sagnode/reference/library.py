"""Template libraries of the three methods (sections 3.1, 3.2 and 4.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, inside, project
from sagnode.geometry.conductor import conductor_points, sag_profile
from sagnode.reference.bezier import bezier_points, fitted_handle
from sagnode.reference.matching import Template

_T = np.concatenate([np.linspace(0.0, 0.2, 1200, endpoint=False), np.linspace(0.2, 1.0, 1200)])
"""Uneven: in a view along the line the near metres take most of the picture."""
_POINTS = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Scene:
    """What the paper knows: a camera with a perfect lens, both attachment points (m), and the sags to try (m)."""

    intrinsics: Intrinsics
    pose: Pose
    near: FloatArray
    far: FloatArray
    sags: FloatArray

    @property
    def starts_far(self) -> bool:
        """Whether the targeted line starts at the far attachment, because the near one is out of the picture."""
        ends, _ = project(self.intrinsics, self.pose, np.stack([self.near, self.far]))
        seen = inside(self.intrinsics, ends)
        return bool(seen[1] and not seen[0])

    def visible(self, near: FloatArray, far: FloatArray, sag: float) -> FloatArray | None:
        """Pixels (N, 2) of the visible part of a conductor, beginning at the start; None if there is too little.

        The ends are the projected attachments, or where the conductor leaves the picture.
        """
        pixels, _ = project(self.intrinsics, self.pose, conductor_points(near, far, sag, 0.0, _T))
        seen = inside(self.intrinsics, pixels)
        edge = np.flatnonzero(np.diff(np.concatenate([[0], seen.astype(int), [0]])))
        runs = edge.reshape(-1, 2)
        if not len(runs):
            return None
        first, end = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))]
        if end - first < 8:
            return None
        curve = pixels[first:end]
        return np.asarray(curve[::-1] if self.starts_far else curve)


def bezier_library(scene: Scene) -> Iterator[Template]:
    """Quadratic Bézier curves in the picture, their handle P1 varied, one for each sag.

    P0 and P2 are the visible ends. How P1 moves the paper does not say: here it lies where the curve comes closest to
    the picture of a conductor of that sag. In the frontal view that moves it straight down below mid-span; in any other
    it is the choice most favourable to a plain quadratic, which cannot follow perspective.
    """
    for sag in scene.sags:
        curve = scene.visible(scene.near, scene.far, float(sag))
        if curve is not None:
            control = np.stack([curve[0], fitted_handle(curve), curve[-1]])
            yield Template(bezier_points(control, _POINTS), control)


def cosh_library(scene: Scene) -> Iterator[Template]:
    """Method 1: ``y = a cosh(x/a)`` drawn straight into the picture, level, from the start as wide as the visible line.

    a takes the values that make the curve's depth in pixels what each sag has at mid-span. No perspective: the far end
    comes out as high in the picture as the start, whatever the picture shows.
    """
    middle = scene.visible(scene.near, scene.far, float(np.mean(scene.sags)))
    if middle is None:
        return
    start = middle[0]
    width = abs(float(middle[-1, 0] - start[0]))
    direction = 1.0 if middle[-1, 0] >= start[0] else -1.0
    chord = 0.5 * (scene.near + scene.far)
    below = chord[None, :] - np.outer(np.concatenate([[0.0], scene.sags]), [0.0, 0.0, 1.0])
    pixels, _ = project(scene.intrinsics, scene.pose, below)
    depths = pixels[1:, 1] - pixels[0, 1]
    if width < 8:
        return
    for depth in depths:
        if np.isfinite(depth) and depth > 0:
            profile = sag_profile(width, 0.0, float(depth), _POINTS)
            yield Template(np.stack([start[0] + direction * width * _POINTS, start[1] + profile], axis=1))


def perspective_library(scene: Scene) -> Iterator[Template]:
    """Method 2: ``y = a cosh(x/a)`` in space, every point put into perspective.

    The hyperbolic cosine has level supports and its lowest point at mid-span (section 3.1), so both supports get the
    height of the one where the line starts.
    """
    level = scene.far[2] if scene.starts_far else scene.near[2]
    near = np.array([scene.near[0], scene.near[1], level])
    far = np.array([scene.far[0], scene.far[1], level])
    for sag in scene.sags:
        curve = scene.visible(near, far, float(sag))
        if curve is not None:
            yield Template(curve)
