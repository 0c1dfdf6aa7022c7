"""The picture without wires that are known: what they show is fitted and taken out, so that another may be looked for.

Wires that run a few pixels beside each other disturb each other in everything that looks across a curve: the stronger
one is the highest peak about the weaker one's curve, and lies on the shifted curves that the weaker one is compared
with. Radio astronomers take a strong source's pattern out of a map before they look for weak ones (CLEAN: Högbom 1974,
Astron. Astrophys. Suppl. 15, 417); likewise here. Block by block along a wire, its profile, those of the other wires
that run beside it, and a background that is a straight line are fitted together to what the picture shows across it,
and its own share is taken out of the pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.kernels import STEP_PX, steps, wire_kernel
from sagnode.match.localise import block_starts
from sagnode.match.ribbon import arc_length, straighten

BLURS_PX = (0.6, 0.8, 1.0, 1.2, 1.4)
"""Standard deviations of a picture's blur that are tried; between them, the one that leaves least is interpolated."""
BLOCK_PX = 24.0
"""Length along a wire over which its contrast is taken for even: it changes where the background does."""
BETWEEN_PIXELS = 1 / 6
"""Mean variance, px², by which bilinear sampling between pixels blurs a profile; the pixels themselves it does not."""
MARGIN_PX = 3.5
"""How far beyond a wire's edge its blurred profile is followed."""
MERGED_PX = 1.2
"""Wires that lie nearer than this are one line in the picture: what is there cannot be shared out among them."""
BEYOND_PX = 2.0
"""Beyond a line's window, within which another's blurred profile still reaches into it."""
NOWHERE_PX = 1e3
SPACING_PX = 4.0
"""Of the places at which the distance to another wire is worked out."""
RIDGE = 1e-3
"""Share of their size that is added to the normal equations' diagonals, for profiles that hardly differ."""


@dataclass(frozen=True)
class Line:
    """One wire in the picture.

    Attributes:
        pixels: (N, 2), samples about 1 px apart.
        normal: unit normals (N, 2).
        width: px (N,).
    """

    pixels: FloatArray
    normal: FloatArray
    width: FloatArray


def peeled(image: GreyImage, lines: Sequence[Line], kept: Sequence[Line] = ()) -> GreyImage:
    """The picture without some wires; ``kept`` are others that run beside them, and stay."""
    if not lines:
        return image
    bare = image.copy()
    everything = [*lines, *kept]
    for k, line in enumerate(lines):
        _take_out(bare, line, _contrast(image, line, everything[:k] + everything[k + 1 :]))
    return bare


def aside(
    pixels: FloatArray, normal: FloatArray, other: FloatArray, reach: float
) -> tuple[FloatArray, NDArray[np.intp]]:
    """How far a polyline (K, 2) lies aside of points (M, 2), px along their normals (M, 2); NaN beyond ``reach``.

    And which of its points is next to the place (M,).
    """
    nothing = np.full(len(pixels), np.nan), np.zeros(len(pixels), dtype=np.intp)
    if len(other) < 2 or not len(pixels):
        return nothing
    spacing = float(arc_length(other)[-1]) / (len(other) - 1)
    some = np.arange(0, len(other), max(1, int(SPACING_PX / max(spacing, 1e-6))))
    some = np.append(some[:-1] if len(some) > 1 else some, len(other) - 1)
    points = other[some]
    away_u = points[:, 0] - pixels[:, :1]
    away_v = points[:, 1] - pixels[:, 1:]
    along = away_u * normal[:, 1:] - away_v * normal[:, :1]
    rows, columns = np.nonzero(along[:, :-1] * along[:, 1:] <= 0)
    before, after = along[rows, columns], along[rows, columns + 1]
    share = before / np.where(before == after, 1.0, before - after)
    across = away_u * normal[:, :1] + away_v * normal[:, 1:]
    here = across[rows, columns]
    here = here + share * (across[rows, columns + 1] - here)
    kept = np.abs(here) <= reach
    rows, columns, here = rows[kept], columns[kept], here[kept]
    # the nearest comes last, and stays
    order = np.argsort(-np.abs(here), kind="stable")
    place, nearest = nothing
    place[rows[order]] = here[order]
    nearest[rows[order]] = some[columns[order]]
    return place, nearest


def _contrast(image: GreyImage, line: Line, others: Sequence[Line]) -> tuple[FloatArray, FloatArray, float]:
    """Where along a line its contrast was fitted, px (M,), that contrast, grey levels (M,), and the picture's blur."""
    arc = arc_length(line.pixels)
    starts = block_starts(arc, BLOCK_PX)
    size = np.diff(np.append(starts, len(arc)))
    index = starts + size // 2
    width = np.add.reduceat(line.width, starts) / size
    reach = 0.5 * float(width.max()) + MARGIN_PX
    across = STEP_PX * steps(int(np.ceil(reach / STEP_PX)))
    ribbon = straighten(image, line.pixels, line.normal, across)
    profile = np.add.reduceat(ribbon, starts, axis=0, dtype=np.float64) / size[:, None]
    place, merged = arc[index], np.zeros(len(index), dtype=bool)
    beside: list[tuple[FloatArray, FloatArray]] = []
    for other in others:
        wide = float(np.mean(other.width))
        off, _ = aside(line.pixels[index], line.normal[index], other.pixels, reach + 0.5 * wide + BEYOND_PX)
        near = np.isfinite(off)
        if near.any():
            merged |= near & (np.abs(np.where(near, off, np.inf)) < MERGED_PX)
            beside.append((np.where(near, off, NOWHERE_PX), np.full(len(index), wide)))
    if merged.all():
        return place, np.zeros(len(place)), BLURS_PX[0]
    _, left = _fitted(profile, across, width, beside, np.array(BLURS_PX))
    blur = _least(BLURS_PX, np.sum(left[:, ~merged] ** 2, axis=(1, 2)).tolist())
    height, _ = _fitted(profile, across, width, beside, np.array([blur]))
    return place, np.interp(place, place[~merged], height[0, ~merged]), blur


