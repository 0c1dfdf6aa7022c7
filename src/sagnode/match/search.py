"""Coarse search: which sag and swing put a conductor's curve on something like a wire.

Each stretch of the curve is compared with the picture on the grid of sag × swing that its library has for it; the
stretches' scores are interpolated onto one common grid and added there. The best curves are then moved a little to
where they lie best, so that those which mean the same wire become one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.library import POOL_PX, Library, Places, places_of, trust
from sagnode.match.ribbon import pooled_response
from sagnode.match.shrink import halved
from sagnode.native import kernels

SWING_PRIOR = 0.3
"""Grey levels of mean response that one half-squared standard deviation of swing must earn."""

LEAST_SEEN = 0.2
"""Share of what the best seen curve shows in the frame that a curve must show."""
POLISHED = 8
"""Most peaks of the grid that are looked at more closely, as a rule."""
POLISH = (1.0, 0.4)
"""How far about a peak to look at a time, in steps of the grid."""
ASIDE = np.linspace(-1.0, 1.0, 5)
AROUND = np.array([np.repeat(ASIDE, len(ASIDE)), np.tile(ASIDE, len(ASIDE))])
"""Curves about one that are compared with it: so much of the reach in sag and in swing (2, 25)."""
DISTINCT_PX = 1.5
"""Typical distance, in px and bands, below which two curves are one."""


@dataclass(frozen=True)
class Candidate:
    """A local maximum of the coarse search."""

    sag: float
    swing: float
    score: float
    visible: float


def search(
    image: GreyImage,
    library: Library | None,
    swing_u: float,
    keep: int = 8,
    swing_mean: float = 0.0,
    polished: int = POLISHED,
) -> list[Candidate]:
    """Coarse search over sag × swing; the best, well separated candidates, best first.

    Args:
        image: raw grey frame.
        library: the conductor's curves; None where there is nothing to see.
        swing_u: standard uncertainty of the swing's prior, rad.
        keep: most candidates.
        swing_mean: mean of that prior, rad.
        polished: most peaks of the grid that are looked at more closely.
    """
    if library is None:
        return []
    for box in library.boxes:
        image = halved(image, box)
    scored = [(each.sags, each.swings, *_sums(image, each.places)) for each in library.stretches]
    sags = max((grid[0] for grid in scored), key=len)
    swings = max((grid[1] for grid in scored), key=len)
    total, count = np.zeros((2, len(sags), len(swings)))
    for own_sags, own_swings, own_total, own_count in scored:
        to_sag, to_swing = _interpolation(len(own_sags), len(sags)), _interpolation(len(own_swings), len(swings))
        total += to_sag @ own_total @ to_swing.T
        count += to_sag @ own_count @ to_swing.T
    everything = max(float(np.sum(trust(library.spread))), 1e-6)
    scores, visible = total / np.maximum(count, 1e-6), count / everything
    # the prior on swing decides where the view hardly sees it, and keeps clutter at extreme swings in its place
    expected = (swing_mean, swing_u)
    prior = _swing_penalty(swings, expected)
    found = _peaks(np.where(visible >= LEAST_SEEN * visible.max(initial=0.0), scores - prior, -np.inf), polished)
    if not len(found):
        return []
    best_sags, best_swings = sags[found[:, 0]], swings[found[:, 1]]
    cell = np.array([np.diff(sags[:2]).item(), np.diff(swings[:2]).item() if len(swings) > 1 else 0.0])
    for width in POLISH:
        best_sags, best_swings, score, share = _polished(
            image, library, (best_sags, best_swings), width * cell, expected
        )
    order = np.argsort(_swing_penalty(best_swings, expected) - score)
    candidates = []
    for k in order[_distinct(library, best_sags[order], best_swings[order])][:keep]:
        own = (float(value[k]) for value in (best_sags, best_swings, score, share / everything))
        candidates.append(Candidate(*own))
    return candidates


def _polished(
    image: GreyImage,
    library: Library,
    start: tuple[FloatArray, FloatArray],
    reach: FloatArray,
    expected: tuple[float, float],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The best of the curves about each of some (K,): their sags, swings, scores and weights in the frame (K,).

    ``reach`` is how far to look in sag (m) and swing (rad), ``expected`` the swing's prior, mean and deviation.
    """
    by_sag, by_swing = AROUND if reach[1] > 0 else AROUND[:, :: len(ASIDE)]
    low, high = library.sag_range
    sags = np.minimum(np.maximum(start[0][:, None] + by_sag * reach[0], low), high)
    swings = np.minimum(np.maximum(start[1][:, None] + by_swing * reach[1], -library.swing_max), library.swing_max)
    every = np.arange(len(library.spread))
    places = places_of(library.view, library.family, sags.ravel(), swings.ravel(), every, library.spread)
    total, count = _sums(image, places)
    score = (total / np.maximum(count, 1e-6)).reshape(sags.shape)
    ranked = score - _swing_penalty(swings, expected)
    best = np.arange(len(sags)), np.argmax(ranked, axis=1)
    return sags[best], swings[best], score[best], count.reshape(sags.shape)[best]


