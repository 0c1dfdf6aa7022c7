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
from sagnode.fit.curve import Curve, Prior, adjust
from sagnode.geometry.camera import FloatArray
from sagnode.match.across import correlation
from sagnode.match.kernels import STEP_PX, kernel_reach, unit_kernels
from sagnode.match.localise import block_starts
from sagnode.match.ribbon import arc_length, normals

KERNELS = ((1.5, 1.2), *((width, 3.0) for width in (1.5, 3.0, 6.0, 8.0, 11.0)), (14.0, 4.5), (18.0, 6.0), (28.0, 10.0))
"""Widths of wires, cables and unresolved bundles that are looked for, with the background taken in on either side, px.

The first sees a wire whose neighbour is only a few pixels off. Were the widths further apart, the edge of a thick wire,
or its lit or shaded side, would look more like a wire than the whole of it."""
BLOCK = (8.0, 20.0)
"""Least and greatest length of a block, px."""
CHANGING = 0.5
"""What a wire that may be dark here and bright there must bring more in each block: it has more chances."""
RANGES: tuple[tuple[float, ...], ...] = ((5.0, 4.0, 3.0, 2.5), (4.0, 2.5, 2.5))
"""Half ranges of the successive ribbons on the coarsest and on the finer levels, px of the level."""
FLANK_PX = 4.0
"""How near, beyond half its width, a stronger line of the other sign makes a line a mere flank of it."""
FLANK, OWN_RIGHT = 0.5, 0.8
"""Contrast relative to that stronger line at which a line is nothing but its flank, and a line in its own right."""
LEVEL_PX = 900.0
"""Length of a chord on the coarsest level; longer ones are shrunk to it."""
BOWS = 1
"""So many of the first ribbons of a level are searched for a parabola, the others for any smooth path."""
BEND = 0.4
"""Typical difference of the offsets of neighbouring blocks, px of the level."""
MOST = 6.0
"""Evidence of one block that counts in full."""
BEYOND = 0.3
"""Share that counts of what exceeds it: a clear wire exceeds it with most widths, also beside its middle."""
SAMPLES_PER_PX = 0.8
"""Independent samples per pixel across, for turning correlation into evidence."""


@dataclass(frozen=True)
class Look:
    """What the ribbon around a curve shows.

    Attributes:
        fraction: arc fractions of the blocks (M,).
        offsets: across the curve (K,), px.
        signed: log-likelihood ratio of a wire against none for each kernel (W, M, K), negative for a dark wire.
        inside: which places lie inside the frame (M, K); outside them ``signed`` is 0.
    """

    fraction: FloatArray
    offsets: FloatArray
    signed: FloatArray
    inside: NDArray[np.bool_]


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
    room = max(64.0, 20 * coarsest)
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


