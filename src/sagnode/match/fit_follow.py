"""From an arc that is nearly right to the wire: the best path through the straightened picture, coarse to fine.

Around the arc the picture is straightened and cut into blocks; every block says for every offset how much it looks like
a wire there. The most likely smooth path through these (dynamic programming) moves the arc, and the next, narrower
ribbon is taken around the moved arc: first on a shrunken picture, then on finer ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.fit_curve import Curve, Prior, adjust
from sagnode.match.localise import (
    STEP_PX,
    block_profiles,
    block_starts,
    compare,
    correlation,
    kernel_reach,
    unit_kernels,
)
from sagnode.match.ribbon import arc_length, normals

WIDTHS = (1.5, 3.0, 6.0, 11.0)
"""Widths of wires, cables and unresolved bundles that are looked for, px of the level."""
BLOCK = 8.0
RANGES: tuple[tuple[float, ...], ...] = ((6.0, 4.0, 3.0, 2.5), (4.0, 2.5, 2.5))
"""Half ranges of the successive ribbons on the coarsest and on the finer levels, px of the level."""
BOWS = 2
"""So many of the first ribbons of a level are searched for a parabola, the others for any smooth path."""
BEND = 0.4
"""Typical difference of the offsets of neighbouring blocks, px of the level."""
MOST = 6.0
"""Greatest evidence of one block."""
SAMPLES = 8.0
"""Independent samples in a window, for turning correlation into evidence."""


@dataclass(frozen=True)
class Look:
    """What the ribbon around a curve shows.

    Attributes:
        fraction: arc fractions of the blocks (M,).
        offsets: across the curve (K,), px.
        evidence: log-likelihood ratio of a wire against none, less the block's own background, for each width
            (W, M, K); 0 outside the frame.
        seen: blocks wholly inside the frame (M,).
    """

    fraction: FloatArray
    offsets: FloatArray
    evidence: FloatArray
    seen: FloatArray


@dataclass(frozen=True)
class Picture:
    """A crop of the frame, shrunk: cell = (pixel - origin) · scale."""

    grey: NDArray[np.float32]
    origin: FloatArray
    scale: float


def pyramid(image: GreyImage, curves: Sequence[Curve], coarsest: float) -> list[Picture]:
    """Crops around the curves, shrunk by ``coarsest`` and then by less and less down to 1."""
    height, width = image.shape
    everything = np.concatenate([curve.evenly(33)[1] for curve in curves])
    room = 20 * coarsest + 30
    low = np.clip(np.floor(everything.min(axis=0) - room), 0, (width - 2, height - 2)).astype(int)
    high = np.clip(np.ceil(everything.max(axis=0) + room), low + 2, (width, height)).astype(int)
    # single precision: rounding would wipe out a faint wire that shrinking has made fainter
    crop = np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]], dtype=np.float32)
    pictures = []
    shrink = coarsest
    while shrink > 1.3:
        size = (max(2, round(crop.shape[1] / shrink)), max(2, round(crop.shape[0] / shrink)))
        small = np.asarray(cv2.resize(crop, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
        # pixel centres: the first small pixel's centre lies at (shrink - 1)/2 of the crop
        pictures.append(Picture(small, low + (shrink - 1) / 2, 1 / shrink))
        shrink /= 2
    pictures.append(Picture(crop, low.astype(np.float64), 1.0))
    return pictures


def look(image: NDArray[np.float32], curve: Curve, half_range: float, widths: Sequence[float] = WIDTHS) -> Look:
    """Evidence for wires of several widths around a curve, one sample a pixel along it."""
    count = max(16, int(curve.length()) + 1)
    _, pixels = curve.evenly(count)
    arc = arc_length(pixels)
    starts = block_starts(arc, BLOCK)
    far = int(np.ceil(half_range / STEP_PX))
    offsets = STEP_PX * np.arange(-far, far + 1)
    evidence = np.zeros((len(widths), len(starts), len(offsets)))
    reach = kernel_reach(max(widths))
    across = STEP_PX * np.arange(-far - reach, far + reach + 1)
    profiles, seen = block_profiles(image, pixels, normals(pixels), across, starts)
    inside = seen.copy()
    for layer, width in zip(evidence, widths, strict=True):
        near = kernel_reach(width)
        trimmed = profiles[:, reach - near : profiles.shape[1] - (reach - near)]
        kernel = unit_kernels(np.full(1, width), STEP_PX * np.arange(-near, near + 1, dtype=np.float64))
        kernels = np.broadcast_to(kernel, (len(starts), kernel.shape[1]))
        amplitude, energy = compare(trimmed, kernels)
        alike = correlation(amplitude, energy, kernel.shape[1])
        likelihood = -0.5 * SAMPLES * np.log1p(-np.minimum(alike, 0.99) ** 2)
        layer[:] = np.clip(likelihood - np.median(likelihood, axis=1, keepdims=True), -1.0, MOST)
    evidence[:, ~inside] = 0.0
    size = np.diff(np.append(starts, count))
    fraction = (starts + 0.5 * (size - 1)) / (count - 1)
    return Look(fraction, offsets, evidence, inside)


def best_bow(fraction: FloatArray, evidence: FloatArray, start_cost: FloatArray, end_cost: FloatArray) -> FloatArray:
    """Columns (M,) of the parabola through evidence (M, K) that gathers most; costs (K,) as in :func:`best_path`.

    It sums over the whole length before it decides, so it finds wires that no single block shows.
    """
    blocks, columns = evidence.shape
    wide = np.maximum(evidence, 0.5 * (np.roll(evidence, 1, axis=1) + np.roll(evidence, -1, axis=1)))
    places = np.arange(0, columns, 2)
    first, middle, last = (axis.ravel() for axis in np.meshgrid(places, places, places, indexing="ij"))
    u = fraction
    shape = np.stack([(1 - u) * (1 - 2 * u), 4 * u * (1 - u), u * (2 * u - 1)])
    column = np.rint(np.stack([first, middle, last], axis=1) @ shape).astype(np.intp)
    held = (column >= 0) & (column < columns)
    gathered = np.where(held, wide[np.arange(blocks), np.clip(column, 0, columns - 1)], 0.0).sum(axis=1)
    best = int(np.argmax(gathered - start_cost[first] - end_cost[last]))
    return np.clip(np.array([first[best], middle[best], last[best]]) @ shape, 0, columns - 1)


def best_path(evidence: FloatArray, start_cost: FloatArray, end_cost: FloatArray) -> tuple[FloatArray, float]:
    """Most likely smooth path through evidence (M, K): column of each block (M,) and its total.

    Neighbouring blocks differ by some BEND; the costs (K,) are those of the first and the last block's offset.
    """
    blocks, columns = evidence.shape
    reach = max(1, int(3 * BEND / STEP_PX))
    moves = np.arange(-reach, reach + 1)
    toll = 0.5 * (moves * STEP_PX / BEND) ** 2
    total = evidence[0] - start_cost
    came = np.zeros((blocks, columns), dtype=np.intp)
    index = np.arange(columns)
    sources = index[None, :] + moves[:, None]
    outside = (sources < 0) | (sources >= columns)
    sources = np.clip(sources, 0, columns - 1)
    for block in range(1, blocks):
        options = total[sources] - toll[:, None]
        options[outside] = -np.inf
        choice = options.argmax(axis=0)
        came[block] = sources[choice, index]
        total = options[choice, index] + evidence[block]
    total = total - end_cost
    path = np.empty(blocks, dtype=np.intp)
    path[-1] = int(total.argmax())
    for block in range(blocks - 1, 0, -1):
        path[block - 1] = came[block, path[block]]
    return path.astype(np.float64), float(total.max())


def follow(picture: Picture, curve: Curve, anchors: FloatArray, slack: float, level: int) -> Curve:
    """Move a curve (in pixels of the frame) onto the wire seen in one picture of the pyramid.

    Args:
        picture: crop and scale.
        curve: nearly right, within the first of the ranges.
        anchors: the points given (2, 2), px of the frame.
        slack: their standard uncertainty, px of the frame.
        level: number of the picture in the pyramid, 0 the coarsest.
    """
    here = curve.moved(picture.origin, picture.scale)
    given = (anchors - picture.origin) * picture.scale
    loose = max(slack * picture.scale, 0.7)
    prior = Prior(given, loose)
    for passed, half_range in enumerate(RANGES[min(level, 1)]):
        seen = look(picture.grey, here, half_range)
        evidence = seen.evidence.max(axis=0)
        costs = [0.5 * ((seen.offsets - _anchor_offset(here, given, i)) / loose) ** 2 for i in (0, 1)]
        if passed < BOWS - level:
            path = best_bow(seen.fraction, evidence, costs[0], costs[1])
        else:
            path, _ = best_path(evidence, costs[0], costs[1])
        rows = np.arange(len(path))
        nearest = np.rint(path).astype(np.intp)
        strength = np.maximum(evidence[rows, nearest], 0.0)
        offset = seen.offsets[0] + STEP_PX * path
        # a block at the very edge of the ribbon has not found a summit
        precision = np.clip(strength / MOST, 0.0, 1.0) / 0.7**2
        for _ in range(3):
            moved, predicted = adjust(here, seen.fraction, offset, precision, prior)
            rest = offset - predicted
            precision = np.clip(strength / MOST, 0.0, 1.0) / 0.7**2 / (1 + (rest / 1.0) ** 2)
        here = moved
    return here.moved(-picture.origin * picture.scale, 1 / picture.scale)


def _anchor_offset(curve: Curve, anchors: FloatArray, end: int) -> float:
    """How far an anchor lies from its end of the curve along the normal there, px."""
    inner = curve.conic(np.array([0.02 if end == 0 else 0.98]))[0]
    tip = curve.control[2 * end]
    tangent = inner - tip if end == 0 else tip - inner
    tangent /= max(float(np.hypot(*tangent)), 1e-9)
    normal = np.array([-tangent[1], tangent[0]])
    return float((anchors[end] - tip) @ normal)
