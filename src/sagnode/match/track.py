"""A conductor's curve in the picture, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.bundle import lines
from sagnode.match.ribbon import arc_length, line_response, normals
from sagnode.match.templates import View, even_shares, visible_part
from sagnode.native import kernels

MAX_SAMPLES = 6000
MIN_LENGTH_PX = 16


@dataclass(frozen=True)
class Track:
    """One curve in the picture, sampled about one pixel apart over its visible part.

    Attributes:
        t: curve parameters (N,).
        pixels: (N, 2).
        normal: unit normals (N, 2).
        width: projected width of one wire, px (N,).
        arc: position along the curve, px (N,).
        members: offsets of a bundle's sub-conductors across the curve, px (m, N); one row of zeros for a wire.
    """

    t: FloatArray
    pixels: FloatArray
    normal: FloatArray
    width: FloatArray
    arc: FloatArray
    members: FloatArray

    @cached_property
    def pace(self) -> FloatArray:
        """Share of the span's horizontal length that goes with each sample (N,)."""
        return np.abs(np.gradient(self.t))

    def wires(self) -> list[FloatArray]:
        """Polylines (N, 2) of the wires themselves."""
        return [self.pixels + offset[:, None] * self.normal for offset in self.members]

    def response(self, image: GreyImage, some: slice | NDArray[np.intp] = slice(None)) -> FloatArray:
        """Response (n,) of some samples, grey levels; NaN outside the frame."""
        place, side = lines(self.members[:, some], self.width[some])
        return line_response(image, self.pixels[some], self.normal[some], place, side).astype(np.float64)


def trace(view: View, sag: float, swing: float, margin: float = 3.0) -> Track | None:
    """The visible part of a curve, one sample a pixel; None when fewer than two blocks of it are in the frame."""
    arc, at = visible_part(view, sag, swing, margin)
    count = min(int(arc[-1]) + 1, MAX_SAMPLES) if arc.size else 0
    if count < MIN_LENGTH_PX:
        return None
    t, pixels, depth, normal, along = _samples(view, sag, swing, arc, at, count)
    return Track(t, pixels, normal, view.width_px(depth), along, view.across(sag, swing, t, normal))


def _samples(
    view: View, sag: float, swing: float, arc: FloatArray, at: FloatArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Samples evenly along the visible part: parameters, pixels, depths, unit normals, lengths along the curve."""
    if kernels is not None:
        (t, depth, along), (pixels, normal) = np.empty((3, count)), np.empty((2, count, 2))
        seen = kernels.curve_track(*view.words(sag, swing), arc, at, t, pixels, depth, normal, along)
        return t[:seen], pixels[:seen], depth[:seen], normal[:seen], along[:seen]
    t = np.interp(np.linspace(0.0, arc[-1], count), arc, at)
    pixels, depth = view.pixels(sag, swing, t)
    keep = np.isfinite(pixels).all(axis=1)
    if not keep.all():
        t, pixels, depth = t[keep], pixels[keep], depth[keep]
    return t, pixels, depth, normals(pixels), arc_length(pixels)


def mixed_samples(track: Track, count: int) -> NDArray[np.intp]:
    """Indices (count,) of samples of a track, half of them even in the picture and half even along the span.

    In a view along the line the near metres take most of the picture and the far half of the span a few pixels.
    """
    share = 0.5 * track.arc / track.arc[-1] + 0.5 * (track.t - track.t[0]) / (track.t[-1] - track.t[0])
    return np.minimum(np.searchsorted(share, even_shares(count)), len(share) - 1)
