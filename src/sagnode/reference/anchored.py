"""The nine scores that section 3.5 counts, without correlating anything else: exact, and hundreds of times sooner.

The paper correlates a template with the whole region and then keeps "only templates where the targeted line starts with
1-pixel accuracy": nine places of millions. Template and source are edge pictures of two values, so that each of
OpenCV's six scores at a place follows from four counts: pixels n of the template's box, template pixels k, edge pixels
s of the source under the box, and hits x, edge pixels under template pixels. k is known beforehand, s comes from an
integral image, x from looking at k pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.reference.matching import Match, Mode, Roi, Template, correlates, draw_template, edges

_REACH = 1
"""px; the start counts when it is met within this."""
_MARGIN = 2 * _REACH
"""Blank pixels around the source: a box may stand one pixel outside and be looked for one pixel farther out."""


@dataclass(frozen=True)
class DrawnLibrary:
    """Template pixels of a whole library, drawn once for one pose and one region of interest.

    Attributes:
        size: the region's (height, width).
        pixels: flat index of every template pixel in the region with its blank margin (K,), template after template.
        first: each template's first place in ``pixels`` (M,).
        count: its template pixels k (M,).
        corner: its box's left and top pixel in the region (M, 2).
        extent: its box's width and height (M, 2).
        index: its place in the library it came from (M,); what cannot fit into the region is left out.
    """

    size: tuple[int, int]
    pixels: NDArray[np.int32]
    first: NDArray[np.intp]
    count: NDArray[np.int64]
    corner: NDArray[np.int64]
    extent: NDArray[np.int64]
    index: NDArray[np.intp]


def draw_library(library: Iterable[Template], box: tuple[int, int, int, int]) -> DrawnLibrary:
    """Draw every template of a library for a region of interest (left, top, right, bottom), px."""
    left, top, right, bottom = box
    size = (bottom - top, right - left)
    stride = size[1] + 2 * _MARGIN
    pixels, corners, extents, kept = [], [], [], []
    for index, template in enumerate(library):
        drawn, origin = draw_template(template.points)
        corner = origin - np.array([left, top])
        extent = np.array(drawn.shape[::-1])
        if np.any(corner < -_REACH) or np.any(corner + extent > np.array(size[::-1]) + _REACH):
            continue
        if not drawn.any():
            # a stroke that runs along the edge of its box can miss every pixel
            continue
        places = np.asarray(cv2.findNonZero(drawn)).reshape(-1, 2) + corner + _MARGIN
        pixels.append((places[:, 1] * stride + places[:, 0]).astype(np.int32))
        corners.append(corner)
        extents.append(extent)
        kept.append(index)
    count = np.array([len(p) for p in pixels], dtype=np.int64)
    return DrawnLibrary(
        size=size,
        pixels=np.concatenate(pixels) if pixels else np.empty(0, dtype=np.int32),
        first=np.concatenate([[0], np.cumsum(count)[:-1]]).astype(np.intp) if pixels else np.empty(0, dtype=np.intp),
        count=count,
        corner=np.array(corners, dtype=np.int64).reshape(-1, 2),
        extent=np.array(extents, dtype=np.int64).reshape(-1, 2),
        index=np.array(kept, dtype=np.intp),
    )


def anchored_scores(source: GreyImage, library: DrawnLibrary, mode: Mode) -> FloatArray:
    """Scores (M, 3, 3) of every template with its start on the anchor and one pixel around it, greater always better.

    The middle axis is the vertical shift -1, 0, 1, the last one the horizontal; -inf where the template's box would
    reach out of the source. Equal to :func:`sagnode.reference.matching.score_map` at these places.

    Args:
        source: edges (0 or 255) of the region that the library was drawn for.
        library: M templates.
        mode: of cv2.matchTemplate.

    Raises:
        ValueError: the source is not of the library's size.
    """
    if source.shape != library.size:
        raise ValueError(f"source of {source.shape}, library for {library.size}")
    templates = len(library.index)
    if not templates:
        return np.empty((0, 3, 3))
    edge = np.zeros((source.shape[0] + 2 * _MARGIN, source.shape[1] + 2 * _MARGIN), dtype=np.uint8)
    np.minimum(source, 1, out=edge[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN])
    flat, stride = edge.reshape(-1), edge.shape[1]
    total = cv2.integral(edge)
    width, height = library.extent.T
    scores = np.full((templates, 3, 3), -np.inf)
    for row in range(3):
        for column in range(3):
            shift = (row - _REACH) * stride + column - _REACH
            # a view that begins at the shift saves adding it to every index
            seen = flat[shift:] if shift >= 0 else flat
            place = library.pixels if shift >= 0 else library.pixels + shift
            hits = np.add.reduceat(seen.take(place), library.first, dtype=np.int64)
            x0 = library.corner[:, 0] + column - _REACH
            y0 = library.corner[:, 1] + row - _REACH
            fits = (x0 >= 0) & (y0 >= 0) & (x0 + width <= source.shape[1]) & (y0 + height <= source.shape[0])
            a, b, c, d = x0 + _MARGIN, y0 + _MARGIN, x0 + _MARGIN + width, y0 + _MARGIN + height
            under = total[d, c].astype(np.int64) - total[d, a] - total[b, c] + total[b, a]
            scores[:, row, column] = np.where(fits, _score(width * height, library.count, under, hits, mode), -np.inf)
    return scores


def best_anchored(
    image: GreyImage, library: Sequence[Template], roi: Roi, canny: tuple[float, float], mode: Mode
) -> Match | None:
    """:func:`sagnode.reference.matching.best_match`, the same arguments and the same answer."""
    box = roi.box(image.shape)
    left, top, right, bottom = box
    source = edges(image[top:bottom, left:right], *canny)
    if not source.any():
        return None
    return best_of(library, draw_library(library, box), source, mode)


def best_of(library: Sequence[Template], drawn: DrawnLibrary, source: GreyImage, mode: Mode) -> Match | None:
    """The best template of a library that is drawn already, in the edges of its region."""
    scores = anchored_scores(source, drawn, mode)
    if not np.isfinite(scores).any():
        return None
    best, row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    score, index = float(scores[best, row, column]), int(drawn.index[best])
    if not correlates(score, mode):
        return None
    shift = np.array([column - _REACH, row - _REACH], dtype=np.float64)
    return Match(library[index].moved(shift), score, index)


def _score(
    n: NDArray[np.int64], k: NDArray[np.int64], s: NDArray[np.int64], x: NDArray[np.int64], mode: Mode
) -> FloatArray:
    """OpenCV's score from the counts, for pictures of 0 and 255; greater is better."""
    if mode.startswith("TM_SQDIFF"):
        value, norm = (k + s - 2 * x).astype(np.float64), np.sqrt(k * s.astype(np.float64))
    elif mode.startswith("TM_CCORR"):
        value, norm = x.astype(np.float64), np.sqrt(k * s.astype(np.float64))
    else:
        value = x - k * s / n
        norm = np.sqrt((k - k * k / n) * np.maximum(s - s * s / n, 0.0))
    if not mode.endswith("_NORMED"):
        result = value * 255.0**2
    else:
        # OpenCV's own rule where the norm vanishes or rounding exceeds it
        size = np.abs(value)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = value / norm
        empty = 1.0 if mode == "TM_SQDIFF_NORMED" else 0.0
        result = np.where(size < norm, ratio, np.where(size < 1.125 * norm, np.sign(value), empty))
        if mode == "TM_CCOEFF_NORMED":
            # OpenCV gives every place full marks for a template that fills its box: a straight level line
            result = np.where(k == n, 1.0, result)
    return np.asarray(-result if mode.startswith("TM_SQDIFF") else result)
