"""Whether there is a wire on a curve at all: the same curve laid beside it tells how its surroundings respond."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.bundle import lines
from sagnode.match.ribbon import NO_BAND, pooled_response
from sagnode.match.robust import median
from sagnode.match.track import Track
from sagnode.native import kernels

WINDOW_PX = 24.0
WINDOW_SHARE = 0.04
WINDOW_RANK = 0.95
"""A window is seen when it responds more strongly than 95 % of the shifted curves there,"""
WINDOW_CHANCE = 2 / 35
"""which of 34 shifted curves and the track one of the two strongest is: by chance about one in twenty."""
LEAST_COMPARED = 6
"""Shifted curves that must be in the frame to be compared with."""
LEAST_SPREAD = 0.05
"""Of their means, grey levels."""
MOST_SIGHTED = 600
"""Samples along a curve that suffice to see whether it lies on a wire."""


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
    shifts = np.concatenate([[0.0], np.arange(8.0, 41.0, 2.0), -np.arange(8.0, 41.0, 2.0)], dtype=np.float32)[:, None]
    (u, v), (nu, nv) = (part[some].astype(np.float32).T for part in (track.pixels, track.normal))
    shape = (len(shifts), len(t))
    place, side = (part.astype(np.float32)[:, None, :] for part in lines(track.members[:, some], track.width[some]))
    normal = np.broadcast_to(nu, shape), np.broadcast_to(nv, shape)
    best, inside = pooled_response(image, (u + shifts * nu, v + shifts * nv), normal, (place, side), NO_BAND)
    response = np.where(inside, best, np.float32(np.nan))
    stood = compared(response, np.ascontiguousarray(t), np.ascontiguousarray(arc))
    chance = _chance_of(stood.outstanding, stood.judged, WINDOW_CHANCE)
    return Sighting(stood.score, np.repeat(stood.seen, every)[: len(track.t)], chance)


@dataclass(frozen=True)
class Compared:
    """A curve's responses beside those of the same curve shifted aside.

    Attributes:
        score: robust z-score of its mean among the shifted ones; 0 where too little is in the frame.
        seen: samples (N,) that belong to a window in which it stands out.
        judged: windows of which enough is in the frame to be judged.
        outstanding: those among them in which it stands out.
    """

    score: float
    seen: NDArray[np.bool_]
    judged: int
    outstanding: int


def compared(response: NDArray[np.float32], t: FloatArray, arc: FloatArray) -> Compared:
    """Compare the responses (K, N) of a curve, the first row, with those of K - 1 shifted ones; NaN out of the frame.

    ``t`` are the curve's parameters (N,) and ``arc`` the positions along it, px (N,).
    """
    seen = np.zeros(len(t), dtype=bool)
    if kernels is not None:
        score, judged, outstanding = kernels.sight(response, t, arc, seen)
        return Compared(score, seen, judged, outstanding)
    score, judged, outstanding = 0.0, 0, 0
    whole = _means(response)
    background = whole[1:][np.isfinite(whole[1:])]
    if len(background) >= LEAST_COMPARED and np.isfinite(whole[0]):
        middle = median(background)
        spread = 1.4826 * median(np.abs(background - middle))
        score = float((whole[0] - middle) / max(spread, LEAST_SPREAD))
    for window in _windows(t, arc):
        means = _means(response[:, window])
        beside = means[1:][np.isfinite(means[1:])]
        if len(beside) >= LEAST_COMPARED and np.isfinite(means[0]):
            seen[window] = np.mean(means[0] > beside) >= WINDOW_RANK
            judged += 1
            outstanding += int(seen[window.start])
    return Compared(score, seen, judged, outstanding)


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
