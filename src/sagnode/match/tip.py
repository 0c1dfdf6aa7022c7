"""The tip of a fold: where a wire that is seen along the line turns back.

Beside the tip the two strands of a wire run into one line, and no block there can be told from the other strand. But
where that line ends is plain to see, and says what nothing else does: strands that lie in a plane through the camera
hardly move when the wire sags, while the tip does. So the fold is drawn as it is foreseen, the drawing is laid over the
picture at one place after another along its axis, and the likeliest place is taken.

Every row across the axis has a background of its own, a straight line, and a noise of its own, which is not known: the
logarithm of a row's likelihood is then that of the squares left over, to the power of half their number. Where a
tower's lattice or a crossing wire is behind the fold, those rows say little and the others decide. All rows have the
contrast of the wire in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.across import AnyGrey
from sagnode.match.fold import FINE, Fold, drawn
from sagnode.match.ribbon import straighten
from sagnode.match.robust import median

BEHIND_PX, BEYOND_PX = 10, 6
"""What is compared of the strands behind the tip, and of the background beyond it, besides the range looked at."""
MARGIN_PX = 4
"""Background beside the strands,"""
APART_PX = 9.0
"""which lie no farther than this from the axis, as far as they are looked at."""
SETTLED_PX = 6.0
"""Range up to which the strands are taken to be right across the axis; else they are looked for so many px aside."""
ASIDE_PX = 3
ROUNDS = 5
"""Of weighing the rows by what the last round left over."""
LEAST_GREY = 1.0
"""Least noise, grey levels."""
SHARING = 2.0
"""Pixels that share one noise: neighbours across a row are interpolated from the same ones."""
APART_ENOUGH_PX = 1.5
"""Another place along the axis from here on,"""
CLEAR_NATS, SURE_NATS = 12.0, 20.0
"""which must be less likely by this, the natural logarithm of the odds; and by this where nothing else bears it out."""
CONTRAST_MAX = 200.0
"""Greatest contrast of a wire, grey levels: what needs more is none."""
LEAST_PX, UNLIKE = 0.25, 2.0
"""Least standard uncertainty, px, for a wire's shading, and a factor of the rows' own scatter: residuals go on from row
to row."""
ROWS_ALIKE = 3
"""Rows whose residuals are taken for one."""


@dataclass(frozen=True)
class Tip:
    """A tip as it was measured.

    Attributes:
        offset: along the fold's axis from where it was foreseen, px.
        sigma: standard uncertainty of that, px.
        sure: no other place along the axis comes into question, whatever else is known of the curve.
    """

    offset: float
    sigma: float
    sure: bool


def find_tip(image: AnyGrey, fold: Fold, half_range: int) -> Tip | None:
    """Where along its axis the tip of a fold is, within ``half_range`` px; None where that is not clear."""
    behind, beyond = BEHIND_PX + half_range, BEYOND_PX + half_range
    shown = fold.along > -behind
    apart = min(float(np.max(np.abs(fold.across[shown]))), APART_PX)
    aside = int(np.ceil(apart + 0.5 * float(np.max(fold.width[shown])))) + MARGIN_PX
    if not _inside(image, fold, aside, behind, beyond):
        return None
    rows = np.arange(-behind, beyond + 1.0)[:, None]
    normal = np.broadcast_to(fold.side, (len(rows), 2))
    strip = straighten(image, fold.pixel + rows * fold.axis, normal, np.arange(-aside, aside + 1.0)).astype(np.float64)
    drawing = drawn(fold, aside + ASIDE_PX, behind + half_range, beyond + half_range)
    laid = _Laid(strip, drawing, half_range)
    steps = np.arange(-FINE * half_range, FINE * half_range + 1, FINE)
    sideways = np.arange(1 - ASIDE_PX, ASIDE_PX) if half_range > SETTLED_PX else np.zeros(1, dtype=np.int64)
    coarse = laid.weighed(steps, sideways).cost
    at = int(np.argmin(coarse.min(axis=1)))
    best = int(steps[np.argmin(coarse[at])])
    if abs(best) > FINE * (half_range - 1):
        # it goes on beyond what was looked at
        return None
    return _tip_of(laid, best, int(sideways[at]), steps, coarse[at])


def _tip_of(laid: _Laid, best: int, shift: int, steps: NDArray[np.int64], coarse: FloatArray) -> Tip | None:
    """The tip near the best of coarse ``steps`` (D,) along the axis, if all others are unlikely by their cost (D,)."""
    close = best + np.arange(-FINE, FINE + 1)
    seen = laid.weighed(close, np.array([shift]))
    cost = seen.cost[0]
    k = int(np.clip(np.argmin(cost), 1, len(close) - 2))
    elsewhere = np.abs(steps - close[k]) > APART_ENOUGH_PX * FINE
    contrast, moved = seen.amounts[0, k]
    clear = float(np.min(coarse[elsewhere]) - cost[k])
    if clear < CLEAR_NATS or abs(contrast) > CONTRAST_MAX:
        return None
    bend = cost[k - 1] - 2 * cost[k] + cost[k + 1]
    offset = close[k] + (0.5 * (cost[k - 1] - cost[k + 1]) / bend if bend > 0 else 0.0)
    # what a row's residual moves the tip by, and how firmly all rows hold it
    (before, here, behind), aside = laid.drawings(close[k - 1 : k + 2], shift)
    weight = 1 / seen.variance[0, k][:, None]
    slope = 0.5 * FINE * (behind - before)
    slope = slope - np.sum(weight * slope * here) / np.sum(weight * here**2) * here
    held = contrast**2 * float(np.sum(weight * slope**2))
    pull = contrast * np.sum(weight * (laid.own - contrast * here - moved * aside[1]) * slope, axis=1)
    together = np.add.reduceat(pull, np.arange(0, len(pull), ROWS_ALIKE))
    scatter = np.sqrt(float(together @ together) + held) / max(held, 1e-12)
    return Tip(float(offset) / FINE, float(np.hypot(LEAST_PX, UNLIKE * scatter)), clear > SURE_NATS)


def _inside(image: AnyGrey, fold: Fold, aside: int, behind: int, beyond: int) -> bool:
    """Whether a rectangle about the fold is in the frame."""
    height, width = image.shape
    corners = [
        fold.pixel + along * fold.axis + way * fold.side for along in (-behind, beyond) for way in (-aside, aside)
    ]
    return all(0 <= u <= width - 1 and 0 <= v <= height - 1 for u, v in corners)


@dataclass(frozen=True)
class _Weighed:
    """What a picture of R rows and a drawing have to do with each other at S shifts and D places along the axis.

    Attributes:
        amounts: contrast of the wire, grey levels, and the same times how far it lies aside, px (S, D, 2).
        variance: of each row's pixels (S, D, R).
        cost: minus the logarithm of the likelihood (S, D).
    """

    amounts: FloatArray
    variance: FloatArray
    cost: FloatArray


class _Laid:
    """A drawing laid over a strip of the picture (R, n), which is so much narrower and shorter on every side.

    ``own`` is the strip without its rows' backgrounds.
    """

    def __init__(self, strip: FloatArray, drawing: FloatArray, half_range: int) -> None:
        count = strip.shape[1]
        across = np.arange(count) - 0.5 * (count - 1)
        self._background = np.stack([np.full(count, count**-0.5), across / np.sqrt(across @ across)])
        self.own = self._level(strip)
        self._drawing, self._half_range = drawing, half_range
        noise = 1.4826 * median(np.abs(np.diff(strip, axis=1)).ravel()) / np.sqrt(2.0)
        self._least = max(LEAST_GREY, noise) ** 2

    def _level(self, rows: FloatArray) -> FloatArray:
        """Rows (..., n) without a straight line each."""
        return np.asarray(rows - (rows @ self._background.T) @ self._background)

    def _shifted(self, shift: int, every: int = 1) -> tuple[FloatArray, FloatArray]:
        """Rows of the drawing ``shift`` px across, and how they change by px farther across (F, n), levelled."""
        first, count = ASIDE_PX - shift, self.own.shape[1]
        here, right, left = (self._drawing[::every, first + k : first + k + count] for k in (0, -1, 1))
        return self._level(here), self._level(0.5 * (right - left))

    def _rows(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Rows (D, R) of the drawing moved along its axis by steps (D,) of 1 / FINE px."""
        return (FINE * self._half_range - steps)[:, None] + FINE * np.arange(len(self.own))

    def drawings(self, steps: NDArray[np.int64], shift: int) -> tuple[FloatArray, FloatArray]:
        """The drawing and its change by px across (D, R, n), levelled, at ``steps`` (D,)."""
        here, aside = self._shifted(shift)
        return here[self._rows(steps)], aside[self._rows(steps)]

    def weighed(self, steps: NDArray[np.int64], shifts: NDArray[np.int64]) -> _Weighed:
        """The likelihood at ``steps`` (D,) of 1 / FINE px along the axis and ``shifts`` (S,) px across."""
        every = FINE if not (steps % FINE).any() else 1
        rows, row = self._rows(steps) // every, np.arange(len(self.own))
        sums = np.empty((5, len(shifts), *rows.shape))
        for k, shift in enumerate(shifts):
            here, aside = self._shifted(int(shift), every)
            for n, (one, other) in enumerate(((here, here), (here, aside), (aside, aside))):
                sums[n, k] = np.sum(one * other, axis=1)[rows]
            sums[3, k], sums[4, k] = ((part @ self.own.T)[rows, row] for part in (here, aside))
        energy, free = np.sum(self.own**2, axis=1), self.own.shape[1] - 3
        weight = np.full(sums.shape[1:], 1 / self._least)
        for _ in range(ROUNDS):
            # one contrast, and one distance aside, for all rows by their weights
            a, b, c, d, e = np.einsum("ksdr,sdr->ksd", sums, weight)
            c = c + 1e-3 * a + 1e-9
            scale = 1 / (a * c - b * b + 1e-9)
            amounts = np.stack([(c * d - b * e) * scale, (a * e - b * d) * scale], axis=-1)
            first, second = amounts[..., :1], amounts[..., 1:]
            squares = energy + first * (first * sums[0] + 2 * second * sums[1] - 2 * sums[3])
            squares += second * (second * sums[2] - 2 * sums[4])
            variance = np.maximum(squares, 0.0) / free + self._least
            weight = 1 / variance
        return _Weighed(amounts, variance, 0.5 * free / SHARING * np.sum(np.log(variance), axis=-1))
