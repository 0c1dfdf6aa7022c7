"""Appearances: further looks of a landmark, beside that of the reference picture.

The reference picture defines where a landmark is; an appearance is a cut-out of a later frame in which that place was
known, to be found again where the reference's patch is not. Decision record 7 says how they come and go.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import cv2
import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.patches import MIN_TEXTURE, Patch, Peak, peaks

KEPT_MAX = 6
"""Appearances a landmark."""
KEPT_NCC_MIN = 0.75
"""Least correlation with an appearance: higher than with the reference, since many are asked."""
FOUND_U_PX = 0.3
"""Standard uncertainty of a position found by an appearance: how it was placed, and how light pulls the match."""


@dataclass(frozen=True)
class Appearance:
    """A look of a landmark.

    Attributes:
        image: square of odd side around the pixel next to the landmark.
        offset: from the middle of that pixel to the landmark (2,), px.
        cut_at: when the frame was taken.
        useful_at: when it last was the best likeness of its landmark.
        proofs: later frames in which it found the landmark where the reference's landmarks said it must be.
    """

    image: GreyImage
    offset: FloatArray
    cut_at: datetime
    useful_at: datetime
    proofs: int = 0

    @property
    def proven(self) -> bool:
        """Whether it may be used; else it is on trial."""
        return self.proofs > 0

    def patch(self, clicked: FloatArray) -> Patch:
        """As a patch to be searched around where the landmark was clicked (2,)."""
        # not quite half a pixel, so that rounding finds the middle pixel again
        return Patch(np.round(clicked) + np.clip(self.offset, -0.4999, 0.4999), self.image)


Appearances = tuple[tuple[Appearance, ...], ...]
"""Of every landmark of a site, in its order."""


def none_kept(landmarks: int) -> Appearances:
    """Of a site of which nothing is remembered yet."""
    return ((),) * landmarks


def cut_appearance(frame: GreyImage, place: FloatArray, side_px: int, at: datetime) -> Appearance | None:
    """The look of a landmark at a place (2,), or None where it reaches over the edge or holds no texture."""
    half = side_px // 2
    u, v = round(float(place[0])), round(float(place[1]))
    height, width = frame.shape
    if u < half or v < half or u > width - 1 - half or v > height - 1 - half:
        return None
    image = frame[v - half : v + half + 1, u - half : u + half + 1].copy()
    if float(image.std()) < 2 * MIN_TEXTURE:
        return None
    return Appearance(image, place - (u, v), at, at)


def likeness(frame: GreyImage, image: GreyImage, place: FloatArray) -> float:
    """Greatest correlation of a patch with the frame within a pixel of a place (2,); 0 at the edge."""
    half = image.shape[0] // 2 + 1
    u, v = round(float(place[0])), round(float(place[1]))
    window = frame[max(0, v - half) : v + half + 1, max(0, u - half) : u + half + 1]
    if window.shape != (2 * half + 1, 2 * half + 1):
        return 0.0
    score = cv2.matchTemplate(window, image, cv2.TM_CCOEFF_NORMED)
    return float(np.max(np.where(np.isfinite(score), score, 0.0)))


def sightings(
    frame: GreyImage, clicked: FloatArray, kept: Iterable[Appearance], reach_px: float
) -> list[tuple[Peak, Appearance]]:
    """Where proven appearances of one landmark are found within ``reach_px`` of its click, best first, five at most."""
    seen = [
        (peak, appearance)
        for appearance in kept
        if appearance.proven
        for peak in peaks(frame, appearance.patch(clicked), reach_px, KEPT_NCC_MIN)
    ]
    return sorted(seen, key=lambda one: -one[0][2])[:5]


def with_added(kept: Sequence[Appearance], new: Appearance) -> tuple[Appearance, ...]:
    """The appearances of one landmark with a new one, the least worth of them left out when they are too many.

    Those on trial go before those that are proven, among either the one that was not useful for longest.
    """
    before = sorted(kept, key=lambda a: (a.proven, a.useful_at))
    return (*before[max(0, len(before) + 1 - KEPT_MAX) :], new)


def proven_again(appearance: Appearance, at: datetime, *, best: bool) -> Appearance:
    """It found its landmark where it is; ``best``: and nothing else is more like it."""
    useful = at if best else appearance.useful_at
    return replace(appearance, proofs=appearance.proofs + 1, useful_at=max(useful, appearance.useful_at))