def _least(places: Sequence[float], values: Sequence[float]) -> float:
    """Where the parabola through the least of some values at even places, and its neighbours, is least."""
    k = int(np.clip(np.argmin(values), 1, len(values) - 2))
    before, here, after = values[k - 1 : k + 2]
    bend = before - 2 * here + after
    step = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return float(places[k] + np.clip(step, -1.0, 1.0) * (places[k + 1] - places[k]))


def _fitted(
    profile: FloatArray,
    across: FloatArray,
    width: FloatArray,
    beside: Sequence[tuple[FloatArray, FloatArray]],
    blurs: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Contrast (B, M) of a wire in the middle of profiles (M, K), and what a fit of it and those beside it leaves.

    That is (B, M, K), for each of some blurs (B,), px. Those beside it are given by how far aside (M,) they lie and how
    wide (M,) they are, px.
    """
    places = [(np.zeros(len(profile)), width), *beside]
    basis = np.empty((len(blurs), len(profile), len(places) + 2, len(across)))
    for k, (off, wide) in enumerate(places):
        basis[:, :, k] = wire_kernel(wide, across - off[:, None], blurs[:, None, None])
    basis[:, :, -2], basis[:, :, -1] = 1.0, across
    square = basis @ basis.swapaxes(2, 3)
    ridge = RIDGE * np.einsum("bmii->bmi", square) + 1e-9
    square += ridge[..., None] * np.eye(len(places) + 2)
    height = np.linalg.solve(square, basis @ profile[:, :, None])
    left = profile - np.sum(height * basis, axis=2)
    return np.asarray(height[:, :, 0, 0]), np.asarray(left)


def _take_out(image: GreyImage, line: Line, contrast: tuple[FloatArray, FloatArray, float]) -> None:
    """Take a line's profile out of the pixels about it, in place."""
    place, height, blur = contrast
    arc = arc_length(line.pixels)
    reach = 0.5 * float(np.max(line.width)) + MARGIN_PX
    sharp = float(np.sqrt(blur**2 - BETWEEN_PIXELS))
    for axis, run in _runs(line):
        row, column, distance, sample = _footprint(line, axis, run, reach, image.shape)
        if not len(row):
            continue
        shown = wire_kernel(np.interp(sample, np.arange(len(arc)), line.width), distance[:, None], sharp)[:, 0]
        shown *= np.interp(np.interp(sample, np.arange(len(arc)), arc), place, height)
        image[row, column] = np.clip(np.rint(image[row, column] - shown), 0, 255).astype(np.uint8)


def _runs(line: Line) -> list[tuple[int, slice]]:
    """Stretches of a line that go on in one direction along columns (axis 0) or rows (axis 1), with that axis."""
    step = np.diff(line.pixels, axis=0)
    axis = (np.abs(step[:, 1]) > np.abs(step[:, 0])).astype(np.int64)
    kind = 2 * axis + (step[np.arange(len(step)), axis] > 0)
    ends = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(step)]
    return [(int(axis[a]), slice(a, b + 1)) for a, b in pairwise(ends) if b > a]


def _footprint(
    line: Line, axis: int, run: slice, reach: float, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray]:
    """Pixels about a stretch of a line: rows, columns, distances across, px, and samples along it (n,)."""
    pixels, normal = line.pixels[run], line.normal[run]
    along, aside_of = pixels[:, axis], pixels[:, 1 - axis]
    order = slice(None) if along[-1] >= along[0] else slice(None, None, -1)
    along, aside_of, across = along[order], aside_of[order], normal[order, 1 - axis]
    samples = np.arange(run.start, run.stop, dtype=np.float64)[order]
    limit, wide = (shape[1], shape[0]) if axis == 0 else (shape[0], shape[1])
    first, last = max(0, int(np.ceil(along[0]))), min(limit - 1, int(np.ceil(along[-1])) - 1)
    if last < first:
        nothing = np.empty(0, dtype=np.intp)
        return nothing, nothing, np.empty(0), np.empty(0)
    whole = np.arange(first, last + 1)
    middle = np.interp(whole, along, aside_of)
    turned = np.interp(whole, along, across)
    sample = np.interp(whole, along, samples)
    far = int(np.ceil(reach * np.sqrt(2.0))) + 1
    place = np.rint(middle).astype(np.intp)[:, None] + np.arange(-far, far + 1)
    distance = (place - middle[:, None]) * turned[:, None]
    keep = (np.abs(distance) <= reach) & (place >= 0) & (place < wide)
    ahead = np.broadcast_to(whole[:, None], place.shape)[keep]
    here = place[keep]
    row, column = (here, ahead) if axis == 0 else (ahead, here)
    return row, column, distance[keep], np.broadcast_to(sample[:, None], place.shape)[keep]
