"""Patches of landmarks, and the places in a frame that look like them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray

NCC_MIN = 0.55
"""Least correlation of a landmark with its patch; chance company is left to the consensus to refuse."""
MIN_TEXTURE = 2.0
"""Standard deviation in grey levels below which a patch holds nothing to recognise."""


@dataclass(frozen=True)
class Patch:
    """A landmark as it looked in the reference picture.

    Attributes:
        pixel: where it was clicked (2,).
        image: the square around the rounded click, odd side.
    """

    pixel: FloatArray
    image: GreyImage

    @cached_property
    def equalised(self) -> GreyImage:
        """The image as it is compared."""
        return equalised(self.image)


def equalised(image: GreyImage) -> GreyImage:
    """Mean 128, standard deviation 40: light and haze change these between two pictures of one thing."""
    mean, deviation = (float(value.item()) for value in cv2.meanStdDev(image))
    gain = 40.0 / max(deviation, 1.0)
    grey = (image.astype(np.float32) - mean) * gain + 128.0
    return np.asarray(np.clip(grey, 0, 255), dtype=np.uint8)


def cut_patch(reference: GreyImage, pixel: tuple[float, float], size_px: int) -> Patch | None:
    """The patch of a landmark, or None where it reaches over the edge or holds no texture."""
    half = size_px // 2
    u, v = round(pixel[0]), round(pixel[1])
    height, width = reference.shape
    if u < half or v < half or u > width - 1 - half or v > height - 1 - half:
        return None
    image = reference[v - half : v + half + 1, u - half : u + half + 1].copy()
    return Patch(np.array(pixel), image) if float(image.std()) >= MIN_TEXTURE else None


Peak = tuple[float, float, float]
"""A place where a patch may be: (du, dv) from where it was clicked, whole pixels, and its correlation there."""


def peaks(frame: GreyImage, patch: Patch, reach_px: float, ncc_min: float = NCC_MIN) -> list[Peak]:
    """Up to five places of a patch within ``reach_px`` of its click, correlation at least ``ncc_min``, best first."""
    score, first = correlations(frame, patch, reach_px)
    places: list[Peak] = []
    for _ in range(5 if score.size else 0):
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        value = float(score[row, column])
        if value < ncc_min:
            break
        places.append((float(first[0] + column), float(first[1] + row), value))
        score[max(0, row - 3) : row + 4, max(0, column - 3) : column + 4] = -1.0
    return places


def correlations(frame: GreyImage, patch: Patch, reach_px: float) -> tuple[FloatArray, tuple[int, int]]:
    """Correlation of a patch with the places within ``reach_px`` of its click, and (du, dv) of the first of them.

    Empty where the window does not hold the patch.
    """
    half, reach = patch.image.shape[0] // 2, int(np.ceil(reach_px))
    u, v = round(float(patch.pixel[0])), round(float(patch.pixel[1]))
    height, width = frame.shape
    left, top = max(0, u - half - reach), max(0, v - half - reach)
    right, bottom = min(width, u + half + reach + 1), min(height, v + half + reach + 1)
    window = frame[top:bottom, left:right]
    first = (left + half - u, top + half - v)
    if window.shape[0] < patch.image.shape[0] or window.shape[1] < patch.image.shape[1]:
        return np.empty((0, 0)), first
    score = cv2.matchTemplate(window, patch.image, cv2.TM_CCOEFF_NORMED)
    return np.where(np.isfinite(score), score, 0.0), first
