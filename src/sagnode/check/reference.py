"""Is the reference picture one of this camera, and can the landmarks be recognised in it where they were clicked?

Needs NumPy and OpenCV; :mod:`sagnode.check.configuration` imports it only where those are installed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from sagnode.capture.images import read_grey
from sagnode.capture.port import GreyImage
from sagnode.config.lines import KeyPath
from sagnode.config.span import Landmark
from sagnode.errors import FrameError
from sagnode.geometry.camera import Intrinsics
from sagnode.match.patches import cut_patch, peaks
from sagnode.quality import Cause

Warned = tuple[KeyPath, str]

_BLUR_PX = 2.0
"""Any patch is found in the picture that it was cut from, be it of noise. In one blurred by so much, noise correlates
with itself by less than half, and landmarks by 0.85 and more."""
_MOST_NAMED = 6


def read_reference(path: Path, intrinsics: Intrinsics) -> GreyImage:
    """The reference picture of a camera.

    Raises:
        FrameError: it cannot be read, or the intrinsics belong to pictures of another size.
    """
    picture = read_grey(path)
    height, width = picture.shape
    if (width, height) != (intrinsics.width, intrinsics.height):
        expected = f"the intrinsics belong to {intrinsics.width}x{intrinsics.height}"
        remedy = "take it with the camera settings of the calibration"
        raise FrameError(f"{path} has {width}x{height} px, and {expected}", remedy, Cause.BAD_FRAME)
    return picture


def reference_warnings(path: Path, picture: GreyImage, landmarks: Sequence[Landmark]) -> Iterator[Warned]:
    """Landmarks that no frame will be searched for, or in vain.

    Args:
        path: of the picture, to name it.
        picture: what :func:`read_reference` read.
        landmarks: as they were clicked in it; clicks outside it are somebody else's to tell.
    """
    blurred = np.asarray(cv2.GaussianBlur(picture, (0, 0), _BLUR_PX), dtype=np.uint8)
    missing = []
    for index, mark in enumerate(landmarks):
        margin = _margin_px(picture, mark.pixel)
        if 0 <= margin < mark.size_px // 2:
            text = (
                f"{mark.id} lies {margin} px from the edge of {path.name}, and its square of size_px = {mark.size_px}"
                " reaches over it; it is never looked for; make the square smaller, or take another point"
            )
            yield ("landmarks", index, "pixel"), text
        elif margin >= 0:
            patch = cut_patch(picture, mark.pixel, mark.size_px)
            if patch is None or not peaks(blurred, patch, 0.0):
                missing.append(mark.id)
    if missing:
        more = f" and {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
        text = (
            f"{len(missing)} of {len(landmarks)} landmarks are not in {path.name}: nothing but even grey or noise where"
            f" {', '.join(missing[:_MOST_NAMED])}{more} {'was' if len(missing) == 1 else 'were'} clicked; is it the"
            " picture of the clicks, the right way up, sharp and by daylight?"
        )
        yield ("camera", "reference_image"), text


def _margin_px(picture: GreyImage, pixel: tuple[float, float]) -> int:
    """Pixels between a click and the nearest edge; less than 0 outside."""
    height, width = map(int, picture.shape)
    u, v = round(pixel[0]), round(pixel[1])
    return min(u, v, width - 1 - u, height - 1 - v)
