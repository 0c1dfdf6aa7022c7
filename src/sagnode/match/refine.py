"""From a curve that is nearly right to sub-pixel observations of the wire across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.localise import Blocks, localise
from sagnode.match.ribbon import SIDE_OFFSET_PX, arc_length, lookup, normals, pair_response
from sagnode.match.templates import View, even_parameters

WINDOW_PX = 24.0
WINDOW_SHARE = 0.04
WINDOW_RANK = 0.95
"""A window is seen when it responds more strongly than 95 % of the shifted curves there: by chance one in twenty."""
SHIFTS_PX = (16.0, -16.0, 23.0, -23.0, 31.0, -31.0, 11.0, -11.0)
"""Where the same curve is laid beside the wire to learn what the background alone looks like."""
FALSE_PEAK_POWER = 6.0
MAX_SAMPLES = 6000
MIN_LENGTH_PX = 16
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
class Track:
    """One curve in the picture, sampled about one pixel apart over its visible part.

    Attributes:
        t: curve parameters (N,).
        pixels: (N, 2).
        normal: unit normals (N, 2).
        width: projected width of the conductor, px (N,).
        arc: position along the curve, px (N,).
    """

    t: FloatArray
    pixels: FloatArray
    normal: FloatArray
    width: FloatArray
    arc: FloatArray


@dataclass(frozen=True)
class Observed:
    """The wire's offsets from a track, block by block, with what the background does at the same places.

    Attributes:
        track: the curve that was looked along.
        t: curve parameter of each block's centre (M,).
        arc: its position along the curve, px (M,).
        pixel: its pixel on the curve (M, 2).
        normal: unit normal there (M, 2).
        offset: of the wire along the normal, px (M,).
        sigma: standard uncertainty of the offset, px (M,): noise, and the chance that it is not the wire.
        rank: share of shifted curves that look less like a wire here (M,), 0..1.
        usable: blocks inside the frame, ranked above the background, not near another wire (M,).
        masked: blocks left out because another wire runs there (M,).
    """

    track: Track
    t: FloatArray
    arc: FloatArray
    pixel: FloatArray
    normal: FloatArray
    offset: FloatArray
    sigma: FloatArray
    rank: FloatArray
    usable: NDArray[np.bool_]
    masked: NDArray[np.bool_]


def trace(view: View, sag: float, swing: float, margin: float = 3.0) -> Track | None:
    """The visible part of a curve, one sample a pixel; None when fewer than two blocks of it are in the frame."""
    rough = even_parameters(view, sag, swing, 64, margin)
    if rough.size < 2:
        return None
    pixels, _ = view.pixels(sag, swing, rough)
    length = float(np.nansum(np.hypot(*np.diff(pixels, axis=0).T)))
    count = min(int(length) + 1, MAX_SAMPLES)
    if count < MIN_LENGTH_PX:
        return None
    t = even_parameters(view, sag, swing, count, margin)
    pixels, depth = view.pixels(sag, swing, t)
    keep = np.isfinite(pixels).all(axis=1)
    t, pixels, depth = t[keep], pixels[keep], depth[keep]
    return Track(t, pixels, normals(pixels), view.width_px(depth), arc_length(pixels))


def observe(
    image: GreyImage, track: Track, half_range: float, others: list[FloatArray], block_px: float, shifts: int, run: int
) -> Observed:
    """Measure the wire's offset in every block of a track.

    Args:
        image: raw grey frame.
        track: the predicted curve.
        half_range: how far across the curve to look, px.
        others: polylines (K, 2) of other known wires; blocks that could see them are masked.
        block_px: length of a block; long blocks see fainter wires once the curve is nearly right.
        shifts: how many shifted curves a block is ranked against, nearest first.
        run: least number of usable blocks in a row.
    """
    blocks = localise(image, track.pixels, track.normal, track.width, half_range, block_px)
    rank, lead = _rank(image, track, blocks, half_range, block_px, SHIFTS_PX[:shifts])
    index = np.clip(np.round(blocks.index).astype(np.intp), 0, len(track.t) - 1)
    pixel, normal = track.pixels[index], track.normal[index]
    reach = _reach(track, half_range)
    masked = _folds_back(track, index, reach)
    for other in others:
        masked |= _near(pixel, normal, other, reach)
    usable = blocks.valid & (rank >= RANK_MIN) & ~masked
    usable &= _neighbours_agree(blocks, usable)
    usable &= _in_runs(usable, run)
    return Observed(
        track,
        track.t[index],
        track.arc[index],
        pixel,
        normal,
        np.nan_to_num(blocks.offset),
        np.hypot(np.nan_to_num(blocks.sigma, nan=1e3), _false_peak_sigma(lead, half_range)),
        rank,
        usable,
        masked,
    )


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


def _neighbours_agree(blocks: Blocks, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which blocks (M,) have enough usable neighbours on the same smooth line."""
    count = np.zeros(len(usable), dtype=int)
    offset, arc = np.nan_to_num(blocks.offset), blocks.arc
    for k in range(1, NEIGHBOURS + 1):
        if len(usable) <= k:
            break
        limit = NEIGHBOUR_PX + NEIGHBOUR_SLOPE * (arc[k:] - arc[:-k])
        same = usable[k:] & usable[:-k] & (np.abs(offset[k:] - offset[:-k]) < limit)
        count[k:] += same
        count[:-k] += same
    # at the ends of the curve half of the neighbours do not exist
    position = np.arange(len(usable))
    exist = np.minimum(position, NEIGHBOURS) + np.minimum(len(usable) - 1 - position, NEIGHBOURS)
    result: NDArray[np.bool_] = count >= np.minimum(NEIGHBOURS, np.ceil(exist / 2))
    return result


