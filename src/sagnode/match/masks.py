"""Where another wire, or another stretch of the same one, runs so near a curve that it could be taken for the wire."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.kernels import BLUR_PX
from sagnode.match.peel import aside
from sagnode.match.robust import median
from sagnode.match.track import Track
from sagnode.native import kernels

MOST_COMPARED = 300
"""Samples along a curve that suffice to see whether it folds back."""
MERGED_PX = 1.0
"""Two wires whose edges are nearer than this are one line, however well the one of them is taken out."""
BESIDE_PX = 8.0
"""Distance beyond which what is left of a wire that was taken out moves no other."""


@dataclass(frozen=True)
class Neighbour:
    """Another wire, or a stretch of it, about a curve.

    Attributes:
        pixels: polyline (K, 2).
        width: px.
        unsure: standard uncertainty of its place across itself (K,), px, where it was taken out of the picture; None
            where it is still there to be seen.
    """

    pixels: FloatArray
    width: float = 0.0
    unsure: FloatArray | None = None


def near_another(track: Track, other: Track, reach: float) -> NDArray[np.bool_]:
    """Which samples (N,) of a track have another within ``reach`` px across it."""
    every = max(1, len(track.t) // MOST_COMPARED)
    pixels = track.pixels[::every]
    masked = near(pixels, track.normal[::every], other.pixels, np.full(len(pixels), reach))
    return np.repeat(masked, every)[: len(track.t)]


def runs_near(track: Track, others: Sequence[FloatArray], half_range: float) -> bool:
    """Whether any other polyline (K, 2) comes so close to a track that its blocks would be masked."""
    every = np.arange(0, len(track.t), 8, dtype=np.int64)
    seen = [Neighbour(pixels) for pixels in others]
    return bool(others_near(track, every, seen, reach_of(track, half_range)).any())


def reach_of(track: Track, half_range: float | FloatArray) -> FloatArray:
    """Distance across the curve within which another wire disturbs a block of a single wire, px."""
    return np.asarray(half_range + 3.0 + 0.5 * median(track.width))


def others_near(
    track: Track, index: NDArray[np.int64], others: Sequence[Neighbour], reach: FloatArray
) -> NDArray[np.bool_]:
    """Which samples (M,) of a track have another wire within reach, px, of any of its own wires.

    One that was taken out of the picture disturbs only where it cannot be told from the track's own.
    """
    masked = np.zeros(len(index), dtype=bool)
    if not others:
        return masked
    pixels, normal, width = track.pixels[index], track.normal[index], track.width[index]
    reach = np.broadcast_to(reach, index.shape)
    for offset in track.members[:, index]:
        place = pixels + offset[:, None] * normal
        for other in others:
            masked |= near(place, normal, other.pixels, reach if other.unsure is None else _merged(width, other))
    return masked


def _merged(width: FloatArray, other: Neighbour) -> FloatArray:
    """Distance (M,) below which a wire ``width`` (M,) px wide is one line with another."""
    return MERGED_PX + 0.5 * (width + other.width)


def pulled(track: Track, index: NDArray[np.int64], others: Sequence[Neighbour]) -> FloatArray:
    """Standard uncertainty (M,) of a wire's place at samples of its track, px, by that of wires taken out beside it.

    A wire that was taken out e px from where it is leaves e times the slope of its profile. With profiles like Gauss's
    of standard deviation s, that moves another one d px aside by up to e (1 + d²/2s²) exp(-d²/4s²). All samples beside
    it are moved together, while offsets are taken to err by themselves: each is made as unsure as leaves their mean so.
    Of those where both are one line nothing is said.
    """
    variance = np.zeros(len(index))
    taken_out = [(other, other.unsure) for other in others if other.unsure is not None]
    if not taken_out:
        return variance
    for offset in track.members[:, index]:
        place = track.pixels[index] + offset[:, None] * track.normal[index]
        for other, unsure in taken_out:
            away, nearest = aside(place, track.normal[index], other.pixels, BESIDE_PX)
            squared = np.where(np.isfinite(away), away, np.inf) ** 2
            spread = BLUR_PX**2 + np.maximum(track.width[index], other.width) ** 2 / 12
            share = np.exp(-0.25 * squared / spread) * (1 + 0.5 * np.minimum(squared, BESIDE_PX**2) / spread)
            apart = np.abs(away) > _merged(track.width[index], other)
            own = np.where(apart, np.minimum(share, 1.0) * unsure[nearest], 0.0) ** 2
            # so many samples err alike: together they are no surer than one
            variance += own * max(1.0, float(own.sum()) ** 2 / max(float(own @ own), 1e-300))
    return np.asarray(np.sqrt(variance))


def folds_back(track: Track, index: NDArray[np.int64], reach: FloatArray) -> NDArray[np.bool_]:
    """Which samples (M,) have another stretch of the same curve within reach: its two halves seen along the line.

    A bundle reaches to its outermost wire.
    """
    reach = reach + np.max(np.abs(track.members[:, index]), axis=0)
    step = max(4, len(track.t) // MOST_COMPARED)
    if kernels is not None:
        masked = np.zeros(len(index), dtype=bool)
        kernels.folds_back(track.pixels, track.normal, track.arc, index, reach, step, masked)
        return masked
    reach, every = reach[:, None], slice(None, None, step)
    pixels, arc, normal = track.pixels[every], track.arc[every], track.normal[every]
    across, along = _apart(track.pixels[index], track.normal[index], pixels)
    close = (np.abs(across) < reach) & (across**2 + along**2 < (reach + 12.0) ** 2)
    away = np.abs(arc[None, :] - track.arc[index][:, None])
    turned = track.normal[index] @ normal.T < 0.5
    elsewhere = (away > 2 * np.pi * reach) | ((away > reach) & turned)
    return np.asarray((close & elsewhere).any(axis=1))


def near(pixel: FloatArray, normal: FloatArray, other: FloatArray, reach: FloatArray) -> NDArray[np.bool_]:
    """Which points (M, 2) have another polyline (K, 2) within ``reach`` (M,) px across the curve, 12 px along it."""
    if kernels is not None:
        masked = np.zeros(len(pixel), dtype=bool)
        kernels.near_polyline(pixel, normal, reach, other, masked)
        return masked
    finite = other[np.isfinite(other).all(axis=1)]
    if not len(finite):
        return np.zeros(len(pixel), dtype=bool)
    # a point every few pixels of it is enough, since 12 px are looked along
    across, along = _apart(pixel, normal, finite[:: max(1, int(6.0 / max(_spacing(finite), 1e-3)))])
    return np.asarray(((np.abs(across) < reach[:, None]) & (np.abs(along) < 12.0)).any(axis=1))


def _spacing(polyline: FloatArray) -> float:
    """Largest distance between neighbouring points of a polyline (K, 2), px."""
    return float(np.sqrt(np.max(np.sum(np.diff(polyline, axis=0) ** 2, axis=1), initial=0.0)))


def _apart(pixel: FloatArray, normal: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (M, K) of points (K, 2) from others (M, 2), across and along the curve with those normals (M, 2)."""
    tangent = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
    across, along = (axis @ other.T - np.sum(axis * pixel, axis=1, keepdims=True) for axis in (normal, tangent))
    return across, along
