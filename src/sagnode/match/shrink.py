"""A part of the picture in half its size, for a coarse look: a quarter of the pixels, and near each other in memory."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.match.family import Grid
from sagnode.match.templates import View

Box = tuple[int, int, int, int]
"""Left, top, right and bottom, px; the last two are not part of it."""


def box_around(u: Grid, v: Grid, margin: float, shape: tuple[int, ...]) -> Box | None:
    """The box of even size around the pixels that are within a frame of ``shape``; None where there are none."""
    height, width = shape
    inside: NDArray[np.bool_] = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    if not inside.any():
        return None
    ends = []
    for values, end in ((u[inside], width), (v[inside], height)):
        first = max(0, int(values.min() - margin))
        ends.append((first, first + (min(end, int(values.max() + margin)) - first) // 2 * 2))
    (left, right), (top, bottom) = ends
    return left, top, right, bottom


def halved(image: GreyImage, box: Box) -> GreyImage:
    """A box of the picture in half its size."""
    left, top, right, bottom = box
    size = ((right - left) // 2, (bottom - top) // 2)
    return np.asarray(cv2.resize(image[top:bottom, left:right], size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def halved_view(view: View, box: Box) -> View:
    """The same view of a box of the picture in half its size."""
    left, top, right, bottom = box
    lens = view.intrinsics
    # pixel centres keep their direction: (u + ½) is halved, not u
    halved_lens = replace(
        lens,
        width=(right - left) // 2,
        height=(bottom - top) // 2,
        fx=0.5 * lens.fx,
        fy=0.5 * lens.fy,
        cx=0.5 * (lens.cx - left + 0.5) - 0.5,
        cy=0.5 * (lens.cy - top + 0.5) - 0.5,
    )
    return replace(view, intrinsics=halved_lens)