def runs_near(track: Track, others: list[FloatArray], half_range: float) -> bool:
    """Whether any other polyline (K, 2) comes so close to a track that its blocks would be masked."""
    every = slice(None, None, 8)
    pixels, normal = track.pixels[every], track.normal[every]
    return any(_near(pixels, normal, other, _reach(track, half_range)).any() for other in others)


def _reach(track: Track, half_range: float) -> float:
    """Distance across the curve within which another wire disturbs a block, px."""
    return half_range + 3.0 + 0.5 * float(np.median(track.width))


def _rank(
    image: GreyImage, track: Track, blocks: Blocks, half_range: float, block_px: float, shifts: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Share of the shifted curves on which the same place looks less like a wire (M,), and by how much it leads (M,).

    A place is a block and its two neighbours: a faint wire goes on through all three, a speck of texture does not. The
    lead is its signal-to-noise ratio over the second best of the shifted curves (the best may be another wire).
    """
    here = _with_neighbours(blocks)
    index = np.clip(np.round(blocks.index).astype(np.intp), 0, len(track.t) - 1)
    beside = np.empty((len(shifts), len(here)))
    for row, shift in enumerate(shifts):
        away = np.sign(shift) * (abs(shift) + half_range)
        aside = localise(image, track.pixels + away * track.normal, track.normal, track.width, half_range, block_px)
        # the shifted curve is a little longer or shorter, so its blocks are met by their sample, not by their number
        same = np.abs(aside.index[None, :] - blocks.index[:, None]).argmin(axis=1)
        # a block that leaves the frame when shifted proves nothing, for or against
        inside = np.isfinite(lookup(image, track.pixels[index] + away * track.normal[index]))
        beside[row] = np.where(inside, _with_neighbours(aside)[same], here)
    rank = np.mean(np.where(beside == here, 0.5, beside < here), axis=0)
    return rank, here / np.maximum(np.sort(beside, axis=0)[-2], 1.0)


def _false_peak_sigma(lead: FloatArray, half_range: float) -> FloatArray:
    """Standard deviation (M,) that the chance of having taken texture for the wire adds to an offset, px.

    A block that leads the background by nothing is as likely texture as wire, and texture's offset is anywhere within
    the range; the chance falls steeply with the lead.
    """
    chance = 0.5 * np.maximum(lead, 1.0) ** -FALSE_PEAK_POWER
    return np.asarray(half_range * np.sqrt(chance / 3.0))


def _with_neighbours(blocks: Blocks) -> FloatArray:
    """Root mean square signal-to-noise ratio of each block and its two neighbours (M,)."""
    padded = np.pad(blocks.snr**2, 1, mode="edge")
    return np.asarray(np.sqrt((padded[:-2] + padded[1:-1] + padded[2:]) / 3))


def _folds_back(track: Track, index: NDArray[np.intp], reach: float) -> NDArray[np.bool_]:
    """Which samples (M,) have another stretch of the same curve within reach: its two halves seen along the line."""
    every = slice(None, None, 4)
    pixels, arc, normal = track.pixels[every], track.arc[every], track.normal[every]
    difference = pixels[None, :, :] - track.pixels[index][:, None, :]
    across = np.abs(np.einsum("mki,mi->mk", difference, track.normal[index]))
    distance = np.hypot(difference[..., 0], difference[..., 1])
    away = np.abs(arc[None, :] - track.arc[index][:, None])
    turned = track.normal[index] @ normal.T < 0.5
    elsewhere = (away > 2 * np.pi * reach) | ((away > reach) & turned)
    result: NDArray[np.bool_] = (elsewhere & (across < reach) & (distance < reach + 12.0)).any(axis=1)
    return result


def _near(pixel: FloatArray, normal: FloatArray, other: FloatArray, reach: float) -> NDArray[np.bool_]:
    """Which points (M, 2) have another polyline (K, 2) within ``reach`` px across the curve (and 12 px along it)."""
    finite = other[np.isfinite(other).all(axis=1)]
    if not len(finite):
        return np.zeros(len(pixel), dtype=bool)
    difference = finite[None, :, :] - pixel[:, None, :]
    across = np.einsum("mki,mi->mk", difference, normal)
    along = difference[..., 0] * normal[:, None, 1] - difference[..., 1] * normal[:, None, 0]
    result: NDArray[np.bool_] = ((np.abs(across) < reach) & (np.abs(along) < 12.0)).any(axis=1)
    return result


@dataclass(frozen=True)
class Sighting:
    """Whether there is a wire on a track, by comparison with the same curve shifted 8 to 40 px to both sides.

    Attributes:
        score: robust z-score of the mean response on the track among the shifted ones.
        seen: samples (N,) that belong to a window in which the track stands out.
    """

    score: float
    seen: NDArray[np.bool_]


def sight(image: GreyImage, track: Track) -> Sighting:
    """Shifted-curve test of a whole track, and of windows along it."""
    shifts = np.concatenate([[0.0], np.arange(8.0, 41.0, 2.0), -np.arange(8.0, 41.0, 2.0)])
    centre = track.pixels[None] + shifts[:, None, None] * track.normal[None]
    side = np.maximum(SIDE_OFFSET_PX, 0.5 * track.width + 1.5)[:, None] * track.normal
    response = pair_response(image, centre, np.broadcast_to(side, centre.shape))
    whole = _means(response)
    background = whole[1:][np.isfinite(whole[1:])]
    score = 0.0
    if len(background) >= 6 and np.isfinite(whole[0]):
        middle = np.median(background)
        spread = 1.4826 * np.median(np.abs(background - middle))
        score = float((whole[0] - middle) / max(float(spread), 0.05))
    seen = np.zeros(len(track.t), dtype=bool)
    for window in _windows(track):
        means = _means(response[:, window])
        beside = means[1:][np.isfinite(means[1:])]
        if len(beside) >= 6 and np.isfinite(means[0]):
            seen[window] = np.mean(means[0] > beside) >= WINDOW_RANK
    return Sighting(score, seen)


def _means(response: NDArray[np.float32]) -> FloatArray:
    """Mean over the samples (K, N) in the frame of each shift (K,); NaN where less than half of them are."""
    inside = np.isfinite(response)
    total = np.where(inside, response, 0.0).sum(axis=1)
    count = inside.sum(axis=1)
    return np.where(count > 0.5 * response.shape[1], total / np.maximum(count, 1), np.nan)


def _windows(track: Track) -> list[slice]:
    """Stretches of at least WINDOW_PX in the picture and WINDOW_SHARE of the span, covering the track."""
    windows, start = [], 0
    for end in range(1, len(track.t) + 1):
        long_enough = track.arc[end - 1] - track.arc[start] >= WINDOW_PX
        if long_enough and abs(track.t[end - 1] - track.t[start]) >= WINDOW_SHARE:
            windows.append(slice(start, end))
            start = end
    if windows and start < len(track.t):
        # a remainder too short to be judged by itself is judged with the stretch before it
        windows[-1] = slice(windows[-1].start, len(track.t))
    return windows or [slice(0, len(track.t))]