def look(picture: NDArray[np.float32], curve: Curve, half_range: float) -> Look:
    """How much the blocks of a ribbon around a curve, one sample a pixel along it, look like wires."""
    length = curve.length()
    count = max(16, int(length) + 1)
    _, pixels = curve.evenly(count)
    starts = block_starts(arc_length(pixels), block_length(length))
    size = np.diff(np.append(starts, count))
    far = int(np.ceil(half_range / STEP_PX))
    offsets = STEP_PX * np.arange(-far, far + 1, dtype=np.float64)
    room = max(kernel_reach(width, margin_px=margin) for width, margin in KERNELS)
    across = STEP_PX * np.arange(-far - room, far + room + 1)
    normal = normals(pixels)
    maps = [(pixels[:, i : i + 1] + across * normal[:, i : i + 1]).astype(np.float32) for i in (0, 1)]
    grey = cv2.remap(picture, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profiles = np.add.reduceat(grey, starts, axis=0, dtype=np.float64) / size[:, None]
    centre = starts + size // 2
    u, v = (part[centre][:, room:-room] for part in maps)
    height, width_px = picture.shape
    inside = (u >= 0.5) & (v >= 0.5) & (u <= width_px - 1.5) & (v <= height - 1.5)
    signed, contrast = (
        np.stack(part)[:, :, room:-room]
        for part in zip(*(_likelihood(profiles, width, margin) for width, margin in KERNELS), strict=True)
    )
    signed *= _own_right(contrast)
    signed[:, ~inside] = 0.0
    return Look((starts + 0.5 * (size - 1)) / (count - 1), offsets, signed, inside)


def block_length(length: float) -> float:
    """Length of the blocks of a curve, px: enough of them to follow it, and long enough to average texture away."""
    return float(np.clip(length / 60, *BLOCK))


def _own_right(contrast: FloatArray) -> FloatArray:
    """How far each line is one in its own right (W, M, K), 0..1, and not the flank of a stronger one of the other sign.

    The shoulders of a dark wire look like faint bright lines beside it, the more so after sharpening or compression;
    and what is wide looks like a line up to any narrower one.
    """
    own = np.empty_like(contrast)
    brightest, darkest = np.zeros_like(contrast[0]), np.zeros_like(contrast[0])
    for layer, (width, _), factor in zip(contrast, KERNELS, own, strict=True):
        reach = np.ones((1, 2 * int((0.5 * width + FLANK_PX) / STEP_PX) + 1))
        brightest, darkest = np.maximum(brightest, layer), np.maximum(darkest, -layer)
        beside_bright, beside_dark = (cv2.dilate(part, reach) for part in (brightest, darkest))
        stronger = np.maximum(np.where(layer > 0, beside_dark, beside_bright), 1e-6)
        factor[:] = np.clip((np.abs(layer) / stronger - FLANK) / (OWN_RIGHT - FLANK), 0.0, 1.0)
    return own


def _likelihood(profiles: FloatArray, width: float, margin: float) -> tuple[FloatArray, FloatArray]:
    """Signed log-likelihood ratios (M, K) of a wire of this width at every column, positive for a bright one.

    And its contrast (M, K) if there is one, grey levels.

    From the correlation ρ of a window with the wire's profile: ``-n/2 ln(1-ρ²)`` for n independent samples.
    """
    near = kernel_reach(width, margin_px=margin)
    n = 2 * near + 1
    kernel = unit_kernels(np.full(1, width), STEP_PX * np.arange(-near, near + 1, dtype=np.float64))
    slope = np.linspace(-1, 1, n)[None] / np.linalg.norm(np.linspace(-1, 1, n))
    level = profiles - profiles.mean(axis=1, keepdims=True)
    amplitude, mean, tilt = (_slide(level, taps) for taps in (kernel, np.full((1, n), 1 / n), slope))
    energy = np.maximum(_slide(level * level, np.ones((1, n))) - n * mean**2 - tilt**2, 0.0)
    alike = np.minimum(correlation(amplitude, energy, n), 0.99)
    samples = SAMPLES_PER_PX * n * STEP_PX
    return np.asarray(-0.5 * samples * np.sign(amplitude) * np.log1p(-(alike**2))), amplitude * np.ptp(kernel)


def _slide(profiles: FloatArray, taps: FloatArray) -> FloatArray:
    return np.asarray(cv2.filter2D(profiles, cv2.CV_64F, taps, borderType=cv2.BORDER_REPLICATE))


def polarities(signed: FloatArray, inside: NDArray[np.bool_]) -> list[FloatArray]:
    """Evidence (M, K) for a dark wire, for a bright one, and for one that changes: the best width's, less background.

    The background is the median strength of either sign in the block's own row: texture looks like wires everywhere.
    """
    background = np.stack([_row_median(np.abs(layer), inside) for layer in signed])[:, :, None]
    bright = _bounded(signed - background).max(axis=0)
    dark = _bounded(-signed - background).max(axis=0)
    either = np.maximum(bright, dark) - CHANGING
    return [np.where(inside, part, 0.0) for part in (dark, bright, either)]


def _bounded(evidence: FloatArray) -> FloatArray:
    """Evidence from -1 up, without most of what exceeds ``MOST``: one block must not decide, nor places be equal."""
    return np.asarray(np.clip(evidence, -1.0, MOST) + BEYOND * np.maximum(evidence - MOST, 0.0))


def _row_median(values: FloatArray, inside: NDArray[np.bool_]) -> FloatArray:
    """Median of each row of values (M, K) over its cells inside the frame; 0 where there are none."""
    if inside.all():
        return np.asarray(np.median(values, axis=1))
    kept = np.where(inside, values, np.nan)
    kept[~inside.any(axis=1)] = 0.0
    return np.asarray(np.nanmedian(kept, axis=1))


def best_bow(
    fraction: FloatArray, evidence: FloatArray, start_cost: FloatArray, end_cost: FloatArray
) -> tuple[FloatArray, float]:
    """Parabola through evidence (M, K) that gathers most: columns (M,) and total; costs (K,) as in :func:`best_path`.

    It sums over the whole length before it decides, so it finds wires that no single block shows.
    """
    blocks, columns = evidence.shape
    stride = max(1, columns // 12)
    wide = cv2.blur(evidence, (min(stride, 3), 1), borderType=cv2.BORDER_REPLICATE)
    places = np.arange(0, columns, stride)
    first, middle, last = (axis.ravel() for axis in np.meshgrid(places, places, places, indexing="ij"))
    u = fraction
    shape = np.stack([(1 - u) * (1 - 2 * u), 4 * u * (1 - u), u * (2 * u - 1)])
    column = np.rint(np.stack([first, middle, last], axis=1) @ shape).astype(np.intp)
    held = (column >= 0) & (column < columns)
    gathered = np.where(held, wide[np.arange(blocks), np.clip(column, 0, columns - 1)], 0.0).sum(axis=1)
    total = gathered - start_cost[first] - end_cost[last]
    best = int(np.argmax(total))
    return np.clip(np.array([first[best], middle[best], last[best]]) @ shape, 0, columns - 1), float(total[best])


def best_path(
    evidence: FloatArray, start_cost: FloatArray, end_cost: FloatArray, bend: float = BEND
) -> tuple[FloatArray, float]:
    """Most likely smooth path through evidence (M, K): column of each block (M,) and its total.

    Neighbouring blocks differ by some ``bend`` px; the costs (K,) are those of the first and the last block's offset.
    """
    blocks, columns = evidence.shape
    reach = max(1, int(3 * bend / STEP_PX))
    moves = np.arange(-reach, reach + 1)
    toll = 0.5 * (moves * STEP_PX / bend) ** 2
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

    Returns:
        The moved curve.
    """
    here = curve.moved(picture.origin, picture.scale)
    given = (anchors - picture.origin) * picture.scale
    loose = max(slack * picture.scale, 0.7)
    prior = Prior(given, loose)
    for passed, half_range in enumerate(RANGES[min(level, 1)]):
        seen = look(picture.grey, here, half_range)
        costs = end_costs(here, given, loose, seen.offsets)
        found = [
            (*best_bow(seen.fraction, evidence, *costs), evidence)
            if passed < BOWS - level
            else (*best_path(evidence, *costs), evidence)
            for evidence in polarities(seen.signed, seen.inside)
        ]
        path, _, evidence = max(found, key=lambda one: one[1])
        rows = np.arange(len(path))
        nearest = np.rint(path).astype(np.intp)
        strength = np.maximum(evidence[rows, nearest], 0.0)
        offset = seen.offsets[0] + STEP_PX * path
        # a block at the very edge of the ribbon has not found a summit
        precision = np.clip(strength / MOST, 0.0, 1.0) / 0.7**2
        for _ in range(2):
            moved, predicted = adjust(here, seen.fraction, offset, precision, prior)
            rest = offset - predicted
            precision = np.clip(strength / MOST, 0.0, 1.0) / 0.7**2 / (1 + (rest / 1.0) ** 2)
        here = moved
    return here.moved(-picture.origin * picture.scale, 1 / picture.scale)


def end_costs(curve: Curve, anchors: FloatArray, slack: float, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What a path pays to begin and to end at each offset (K,) from a curve; anchors (2, 2) are sure to ``slack``."""
    first, last = (0.5 * ((offsets - _anchor_offset(curve, anchors, end)) / slack) ** 2 for end in (0, 1))
    return first, last


def _anchor_offset(curve: Curve, anchors: FloatArray, end: int) -> float:
    """How far an anchor lies from its end of the curve along the normal there, px."""
    inner = curve.conic(np.array([0.02 if end == 0 else 0.98]))[0]
    tip = curve.control[2 * end]
    tangent = inner - tip if end == 0 else tip - inner
    tangent /= max(float(np.hypot(*tangent)), 1e-9)
    normal = np.array([-tangent[1], tangent[0]])
    return float((anchors[end] - tip) @ normal)
