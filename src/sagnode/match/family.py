"""All curves of a conductor at once, in single precision: what a search over thousands of them projects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray, Intrinsics, distort, project
from sagnode.geometry.conductor import conductor_points, gravity_direction, loaded_profile
from sagnode.match.bundle import beside
from sagnode.match.templates import View
from sagnode.native import kernels

NEAREST_M = 1e-3
OUTSIDE_PX = -1e4
"""Where points that the camera cannot see are put."""

Grid = NDArray[Any]
"""Of single precision: a picture needs no more."""


@dataclass(frozen=True)
class Family:
    """All curves of a conductor in the camera's frame: ``chord + profile(sag) · direction(swing)``, single precision.

    A catenary's profile over its sag is even in the sag, so two sags tell the others to a millimetre.
    """

    chord: Grid
    """Samples of the chord (N, 3), m."""
    slope: Grid
    """Profile per metre of sag for no sag (N,)."""
    bend: Grid
    """What the square of the sag adds to that (N,)."""
    turn: Grid
    """Direction of gravity as constant, by cosine and by sine of the swing (3, 3)."""
    members: Grid
    """Where a bundle's sub-conductors are in the picture, relative to the curve (m, N, 2), px; zero for a wire."""

    @classmethod
    def of(cls, view: View, sag_range: tuple[float, float], t: FloatArray) -> Family:
        """The family of the samples ``t`` (N,)."""
        rise = view.far - view.near
        ends = np.array(sag_range)
        low, high = loaded_profile(np.full(2, np.hypot(rise[0], rise[1])), rise[2], ends, t, view.load) / ends[:, None]
        bend = (high - low) / (ends[1] ** 2 - ends[0] ** 2)
        ahead, aside, back = (gravity_direction(view.near, view.far, turn * np.pi) for turn in (0.0, 0.5, 1.0))
        middle = 0.5 * (ahead + back)
        turn = np.stack([middle, 0.5 * (ahead - back), aside - middle]) @ view.pose.rotation.T
        chord = (view.near + t[:, None] * rise - view.pose.position) @ view.pose.rotation.T
        # the same for all curves of the family, to what little their depths differ
        points = conductor_points(view.near, view.far, float(ends.mean()), 0.0, t, view.load)
        moved, _ = project(view.intrinsics, view.pose, points + view.members[:, None, :])
        members = np.nan_to_num(moved - project(view.intrinsics, view.pose, points)[0])
        parts = (chord, low - bend * ends[0] ** 2, bend, turn, members)
        return cls(*(part.astype(np.float32) for part in parts))

    def _points(self, part: NDArray[np.intp], sag: Grid, cosine: Grid, sine: Grid) -> list[Grid]:
        """Coordinates x, y, z (n, ...) of some samples (n,) in the camera's frame, m, from sags and their swings."""
        slope, bend, *chord = (
            column[part].reshape(-1, *(1,) * sag.ndim) for column in (self.slope, self.bend, *self.chord.T)
        )
        profile = sag * (slope + bend * sag**2)
        constant, by_cosine, by_sine = self.turn
        return [chord[i] + profile * (constant[i] + by_cosine[i] * cosine + by_sine[i] * sine) for i in range(3)]

    def pixels(
        self, lens: Intrinsics, part: NDArray[np.intp], sags: FloatArray, swings: FloatArray
    ) -> tuple[Grid, Grid, Grid]:
        """Pixels u, v and depth (n, ...) of some samples, px and m, OUTSIDE_PX where they are not ahead.

        Sags and swings broadcast.
        """
        sag, cosine, sine = (each.astype(np.float32) for each in (sags, np.cos(swings), np.sin(swings)))
        return _project(lens, *self._points(part, sag, cosine, sine))

    def placed(
        self,
        lens: Intrinsics,
        part: NDArray[np.intp],
        sags: FloatArray,
        swings: FloatArray,
        width: float = 0.0,
        step: Grid | None = None,
    ) -> tuple[Grid, Grid, Grid, Grid, Grid]:
        """Pixels u, v, both components of the unit normals, and depth, each (n, K), of samples (n,) without a gap.

        Of as many curves as there are sags and swings when these broadcast, one after the other. With the ``width`` of
        a wire, px at one metre, the distance of its sides (:func:`sagnode.match.bundle.beside`) comes instead of the
        depth.
        """
        shape = np.broadcast_shapes(sags.shape, swings.shape)
        grid = np.empty((3, *shape), dtype=np.float32)
        grid[0], grid[1], grid[2] = sags, np.cos(swings), np.sin(swings)
        sag, cosine, sine = grid.reshape(3, -1)
        if kernels is not None:
            u, v, nu, nv, last = np.empty((5, len(part), len(sag)), dtype=np.float32)
            steps = np.zeros(len(part), dtype=np.float32) if step is None else step
            curves = (self.chord, self.slope, self.bend, self.turn, lens.packed, sag, cosine, sine)
            kernels.places(*curves, int(part[0]), width, steps, u, v, nu, nv, last)
            return u, v, nu, nv, last
        # a neighbour on either side gives the ends their tangents
        padded = np.arange(max(0, part[0] - 1), min(len(self.chord), part[-1] + 2))
        inner = slice(int(part[0] - padded[0]), int(part[0] - padded[0]) + len(part))
        u, v, depth = _project(lens, *self._points(padded, sag, cosine, sine))
        du, dv = _along(u)[inner], _along(v)[inner]
        shorten = 1 / np.sqrt(np.maximum(du * du + dv * dv, np.float32(1e-9)))
        last = beside(np.float32(width) / depth[inner], step) if width else depth[inner]
        return u[inner], v[inner], -dv * shorten, du * shorten, last


def _along(values: Grid) -> Grid:
    """Differences of neighbours along the first axis: central ones, one-sided at the ends."""
    difference = np.empty_like(values)
    np.subtract(values[2:], values[:-2], out=difference[1:-1])
    np.subtract(values[1], values[0], out=difference[0])
    np.subtract(values[-1], values[-2], out=difference[-1])
    return difference


def _project(lens: Intrinsics, x: Grid, y: Grid, z: Grid) -> tuple[Grid, Grid, Grid]:
    """Pixels u, v and depth of points of the camera frame, single precision; far outside where it is not ahead."""
    ahead = z > NEAREST_M
    every = bool(ahead.all())
    depth = z if every else np.where(ahead, z, np.float32(1.0))
    x, y = x / depth, y / depth
    if any(lens.distortion):
        within = x * x + y * y <= lens.reach**2
        ahead &= within
        every = every and bool(within.all())
        # a double precision coefficient would make everything after it double
        x, y = distort(replace(lens, distortion=tuple(map(float, lens.distortion))), x, y)
    u = float(lens.fx) * x + float(lens.cx)
    v = float(lens.fy) * y + float(lens.cy)
    if not every:
        u, v = np.where(ahead, u, np.float32(OUTSIDE_PX)), np.where(ahead, v, np.float32(OUTSIDE_PX))
    return u, v, depth