def _swing_penalty(swings: FloatArray, expected: tuple[float, float]) -> FloatArray:
    """What some swings (...), rad, must earn by a better response, grey levels."""
    return np.asarray(SWING_PRIOR * 0.5 * ((swings - expected[0]) / expected[1]) ** 2)


def _distinct(library: Library, sags: FloatArray, swings: FloatArray) -> NDArray[np.intp]:
    """Which of some curves (K,), the best first, are not one that came before them."""
    spread = library.spread
    every = np.arange(len(spread))
    u, v, nu, nv, _ = library.family.placed(library.view.intrinsics, every, sags, swings)
    # how far each curve (last axis) lies aside of each (second axis), in bands
    across = (u[:, None] - u[:, :, None]) * nu[:, :, None] + (v[:, None] - v[:, :, None]) * nv[:, :, None]
    typical = np.sqrt(np.mean((across / (1 + np.minimum(spread, POOL_PX))[:, None, None]) ** 2, axis=0))
    kept: list[int] = []
    for k in range(len(sags)):
        if all(typical[k, other] > DISTINCT_PX for other in kept):
            kept.append(k)
    return np.array(kept, dtype=np.intp)


@lru_cache(maxsize=64)
def _interpolation(own: int, common: int) -> FloatArray:
    """Matrix (K, n) of linear interpolation from n even grid points to K over the same range, for n and K."""
    if own == 1:
        return np.ones((common, 1))
    place = np.linspace(0.0, own - 1.0, common)
    first = np.minimum(place.astype(np.intp), own - 2)
    matrix = np.zeros((common, own))
    rows = np.arange(common)
    matrix[rows, first] = 1 - (place - first)
    matrix[rows, first + 1] = place - first
    return matrix


def _sums(image: GreyImage, places: Places) -> tuple[FloatArray, FloatArray]:
    """Sums (...) of the responses at some places, and of the weights of those in the frame."""
    total, count = np.empty((2, places.pixel[0].shape[1]))
    asked = (image, places.pixel, places.normal, places.lines, places.band)
    if kernels is not None:
        kernels.response_sums(image, *asked[1], *asked[2], *asked[3], places.band, places.trust, total, count)
    else:
        response, seen = pooled_response(*asked)
        response[~seen] = 0
        total[:], count[:] = places.trust @ response.astype(np.float32), places.trust @ seen.astype(np.float32)
    return total.reshape(places.shape), count.reshape(places.shape)


def _peaks(ranked: FloatArray, keep: int) -> NDArray[np.intp]:
    """Places (K, 2) of the local maxima of a grid, best first, non-maxima within two steps suppressed."""
    left = ranked.copy()
    found: list[tuple[int, int]] = []
    for _ in range(keep):
        i, j = divmod(int(np.argmax(left)), left.shape[1])
        if not np.isfinite(left[i, j]):
            break
        found.append((i, j))
        left[max(0, i - 2) : i + 3, max(0, j - 2) : j + 3] = -np.inf
    return np.array(found, dtype=np.intp).reshape(-1, 2)
