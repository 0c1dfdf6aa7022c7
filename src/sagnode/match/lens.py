"""What is between the camera and the scene: night, fog, drops, dirt, told by comparison with the reference picture.

The picture is cut into square cells. In each the detail is measured at two scales, as the mean magnitude of a
band-pass: fine (edges, leaves) and coarse (roofs, trunks). Cells that hold detail in the reference picture are asked
what is left of it now, relative to the light. What takes it away leaves its own mark:

- fog, and a fogged lens, take contrast from most of the picture;
- a drop takes the fine detail in a patch and leaves its brightness nearly as it was;
- dirt is a patch in which there is next to nothing, darker than what lay there.

Nothing here decides about a reading: it explains a refusal, and tells health. Only NumPy and OpenCV on arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.quality import LensLook

WIDTH_PX = 728
"""About this width a picture is looked at; a whole number of its pixels make one of these."""
CELL_PX = 12
"""Side of a cell in the small picture."""
DARK_LEVEL = 32.0
"""Grey level that hardly a pixel exceeds: night, or a covered lens; cameras expose a day far brighter."""
DETAIL_FINE = 0.8
DETAIL_COARSE = 1.0
"""Grey levels of detail in the reference picture from which a cell can tell something."""
CELLS_MIN = 40
"""Fewer cells with detail can tell nothing of the lens."""
HAZE = 0.4
"""A cell that keeps less than this of its coarse contrast, relative to the light, is taken by fog."""
FOGGED_SHARE = 0.5
"""Of the cells with detail; in thinner fog near things stay clear, and so does the measurement."""
LOST = 0.25
"""A cell that keeps less than this of its fine detail, relative to what the picture keeps as a whole, is lost."""
WET_SHARE = 0.006
"""Share of the cells with detail that must be lost in patches; clear pictures have 0.003 at most."""
OPAQUE_LEVEL = 0.8
"""Patches darker than this share of their own brightness are not seen through: dirt. A drop brings the sky with it."""
BLACK_LEVEL = 0.45
DIRTY_SHARE = 0.004
"""Patches darker than the first of their own brightness are dirt also where there is no detail, if they are so many."""


@dataclass(frozen=True)
class Cells:
    """A picture in cells (rows, columns).

    Attributes:
        level: mean grey level.
        fine: mean magnitude of the fine band, sensor noise taken off.
        coarse: the same of the coarse band.
        bright: grey level that one pixel in a hundred exceeds.
    """

    level: FloatArray
    fine: FloatArray
    coarse: FloatArray
    bright: float


@dataclass(frozen=True)
class LensState:
    """The finding."""

    look: LensLook
    share: float
    """Of the picture's detail that is affected, 0 to 1."""
    text: str


def cells(image: GreyImage) -> Cells:
    """Measure a picture (height, width) uint8."""
    step = max(1, round(image.shape[1] / WIDTH_PX))
    size = (image.shape[1] // step, image.shape[0] // step)
    grey = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0)
    fine = _means(np.abs(grey - soft), CELL_PX)
    small = cv2.resize(grey, (size[0] // 3, size[1] // 3), interpolation=cv2.INTER_AREA)
    rough = np.abs(small - cv2.GaussianBlur(small, (0, 0), 2.0))
    # the flattest tenth of a picture holds noise and nothing else
    fine = np.sqrt(np.maximum(fine**2 - np.quantile(fine, 0.1) ** 2, 0.0))
    shape = fine.shape[1], fine.shape[0]
    bright = float(np.percentile(grey[::4, ::4], 99))
    coarse = np.asarray(cv2.resize(_means(rough, CELL_PX // 3), shape), dtype=np.float64)
    return Cells(_means(grey, CELL_PX), fine, coarse, bright)


def _means(image: NDArray[np.float32], side: int) -> FloatArray:
    rows, columns = image.shape[0] // side, image.shape[1] // side
    cut = image[: rows * side, : columns * side]
    return np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float64)


def lens_state(reference: Cells | None, image: GreyImage) -> LensState:
    """What the lens looks like in this picture, against the reference picture of the same view and size."""
    now = cells(image)
    if now.bright < DARK_LEVEL:
        text = f"hardly a pixel exceeds grey level {now.bright:.0f} of 255; night, or something covers the lens"
        return LensState(LensLook.DARK, 1.0, text)
    if reference is None or reference.level.shape != now.level.shape:
        return LensState(LensLook.UNKNOWN, 0.0, "no reference picture to compare with")
    # the least of a cell's surroundings, so that a picture that has moved a little is not blamed for it
    around = np.ones((3, 3))
    fine_before = np.asarray(cv2.erode(reference.fine, around))
    told = (fine_before > DETAIL_FINE) & (np.asarray(cv2.erode(reference.coarse, around)) > DETAIL_COARSE)
    if int(told.sum()) < CELLS_MIN:
        return LensState(LensLook.UNKNOWN, 0.0, "the view holds too little detail to tell anything of the lens")
    light = float(np.median(now.level / np.maximum(reference.level, 1.0)))
    hazy = float(np.mean(now.coarse[told] / reference.coarse[told] < HAZE * light))
    if hazy > FOGGED_SHARE:
        text = f"fog, or a fogged lens: {100 * hazy:.0f} % of the view has lost its contrast"
        return LensState(LensLook.FOGGED, hazy, text)
    kept = float(np.median(now.fine[told] / reference.fine[told]))
    relative = now.level / np.maximum(reference.level, 1.0) / light
    lost = told & (now.fine < LOST * kept * fine_before)
    patches = _patches(lost)
    opaque = patches & (relative < OPAQUE_LEVEL)
    black = _patches((relative < BLACK_LEVEL) & (lost | ~told))
    wet, dirty = float(np.mean((patches & ~opaque)[told])), float(np.mean(black | opaque))
    if dirty > DIRTY_SHARE and (dirty > wet or bool(black.any())):
        return LensState(LensLook.DIRTY, dirty, f"dirt on the lens: {100 * dirty:.1f} % of the picture is covered")
    if wet > WET_SHARE:
        return LensState(LensLook.WET, wet, f"drops on the lens: {100 * wet:.1f} % of the view's detail is blurred")
    return LensState(LensLook.CLEAR, 0.0, "clear")


def _patches(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Only what is at least two cells wide and high."""
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)) > 0)
