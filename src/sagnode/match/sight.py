"""Whether there is a wire on a curve at all: the same curve laid beside it tells how its surroundings respond."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.bundle import lines
from sagnode.match.ribbon import line_response
from sagnode.match.robust import median
from sagnode.match.track import Track

WINDOW_PX = 24.0
WINDOW_SHARE = 0.04
WINDOW_RANK = 0.95
"""A window is seen when it responds more strongly than 95 % of the shifted curves there,"""
WINDOW_CHANCE = 2 / 35
"""which of 34 shifted curves and the track one of the two strongest is: by chance about one in twenty."""
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
