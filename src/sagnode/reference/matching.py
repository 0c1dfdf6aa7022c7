"""Region of interest, edges and cv2.matchTemplate as in section 3.5 and figures 3 and 4."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray

Mode = Literal["TM_SQDIFF", "TM_SQDIFF_NORMED", "TM_CCORR", "TM_CCORR_NORMED", "TM_CCOEFF", "TM_CCOEFF_NORMED"]
MODES: tuple[Mode, ...] = get_args(Mode)
"""The six modes of figure 4."""

_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class Roi:
    """Region of interest: quadrants of the picture, as rows and columns of a 2 x 2 division."""

    rows: tuple[int, int] = (0, 1)
    """First quadrant row and the one after the last: (0, 1) is the top half."""
    columns: tuple[int, int] = (0, 2)

    def box(self, image_shape: tuple[int, ...]) -> tuple[int, int, int, int]:
        """Left, top, right and bottom (the last two exclusive) in pixels of a picture (height, width)."""
        height, width = image_shape[:2]
        rows, columns = (0, height // 2, height), (0, width // 2, width)
        return columns[self.columns[0]], rows[self.rows[0]], columns[self.columns[1]], rows[self.rows[1]]


TOP_QUADRANTS = Roi()
"""The paper's: "the top-left and top-right quadrants"."""
WHOLE_FRAME = Roi(rows=(0, 2))


@dataclass(frozen=True)
class Template:
    """A curve to be looked for; pixels of the whole picture.

    Attributes:
        points: the curve (N, 2), its first point the targeted line's start.
        control: control points (3, 2) where the curve is a quadratic Bézier.
    """

    points: FloatArray
    control: FloatArray | None = None

    def moved(self, shift: FloatArray) -> Template:
        """The same curve, ``shift`` (2,) px elsewhere."""
        return Template(self.points + shift, None if self.control is None else self.control + shift)


@dataclass(frozen=True)
class Match:
    """The best match: the template where it was found, its score (greater is better), and its place in the library."""

    template: Template
    score: float
    index: int


def edges(image: GreyImage, low: float, high: float) -> GreyImage:
    """Canny edges (0 or 255) of a grey picture."""
    return np.asarray(cv2.Canny(image, low, high), dtype=np.uint8)


def draw_template(points: FloatArray) -> tuple[GreyImage, NDArray[np.int_]]:
    """A 1 px curve on a blank picture just large enough: (height, width) of 0 or 255, and its top-left pixel (2,)."""
    # the rasteriser rounds to the nearest pixel, so the box goes by rounded coordinates
    origin = np.floor(points.min(axis=0) + 0.5).astype(int)
    corner = np.floor(points.max(axis=0) + 0.5).astype(int)
    width, height = corner - origin + 1
    blank = np.zeros((height, width), dtype=np.uint8)
    fixed = np.round((points - origin) * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(blank, [fixed.reshape(-1, 1, 2)], False, 255, 1, cv2.LINE_8, _SUBPIXEL_BITS)
    return blank, origin


def score_map(source: GreyImage, template: GreyImage, mode: Mode) -> NDArray[np.float32]:
    """cv2.matchTemplate over the whole source, with greater always better: (H-h+1, W-w+1)."""
    result = cv2.matchTemplate(source, template, getattr(cv2, mode))
    return np.asarray(-result if mode.startswith("TM_SQDIFF") else result, dtype=np.float32)


def anchored_score(
    source: GreyImage, template: GreyImage, top_left: NDArray[np.int_], mode: Mode
) -> tuple[float, NDArray[np.int_]] | None:
    """Best score of a template that starts within 1 px of its place, and the shift (2,) from that place.

    The template is correlated over the whole source and nine places are read, as the paper does.

    Args:
        source: edges of the region of interest.
        template: drawn curve.
        top_left: the template's top-left pixel in the source when its start lies on the anchor.
        mode: of cv2.matchTemplate.

    Returns:
        None if the template does not fit into the source at any of the nine places.
    """
    height, width = template.shape
    low = np.maximum(top_left - 1, 0)
    high = np.minimum(top_left + 1, np.array([source.shape[1] - width, source.shape[0] - height]))
    if np.any(high < low):
        return None
    scores = score_map(source, template, mode)[low[1] : high[1] + 1, low[0] : high[0] + 1]
    scores = np.where(np.isfinite(scores), scores, -np.inf)
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    return float(scores[row, column]), low + np.array([column, row]) - top_left


def best_match(
    image: GreyImage, library: Iterable[Template], roi: Roi, canny: tuple[float, float], mode: Mode
) -> Match | None:
    """The template with the highest score among those that start within 1 px of their anchor.

    Args:
        image: grey picture without distortion.
        library: curves, each beginning at the anchor.
        roi: where to look; templates that reach out of it cannot be matched.
        canny: lower and upper threshold.
        mode: of cv2.matchTemplate.

    Returns:
        None if no template fits into the region, or none correlates with its edges at all. The paper knows no other
        refusal: whatever matches best, wins.
    """
    left, top, right, bottom = roi.box(image.shape)
    source = edges(image[top:bottom, left:right], *canny)
    if not source.any():
        return None
    best: Match | None = None
    for index, template in enumerate(library):
        drawn, origin = draw_template(template.points)
        found = anchored_score(source, drawn, origin - np.array([left, top]), mode)
        if found is not None and (best is None or found[0] > best.score):
            best = Match(template.moved(found[1].astype(float)), found[0], index)
    return best if best is None or correlates(best.score, mode) else None


def correlates(score: float, mode: Mode) -> bool:
    """Whether a best score says that anything was found at all; only the correlation coefficients have a zero."""
    return not mode.startswith("TM_CCOEFF") or score > 0
