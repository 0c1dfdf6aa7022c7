"""Whole-frame undistortion, for overlays and for the paper's matchers; measuring samples the raw frame instead."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.errors import FrameError
from sagnode.geometry.camera import Intrinsics
from sagnode.quality import Cause

Picture = TypeVar("Picture", bound=NDArray[Any])


def undistort_image(intrinsics: Intrinsics, image: Picture) -> Picture:
    """The picture that the same camera would take with a perfect lens, ``intrinsics.without_distortion()``.

    Args:
        intrinsics: of the camera that took the picture.
        image: (height, width) or (height, width, channels), 8-bit.

    Returns:
        The same shape and type, sampled bilinearly at 1/32 px. Where the perfect lens sees more than the frame holds,
        the frame's edge is repeated, since a black border would be an edge for a matcher.

    Raises:
        FrameError: (bad-frame) the picture is not of the intrinsics' size.
    """
    height, width = image.shape[:2]
    if (width, height) != (intrinsics.width, intrinsics.height):
        raise FrameError(
            f"the frame is {width}x{height} px, the intrinsics belong to {intrinsics.width}x{intrinsics.height} px",
            "capture at the size of the calibration, or calibrate at the size of the capture",
            Cause.BAD_FRAME,
        )
    if not any(intrinsics.distortion):
        return image
    maps = _maps(intrinsics)
    return cast(Picture, cv2.remap(image, *maps, interpolation=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@lru_cache(maxsize=4)
def _maps(intrinsics: Intrinsics) -> tuple[NDArray[Any], NDArray[Any]]:
    """Where each undistorted pixel lies in the raw frame; 6 bytes a pixel, made once for each camera."""
    K, size = intrinsics.matrix, (intrinsics.width, intrinsics.height)
    distortion = np.array(intrinsics.distortion)
    if intrinsics.model == "fisheye":
        distortion = np.resize(np.append(distortion, np.zeros(4)), 4)
        return cv2.fisheye.initUndistortRectifyMap(K, distortion, np.eye(3), K, size, cv2.CV_16SC2)
    return cv2.initUndistortRectifyMap(K, distortion, np.eye(3), K, size, cv2.CV_16SC2)
