"""Where a wire lies across a nearly right curve, block by block, to a few hundredths of a pixel.

The picture is straightened along the curve (1 sample a pixel along, ½ px across), blocks of some 8 px are averaged
along it, and each block's profile is compared with the profile that a wire of the expected width would have: a box of
that width, blurred by the lens and the sensor. The kernel and every window have their mean and slope taken out, so
that a sky's gradient or a hillside's edge does not pull the wire; the sign is free, so that a wire may be dark before
the sky and bright before trees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.across import AnyGrey, Seen, Stretch, look_across
from sagnode.match.kernels import BLUR_PX, MARGIN_PX, STEP_PX
from sagnode.match.ribbon import arc_length
from sagnode.native import kernels

SURE_PX = 0.02
"""Uncertainty from noise below which a block has seen the wire: hardly anything else in a picture is as clear."""
ROWS = 16
"""Rows that the compiled way works in: five of its results, and what two looks say of each block."""


@dataclass(frozen=True)
class Blocks:
    """One wire position per block (M blocks in order along the curve).

    Attributes:
        index: centre of the block as a fractional index into the curve's samples (M,).
        arc: position of that centre along the curve, px (M,).
        offset: of the wire from the curve along the normal, px (M,); NaN where not valid.
        sigma: standard uncertainty of the offset from white noise, px (M,); NaN where not valid.
        snr: amplitude of the wire's profile over its own uncertainty (M,); 0 where not valid.
        correlation: of the profile with the kernel, 0..1 (M,); how much the block looks like a wire at all.
        contrast: wire minus background, grey levels (M,); negative for a dark wire.
        valid: a peak inside the range, in a block inside the frame (M,).
        scatter: standard uncertainty of the offset by which the block's two halves contradict each other more than
            noise makes them, px (M,); 0 where that was not asked for.
    """

    index: FloatArray
    arc: FloatArray
    offset: FloatArray
    sigma: FloatArray
    snr: FloatArray
    correlation: FloatArray
    contrast: FloatArray
    valid: NDArray[np.bool_]
    scatter: FloatArray


@dataclass(frozen=True)
class Beside:
    """What the same blocks show on the same curve shifted across (S shifts, M blocks).

    Attributes:
        snr: as in :class:`Blocks` (S, M).
        inside: which shifted blocks have their centres in the frame (S, M).
    """

    snr: FloatArray
    inside: NDArray[np.bool_]


def localise(
    image: AnyGrey,
    pixels: FloatArray,
    normal: FloatArray,
    width_px: ArrayLike,
    half_range_px: float,
    block_px: float = 8.0,
    blur_px: float = BLUR_PX,
    margin_px: float = MARGIN_PX,
    *,
    exact: bool = True,
) -> Blocks:
    """Measure the wire's offset across a curve in blocks along it.

    Args:
        image: grey picture (height, width), 8 bit or single precision.
        pixels: the curve (N, 2), samples about 1 px apart.
        normal: its unit normals (N, 2).
        width_px: expected width of the wire, one value or (N,).
        half_range_px: greatest offset looked for, either side.
        block_px: length of a block along the curve.
        blur_px: standard deviation of the picture's blur.
        margin_px: background taken in on either side; less than MARGIN_PX where a neighbour is near.
        exact: look closer at what was found (see :mod:`sagnode.match.closer`).

    Returns:
        The blocks; empty arrays for fewer than two samples.
    """
    own = (image, pixels, normal, width_px, half_range_px, (), block_px, blur_px, margin_px)
    return localise_beside(*own, exact=exact)[0]


def localise_beside(
    image: AnyGrey,
    pixels: FloatArray,
    normal: FloatArray,
    width_px: ArrayLike,
    half_range_px: ArrayLike,
    shifts_px: Sequence[float],
    block_px: float = 8.0,
    blur_px: float = BLUR_PX,
    margin_px: float = MARGIN_PX,
    members: FloatArray | None = None,
    halves: bool = False,
    *,
    exact: bool = True,
) -> tuple[Blocks, Beside]:
    """Measure the wire's offset as :func:`localise` does, and look likewise about the curve shifted across.

    One ribbon serves all: it is as wide as the farthest shift (``shifts_px``, px along the normal) asks for.
    ``half_range_px`` may be one value or (N,): where the wire is known to be near, less need be looked at.

    ``members`` (m, N) are the offsets across the curve, px, of the sub-conductors of a bundle whose centre line the
    curve is. Each has its ribbon, and a kernel that shows the others where they are near; their scores add up, so that
    the offset is that of the whole pattern, and where the pattern lies a whole spacing off, only a part of it fits.

    With ``halves`` each half of a block that is not quite clear is measured too: a wire runs on through both, while the
    edge of something else that crosses the curve has moved aside from one to the other.

    ``exact`` looks closer at what was found (see :mod:`sagnode.match.closer`).
    """
    if len(pixels) < 2:
        nothing = np.empty(0)
        empty = np.empty((len(shifts_px), 0))
        blocks = Blocks(nothing, nothing, nothing, nothing, nothing, nothing, nothing, np.empty(0, dtype=bool), nothing)
        return blocks, Beside(empty, empty.astype(bool))
    arc = arc_length(pixels)
    starts = block_starts(arc, block_px)
    width, half_range = (_along(arc, value) for value in (width_px, half_range_px))
    members = np.zeros((1, len(pixels))) if members is None else members
    centres = np.rint(np.array([0.0, *shifts_px]) / STEP_PX).astype(np.int64)
    stretch = Stretch(pixels, normal, width, half_range, members, starts, blur_px, margin_px, exact)
    seen = _seen(image, stretch, centres)
    size = stretch.block_sizes()
    offset, sigma, snr, correlation, contrast = seen.blocks
    blocks = Blocks(
        index=starts + 0.5 * (size - 1),
        arc=np.add.reduceat(arc, starts) / size,
        offset=offset,
        sigma=sigma,
        snr=snr,
        correlation=correlation,
        contrast=contrast,
        valid=seen.valid,
        scatter=_scatter(image, stretch, size, halves & (sigma > SURE_PX)),
    )
    return blocks, Beside(seen.beside, seen.inside)


def _along(arc: FloatArray, value: ArrayLike) -> FloatArray:
    """What is said of all samples of a curve, or of each (N,), as said of each."""
    own = np.asarray(value, dtype=np.float64)
    return own if own.shape == arc.shape else np.full(arc.shape, own)


def _scatter(image: AnyGrey, stretch: Stretch, size: NDArray[np.int64], asked: NDArray[np.bool_]) -> FloatArray:
    """By how much blocks of ``size`` (M,) samples are less certain than their noise says, px (M,): from their halves.

    Only of those ``asked`` for (M,). A half that shows nothing contradicts nothing.
    """
    scatter = np.zeros(len(size))
    if not asked.any() or not (size > 1).all():
        return scatter
    first = np.cumsum(size[asked]) - size[asked]
    starts = np.stack([first, first + size[asked] // 2], axis=1)
    some = stretch if asked.all() else _of(stretch, np.flatnonzero(np.repeat(asked, size)))
    halves = replace(some, starts=starts.ravel(), exact=False)
    seen = _seen(image, halves, np.zeros(1, dtype=np.int64))
    offset, sigma = (part.reshape(starts.shape) for part in seen.blocks[:2])
    excess = np.diff(offset, axis=1)[:, 0] ** 2 - np.sum(sigma**2, axis=1)
    # the mean of two values is as uncertain as half their difference
    scatter[asked] = 0.5 * np.sqrt(np.maximum(np.nan_to_num(excess), 0.0))
    return scatter


def _of(stretch: Stretch, own: NDArray[np.intp]) -> Stretch:
    """Some of the samples of a stretch."""
    return replace(
        stretch,
        pixels=stretch.pixels.take(own, axis=0),
        normal=stretch.normal.take(own, axis=0),
        width=stretch.width.take(own),
        half_range=stretch.half_range.take(own),
        members=stretch.members.take(own, axis=1),
    )


def _seen(image: AnyGrey, stretch: Stretch, centres: NDArray[np.int64]) -> Seen:
    """:func:`look_across`, compiled where it can be."""
    if kernels is None:
        return look_across(image, stretch, centres)
    count, places = len(stretch.starts), len(centres) - 1
    blocks, valid = np.empty((ROWS, count)), np.empty(count, dtype=bool)
    beside, inside = np.empty((places, count)), np.empty((places, count), dtype=bool)
    kernels.localise(
        image,
        stretch.pixels,
        stretch.normal,
        stretch.width,
        stretch.half_range,
        stretch.members,
        stretch.starts,
        centres,
        stretch.blur_px,
        stretch.margin_px,
        stretch.exact,
        blocks,
        valid,
        beside,
        inside,
    )
    return Seen(blocks[:5], valid, beside, inside)


def block_starts(arc: FloatArray, block_px: float) -> NDArray[np.int64]:
    """First sample of each of the equal blocks that come nearest to ``block_px``."""
    count = max(1, round(float(arc[-1]) / block_px))
    member = np.minimum((arc * (count / max(float(arc[-1]), 1e-9))).astype(np.int64), count - 1)
    first = np.ones(len(member), dtype=bool)
    np.not_equal(member[1:], member[:-1], out=first[1:])
    return np.flatnonzero(first).astype(np.int64, copy=False)
