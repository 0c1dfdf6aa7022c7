"""Which blocks of a curve stand out from what the same curve sees beside the wire, and go on from block to block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.localise import Beside, Blocks
from sagnode.native import kernels

FALSE_PEAK_POWER = 6.0
TEXTURE_SNR = 2.0
UNKNOWN_PX = 1e3
"""Uncertainty where there is none of the noise: what is not valid counts for nothing."""
RANK_MIN = 0.9
NEIGHBOURS = 3
"""A block counts only if at least this many of the three blocks to either side see the wire where it would run on.

Background texture passes the rank test now and then, but at unrelated offsets; lone blocks of it would pull an unseen
stretch of the curve and, worse, make it look certain.
"""
NEIGHBOUR_PX = 0.8
NEIGHBOUR_SLOPE = 0.06
"""Two blocks agree when their offsets differ by less than NEIGHBOUR_PX plus this much for every px between them."""


@dataclass(frozen=True)
class Standing:
    """What M blocks are worth.

    Attributes:
        offset: of the wire, px (M,); 0 where none was found.
        sigma: standard uncertainty of the offset, px (M,): noise, and the chance that it is not the wire.
        rank: share of shifted curves that look less like a wire here (M,), 0..1.
        usable: which of them count (M,).
    """

    offset: FloatArray
    sigma: FloatArray
    rank: FloatArray
    usable: NDArray[np.bool_]


def stand_out(
    blocks: Blocks, beside: Beside, masked: NDArray[np.bool_], half_range: FloatArray, widest: float, run: int
) -> Standing:
    """Judge blocks of which some are masked, by at least two places beside the curve.

    ``half_range`` (M,), px, is how far aside each was looked for; where that is less than ``widest``, the rest of the
    wire foretells it. ``run`` is the least number of usable blocks in a row.
    """
    if kernels is not None:
        rank, offset, sigma = np.empty((3, len(masked)))
        usable = np.empty(len(masked), dtype=bool)
        parts = (blocks.offset, blocks.sigma, blocks.snr, blocks.arc, blocks.valid, beside.snr, beside.inside)
        kernels.stand_out(*parts, masked, half_range, widest, run, rank, offset, sigma, usable)
        return Standing(offset, sigma, rank, usable)
    rank, lead = _rank(blocks, beside)
    usable = blocks.valid & (rank >= RANK_MIN) & ~masked
    usable &= _neighbours_agree(blocks, usable, masked, half_range < widest)
    usable &= _in_runs(usable, run)
    # texture must look like a wire about here, and the block must be weak enough to be texture: the lead by itself is
    # small wherever other wires run beside, however plain this one is
    false = np.minimum(_false_peak_sigma(lead, half_range), texture_sigma(blocks.snr, half_range))
    sigma = np.hypot(np.nan_to_num(blocks.sigma, nan=UNKNOWN_PX), false)
    return Standing(np.nan_to_num(blocks.offset), sigma, rank, usable)


def _rank(blocks: Blocks, beside: Beside) -> tuple[FloatArray, FloatArray]:
    """Share of the shifted curves on which the same place looks less like a wire (M,), and by how much it leads (M,).

    A place is a block and its two neighbours: a faint wire goes on through all three, a speck of texture does not. The
    lead is its signal-to-noise ratio over the second best of the shifted curves (the best may be another wire).
    """
    here = _with_neighbours(blocks.snr)
    # a block that leaves the frame when shifted proves nothing, for or against
    there = np.where(beside.inside, _with_neighbours(beside.snr), here)
    rank = np.mean(np.where(there == here, 0.5, there < here), axis=0)
    return rank, here / np.maximum(np.sort(there, axis=0)[-2], 1.0)


def _false_peak_sigma(lead: FloatArray, half_range: FloatArray) -> FloatArray:
    """Standard deviation (M,) that the chance of having taken texture for the wire adds to an offset, px.

    A block that leads the background by nothing is as likely texture as wire, and texture's offset is anywhere within
    the range; the chance falls steeply with the lead.
    """
    return spread_by(0.5 * np.maximum(lead, 1.0) ** -FALSE_PEAK_POWER, half_range)


def texture_sigma(snr: FloatArray, half_range: FloatArray) -> FloatArray:
    """The same chance (M,) of a block by itself, px: strong neighbours lead for it, but it may look at a leaf between.

    The stronger a peak, the rarer it is among texture's: by e for every TEXTURE_SNR of its signal-to-noise ratio.
    """
    return spread_by(np.minimum(0.5, np.exp((1.0 - snr) / TEXTURE_SNR)), half_range)


def spread_by(chance: FloatArray, half_range: FloatArray) -> FloatArray:
    """Standard deviation (M,), px, by a chance (M,) that an offset is anywhere within its range."""
    return np.asarray(half_range * np.sqrt(chance / 3.0))


def chance_of(spread: FloatArray, half_range: FloatArray) -> FloatArray:
    """The chance (M,) that causes such a standard deviation; at most a half, as before looking where the block lies."""
    return np.asarray(np.minimum(3.0 * (spread / half_range) ** 2, 0.5))


def _with_neighbours(snr: FloatArray) -> FloatArray:
    """Root mean square signal-to-noise ratio (..., M) of each block and its two neighbours."""
    squared = snr**2
    total = squared.copy()
    total[..., 1:] += squared[..., :-1]
    total[..., :-1] += squared[..., 1:]
    # the first and the last block are their own neighbours
    total[..., 0] += squared[..., 0]
    total[..., -1] += squared[..., -1]
    return np.asarray(np.sqrt(total / 3))


def _in_runs(usable: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Usable blocks (M,) in stretches of at least ``least`` of them, a single block missing here or there."""
    if least <= 1:
        return usable
    closed = usable | (np.roll(usable, 1) & np.roll(usable, -1))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], closed, [False]]).astype(int)))
    result = np.zeros_like(usable)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if int(usable[start:end].sum()) >= least:
            result[start:end] = usable[start:end]
    return result


def _neighbours_agree(
    blocks: Blocks, usable: NDArray[np.bool_], masked: NDArray[np.bool_], foretold: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which blocks (M,) have enough usable neighbours on the same smooth line.

    Masked ones are none; where the rest of the wire foretells the place, that is one of them.
    """
    count, exist = np.zeros((2, len(usable)), dtype=int)
    offset, arc = np.nan_to_num(blocks.offset), blocks.arc
    for k in range(1, NEIGHBOURS + 1):
        if len(usable) <= k:
            break
        limit = NEIGHBOUR_PX + NEIGHBOUR_SLOPE * (arc[k:] - arc[:-k])
        same = usable[k:] & usable[:-k] & (np.abs(offset[k:] - offset[:-k]) < limit)
        count[k:] += same
        count[:-k] += same
        exist[k:] += ~masked[:-k]
        exist[:-k] += ~masked[k:]
    # at the ends of the curve half of the neighbours do not exist
    result: NDArray[np.bool_] = count + foretold >= np.clip(np.ceil(exist / 2), 1 + foretold, NEIGHBOURS)
    return result
