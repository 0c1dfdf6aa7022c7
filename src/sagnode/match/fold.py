"""Where a curve seen along the line turns back on itself, and how the wire there would look."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.match.kernels import BLUR_PX
from sagnode.match.ribbon import arc_length
from sagnode.match.track import Track

TURN_PX, TURN_COSINE = 12.0, -0.5
"""A curve turns back where its directions so far before and behind have at most this cosine."""
DEGREE = 12
"""Of the polynomials that follow a curve about its tip: a sample a pixel is too coarse where it turns within one."""
SAMPLE_PX = 0.5
"""Length between points of a fold."""
FINER = 400
"""Parameters at which those polynomials are evaluated to find such points."""
DRAWN = 8
"""Steps per pixel in which strands are drawn."""
FINE = 4
"""Rows of a drawing per pixel."""
ALIKE = 6
"""Points of a strand that are drawn with one width."""
PAD_PX = 3
"""Drawn beyond a drawing's edges, for its blur."""
SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class Fold:
    """Two strands of one curve and the tip at which they meet.

    Attributes:
        index: sample of the track next to the tip.
        t: curve parameter of the tip.
        pixel: its place (2,).
        axis: unit vector (2,) that points from between the strands through the tip.
        across: points along the curve about the tip, px to the right of the axis (K,),
        along: and px along it (K,), none of them beyond the tip's 0.
        width: of the wire there, px (K,).
    """

    index: int
    t: float
    pixel: FloatArray
    axis: FloatArray
    across: FloatArray
    along: FloatArray
    width: FloatArray

    @property
    def side(self) -> FloatArray:
        """Unit vector (2,) across the axis."""
        return np.array([-self.axis[1], self.axis[0]])


def turn_of(track: Track) -> int | None:
    """The sample at the sharpest turn of a track, if it turns back there."""
    way = _samples(track)
    cosine = np.sum(track.normal[: -2 * way] * track.normal[2 * way :], axis=1)
    index = int(np.argmin(cosine)) if len(cosine) else 0
    return index + way if len(cosine) and cosine[index] <= TURN_COSINE else None


def _samples(track: Track) -> int:
    """Samples of a track to TURN_PX of it, which is sampled evenly."""
    return max(1, round(TURN_PX * (len(track.arc) - 1) / max(float(track.arc[-1]), 1e-9)))


def axis_at(track: Track, index: int) -> FloatArray:
    """Unit vector (2,) from between the strands of a track through the place where it turns back."""
    before, after = np.clip([index - _samples(track), index + _samples(track)], 0, len(track.arc) - 1)
    # the tangent is the normal turned back; along one strand it points to the tip, along the other away from it
    turned = track.normal[before] - track.normal[after]
    return np.asarray(np.array([turned[1], -turned[0]]) / np.hypot(*turned))


def fold_at(track: Track, index: int, depth: float) -> Fold | None:
    """The fold of a track about a sample at which it turns back, its strands as far as ``depth`` px behind the tip.

    None where the tip or the strands are out of the frame.
    """
    arc, axis = track.arc, axis_at(track, index)
    behind = (track.pixels[index] - track.pixels) @ axis
    near = (np.abs(behind) < depth) & (np.abs(arc - arc[index]) < 1.5 * depth)
    t = track.t[near]
    if len(t) <= 2 * DEGREE:
        return None
    middle, half = 0.5 * (t[0] + t[-1]), 0.5 * (t[-1] - t[0])
    # orthogonal over the samples, so that products with them fit
    basis, transform = np.linalg.qr(np.polynomial.chebyshev.chebvander((t - middle) / half, DEGREE))
    coefficients = np.linalg.solve(transform, basis.T @ track.pixels[near])

    def pixels(parameter: FloatArray) -> FloatArray:
        return np.asarray(np.polynomial.chebyshev.chebvander((parameter - middle) / half, DEGREE) @ coefficients)

    finer = np.linspace(t[0], t[-1], FINER)
    length = arc_length(pixels(finer))
    parameter = np.interp(np.arange(0.0, length[-1], SAMPLE_PX), length, finer)
    points = pixels(parameter)
    first = int(np.argmax(points @ axis))
    if first in (0, len(points) - 1):
        return None
    about = np.linspace(parameter[first - 1], parameter[first + 1], 21)
    tip = float(about[int(np.argmax(pixels(about) @ axis))])
    pixel = pixels(np.array([tip]))[0]
    local = points - pixel
    width = np.interp(parameter, track.t, track.width)
    return Fold(index, tip, pixel, axis, local @ np.array([-axis[1], axis[0]]), local @ axis, width)


def drawn(fold: Fold, aside: int, behind: int, beyond: int) -> FloatArray:
    """A fold as a picture blurred like the camera's would show it, 1 where a wire covers all.

    A column a pixel from ``-aside`` to ``aside`` px across its axis, ``FINE`` rows a pixel from ``-behind`` to
    ``beyond`` px along it. Where its strands meet they cover the picture once, not twice.
    """
    columns, rows = 2 * (aside + PAD_PX) + 1, behind + beyond + 2 * PAD_PX + 1
    canvas = np.zeros((DRAWN * rows, DRAWN * columns), dtype=np.uint8)
    # places are those of pixels' centres
    place = np.stack([fold.across + aside, fold.along + behind], axis=1) + PAD_PX + 0.5
    points = np.rint((DRAWN * place - 0.5) * (1 << SUBPIXEL_BITS)).astype(np.int32)
    inside = (np.abs(fold.across) < 2 * aside + DRAWN) & (fold.along > -2.0 * behind)
    for start in range(0, len(points) - 1, ALIKE):
        piece = slice(start, start + ALIKE + 1)
        if inside[piece].all():
            thickness = max(1, round(DRAWN * float(np.mean(fold.width[piece]))))
            cv2.polylines(canvas, [points[piece, None]], False, 255, thickness, cv2.LINE_8, SUBPIXEL_BITS)
    # as many rows a pixel as are asked for, and as the lens blurs them
    size = (columns, FINE * rows)
    covered = cv2.resize(canvas.astype(np.float32) / 255, size, interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(covered, (0, 0), sigmaX=BLUR_PX, sigmaY=BLUR_PX * FINE)
    # the rows of whole pixels lie between two of these
    first, count = FINE * PAD_PX + FINE // 2 - 1, FINE * (behind + beyond) + 1
    between = 0.5 * (blurred[first : first + count] + blurred[first + 1 : first + 1 + count])
    return between[:, PAD_PX : PAD_PX + 2 * aside + 1].astype(np.float64)
