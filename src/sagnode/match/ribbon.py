"""Reading the picture along a curve: samples on it, beside it, and across it.

A *ribbon* is the picture straightened along a curve: rows are samples along the curve, columns are offsets along the
curve's unit normal, in pixels. The normal is the tangent turned from +u towards +v, so a positive offset lies to the
right of the direction of travel on the screen. All functions work on the raw 8-bit grey frame: only the
pixels that are needed are touched.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray

SIDE_OFFSET_PX = 2.5
"""Distance of the side samples from the centre of a thin wire: beyond its blurred width, before the next thing."""
RESPONSE_CLIP = 24.0
"""Grey levels above which one sample counts no more: strong edges of towers and clouds must not outvote a thin wire."""


def normals(pixels: FloatArray) -> FloatArray:
    """Unit normals (..., N, 2) of polylines (..., N, 2) by central differences along the second-last axis."""
    tangent = np.gradient(pixels, axis=-2)
    length = np.linalg.norm(tangent, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        tangent = tangent / length
    return np.asarray(np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1))


def arc_length(pixels: FloatArray) -> FloatArray:
    """Cumulative length (N,) of one polyline (N, 2), px."""
    steps = np.hypot(*np.diff(pixels, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def lookup(image: GreyImage | NDArray[np.float32], pixels: FloatArray) -> NDArray[np.float32]:
    """Bilinear grey values (...) at pixels (..., 2); NaN outside the frame or at NaN pixels."""
    height, width = image.shape
    u, v = pixels[..., 0], pixels[..., 1]
    with np.errstate(invalid="ignore"):
        inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    u = np.where(inside, u, 0.0)
    v = np.where(inside, v, 0.0)
    u0 = np.minimum(u.astype(np.intp), width - 2)
    v0 = np.minimum(v.astype(np.intp), height - 2)
    fu = (u - u0).astype(np.float32)
    fv = (v - v0).astype(np.float32)
    flat = image.reshape(-1)
    first = v0 * width + u0
    top = flat[first] * (1 - fu) + flat[first + 1] * fu
    bottom = flat[first + width] * (1 - fu) + flat[first + width + 1] * fu
    values = top * (1 - fv) + bottom * fv
    values[~inside] = np.nan
    return np.asarray(values, dtype=np.float32)


def pair_response(image: GreyImage, centre: FloatArray, side: FloatArray) -> NDArray[np.float32]:
    """Polarity-agnostic line response (...) at centres (..., 2), with sides at ``centre ± side`` (..., 2).

    With a, b the two sides minus the centre: ``max(min(a, b), min(-a, -b))``, clipped to ±RESPONSE_CLIP. It is
    positive where both sides are brighter (dark wire on sky) or both darker (sunlit wire before trees), and negative on
    a mere edge. Samples whose centre or side is outside the frame are NaN.
    """
    height, width = image.shape
    maps = [centre, centre - side, centre + side]
    flat = [
        np.ascontiguousarray(np.nan_to_num(m, nan=-9.0).reshape(-1, m.shape[-2], 2), dtype=np.float32) for m in maps
    ]
    c, left, right = (
        cv2.remap(image, m[..., 0], m[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.int16)
        for m in flat
    )
    a, b = left - c, right - c
    response = np.maximum(np.minimum(a, b), np.minimum(-a, -b)).astype(np.float32)
    np.clip(response, -RESPONSE_CLIP, RESPONSE_CLIP, out=response)
    for m in flat:
        outside = (m[..., 0] < 0) | (m[..., 1] < 0) | (m[..., 0] > width - 1) | (m[..., 1] > height - 1)
        response[outside] = np.nan
    return np.asarray(response.reshape(centre.shape[:-1]))
