"""From a curve that is nearly right to sub-pixel observations of the wire across it."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.bundle import lines
from sagnode.match.kernels import MARGIN_PX
from sagnode.match.localise import Beside, Blocks, localise_beside
from sagnode.match.ribbon import arc_length, line_response, normals
from sagnode.match.robust import median
from sagnode.match.templates import View, visible_part
from sagnode.native import kernels

WINDOW_PX = 24.0
WINDOW_SHARE = 0.04
WINDOW_RANK = 0.95
"""A window is seen when it responds more strongly than 95 % of the shifted curves there,"""
WINDOW_CHANCE = 2 / 35
"""which of 34 shifted curves and the track one of the two strongest is: by chance about one in twenty."""
SHIFTS_PX = (16.0, -16.0, 23.0, -23.0, 31.0, -31.0, 11.0, -11.0)
"""Where the same curve is laid beside the wire to learn what the background alone looks like."""
FALSE_PEAK_POWER = 6.0
MAX_SAMPLES = 6000
MIN_LENGTH_PX = 16
MOST_COMPARED, MOST_SIGHTED = 300, 600
"""Samples along a curve that suffice to see whether it folds back, and whether it lies on a wire."""
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

    def wires(self) -> list[FloatArray]:
        """Polylines (N, 2) of the wires themselves."""
        return [self.pixels + offset[:, None] * self.normal for offset in self.members]

    def response(self, image: GreyImage, some: slice | NDArray[np.intp] = slice(None)) -> FloatArray:
        """Response (n,) of some samples, grey levels; NaN outside the frame."""
        place, side = lines(self.members[:, some], self.width[some])
        return line_response(image, self.pixels[some], self.normal[some], place, side).astype(np.float64)


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
    return np.minimum(np.searchsorted(share, np.linspace(0.0, 1.0, count)), len(share) - 1)


def near_another(track: Track, other: Track, reach: float) -> NDArray[np.bool_]:
    """Which samples (N,) of a track have another within ``reach`` px across it."""
    every = max(1, len(track.t) // MOST_COMPARED)
    pixels = track.pixels[::every]
    near = _near(pixels, track.normal[::every], other.pixels, np.full(len(pixels), reach))
    return np.repeat(near, every)[: len(track.t)]


def observe(
    image: GreyImage,
    track: Track,
    half_range: float | FloatArray,
    others: list[FloatArray],
    block_px: float,
    shifts: int,
    run: int,
    margin: float = MARGIN_PX,
) -> Observed:
    """Measure the wire's offset in every block of a track.

    Args:
        image: raw grey frame.
        track: the predicted curve.
        half_range: how far across the curve to look, px; one value, or one for every sample (N,).
        others: polylines (K, 2) of other known wires; blocks that could see them are masked.
        block_px: length of a block; long blocks see fainter wires once the curve is nearly right.
        shifts: how many shifted curves a block is ranked against, nearest first.
        run: least number of usable blocks in a row.
        margin: background taken in on either side, px.
    """
    widest = float(np.max(half_range))
    away = [np.sign(shift) * (abs(shift) + widest) for shift in SHIFTS_PX[:shifts]]
    blocks, beside = localise_beside(
        image,
        track.pixels,
        track.normal,
        track.width,
        half_range,
        away,
        block_px,
        margin_px=margin,
        members=track.members,
    )
    rank, lead = _rank(blocks, beside)
    index = np.clip(np.round(blocks.index).astype(np.intp), 0, len(track.t) - 1)
    pixel, normal = track.pixels[index], track.normal[index]
    own_range = np.broadcast_to(half_range, track.t.shape)[index]
    reach = _reach(track, index, own_range) + margin - MARGIN_PX
    masked = _folds_back(track, index, reach)
    for other in others:
        masked |= _near(pixel, normal, other, reach)
    usable = blocks.valid & (rank >= RANK_MIN) & ~masked
    usable &= _neighbours_agree(blocks, usable, masked, own_range < widest)
    usable &= _in_runs(usable, run)
    return Observed(
        track,
        track.t[index],
        track.arc[index],
        pixel,
        normal,
        np.nan_to_num(blocks.offset),
        np.hypot(np.nan_to_num(blocks.sigma, nan=1e3), _false_peak_sigma(lead, own_range)),
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


def runs_near(track: Track, others: list[FloatArray], half_range: float) -> bool:
    """Whether any other polyline (K, 2) comes so close to a track that its blocks would be masked."""
    every = np.arange(0, len(track.t), 8)
    pixels, normal, reach = track.pixels[every], track.normal[every], _reach(track, every, half_range)
    return any(_near(pixels, normal, other, reach).any() for other in others)


def _reach(track: Track, index: NDArray[np.intp], half_range: float | FloatArray) -> FloatArray:
    """Distance across the curve within which another wire disturbs a block at some samples (M,), px."""
    outermost = np.max(np.abs(track.members[:, index]), axis=0)
    return np.asarray(half_range + 3.0 + 0.5 * median(track.width) + outermost)


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
    chance = 0.5 * np.maximum(lead, 1.0) ** -FALSE_PEAK_POWER
    return np.asarray(half_range * np.sqrt(chance / 3.0))


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


def _folds_back(track: Track, index: NDArray[np.intp], reach: FloatArray) -> NDArray[np.bool_]:
    """Which samples (M,) have another stretch of the same curve within reach: its two halves seen along the line."""
    reach = reach[:, None]
    every = slice(None, None, max(4, len(track.t) // MOST_COMPARED))
    pixels, arc, normal = track.pixels[every], track.arc[every], track.normal[every]
    across, along = _apart(track.pixels[index], track.normal[index], pixels)
    close = (np.abs(across) < reach) & (across**2 + along**2 < (reach + 12.0) ** 2)
    away = np.abs(arc[None, :] - track.arc[index][:, None])
    turned = track.normal[index] @ normal.T < 0.5
    elsewhere = (away > 2 * np.pi * reach) | ((away > reach) & turned)
    return np.asarray((close & elsewhere).any(axis=1))


def _near(pixel: FloatArray, normal: FloatArray, other: FloatArray, reach: FloatArray) -> NDArray[np.bool_]:
    """Which points (M, 2) have another polyline (K, 2) within ``reach`` (M,) px across the curve, 12 px along it."""
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


@dataclass(frozen=True)
class Sighting:
    """Whether there is a wire on a track, by comparison with the same curve shifted 8 to 40 px to both sides.

    Attributes:
        score: robust z-score of the mean response on the track among the shifted ones.
        seen: samples (N,) that belong to a window in which the track stands out.
        chance: probability that so many windows of a track that lies on no wire stand out.
    """

    score: float
    seen: NDArray[np.bool_]
    chance: float = 1.0


def sight(image: GreyImage, track: Track) -> Sighting:
    """Shifted-curve test of a whole track, and of windows along it."""
    every = -(-len(track.t) // MOST_SIGHTED)
    some = slice(None, None, every)
    t, arc = track.t[some], track.arc[some]
    shifts = np.concatenate([[0.0], np.arange(8.0, 41.0, 2.0), -np.arange(8.0, 41.0, 2.0)])
    centre = track.pixels[some] + shifts[:, None, None] * track.normal[some]
    place, side = lines(track.members[:, some], track.width[some])
    response = line_response(image, centre, track.normal[some], place, side)
    score = 0.0
    whole = _means(response)
    background = whole[1:][np.isfinite(whole[1:])]
    if len(background) >= 6 and np.isfinite(whole[0]):
        middle = median(background)
        spread = 1.4826 * median(np.abs(background - middle))
        score = float((whole[0] - middle) / max(spread, 0.05))
    seen = np.zeros(len(t), dtype=bool)
    judged = stand_out = 0
    for window in _windows(t, arc):
        means = _means(response[:, window])
        beside = means[1:][np.isfinite(means[1:])]
        if len(beside) >= 6 and np.isfinite(means[0]):
            seen[window] = np.mean(means[0] > beside) >= WINDOW_RANK
            judged += 1
            stand_out += int(seen[window.start])
    return Sighting(score, np.repeat(seen, every)[: len(track.t)], _chance_of(stand_out, judged, WINDOW_CHANCE))


def _chance_of(successes: int, trials: int, each: float) -> float:
    """Probability of at least so many successes in trials that succeed with the probability ``each``."""
    return sum(comb(trials, k) * each**k * (1 - each) ** (trials - k) for k in range(successes, trials + 1))


def _means(response: NDArray[np.float32]) -> FloatArray:
    """Mean over the samples (K, N) in the frame of each shift (K,); NaN where less than half of them are."""
    inside = np.isfinite(response)
    total = np.where(inside, response, 0.0).sum(axis=1)
    count = inside.sum(axis=1)
    return np.where(count > 0.5 * response.shape[1], total / np.maximum(count, 1), np.nan)


def _windows(t: FloatArray, arc: FloatArray) -> list[slice]:
    """Stretches of at least WINDOW_PX in the picture and WINDOW_SHARE of the span, covering all samples."""
    windows, start = [], 0
    extent = np.abs(t - t[0])
    while start < len(t):
        long_enough = (arc >= arc[start] + WINDOW_PX) & (np.abs(extent - extent[start]) >= WINDOW_SHARE)
        long_enough[: start + 1] = False
        if not long_enough.any():
            break
        end = int(np.argmax(long_enough)) + 1
        windows.append(slice(start, end))
        start = end
    if windows and start < len(t):
        # a remainder too short to be judged by itself is judged with the stretch before it
        windows[-1] = slice(windows[-1].start, len(t))
    return windows or [slice(0, len(t))]
