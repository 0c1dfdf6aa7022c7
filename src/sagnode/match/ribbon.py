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
from sagnode.native import kernels

SIDE_OFFSET_PX = 2.5
"""Distance of the side samples from the centre of a thin wire: beyond its blurred width, before the next thing."""
RESPONSE_CLIP = 24.0
"""Grey levels above which one sample counts no more: strong edges of towers and clouds must not outvote a thin wire."""

NO_BAND = np.zeros((1, 1), dtype=np.float32)
Singles = NDArray[np.float32]


def normals(pixels: FloatArray) -> FloatArray:
    """Unit normals (..., N, 2) of polylines (..., N, 2) by central differences along the second-last axis."""
    tangent = np.empty(pixels.shape)
    tangent[..., 1:-1, :] = pixels[..., 2:, :] - pixels[..., :-2, :]
    tangent[..., 0, :] = pixels[..., 1, :] - pixels[..., 0, :]
    tangent[..., -1, :] = pixels[..., -1, :] - pixels[..., -2, :]
    along, down = tangent[..., 0], tangent[..., 1]
    result = np.empty(pixels.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        shorten = 1 / np.sqrt(along * along + down * down)
        np.multiply(down, -shorten, out=result[..., 0])
        np.multiply(along, shorten, out=result[..., 1])
    return result


def arc_length(pixels: FloatArray) -> FloatArray:
    """Cumulative length (N,) of one polyline (N, 2), px."""
    steps = pixels[1:] - pixels[:-1]
    length = np.zeros(len(pixels))
    np.cumsum(np.hypot(steps[:, 0], steps[:, 1]), out=length[1:])
    return length


def straighten(image: GreyImage | Singles, pixels: FloatArray, normal: FloatArray, offsets: FloatArray) -> Singles:
    """The ribbon (N, K) of bilinear grey values at ``offsets`` (K,) px across a polyline (N, 2).

    Values are not rounded to whole grey levels, which would round a faint wire away, nor are places rounded, as OpenCV
    rounds them to 1/32 px, which would shift a level wire; beyond the frame its edge goes on.
    """
    height, width = image.shape
    column, right = _between(pixels[:, :1] + offsets * normal[:, :1], width)
    row, below = _between(pixels[:, 1:] + offsets * normal[:, 1:], height)
    # one place in memory for each of the four pixels about a sample
    grey, place = np.ascontiguousarray(image).reshape(-1), row * width + column
    a, b, c, d = (grey.take(place + step).astype(np.float32, copy=False) for step in (0, 1, width, width + 1))
    upper, lower = a + right * (b - a), c + right * (d - c)
    return np.asarray(upper + below * (lower - upper), dtype=np.float32)


def _between(place: FloatArray, end: int) -> tuple[NDArray[np.intp], Singles]:
    """The first of the two pixels that places lie between along an axis, and the share of the second."""
    with np.errstate(invalid="ignore"):
        inside = np.minimum(np.fmax(place, 0.0), end - 1.0)
    first = np.minimum(inside.astype(np.intp), end - 2)
    return first, (inside - first).astype(np.float32)


def line_response(
    image: GreyImage, pixels: FloatArray, normal: FloatArray, place: FloatArray, side: FloatArray
) -> NDArray[np.float32]:
    """Polarity-agnostic response (..., N) along curves (..., N, 2), averaged over the lines that belong to each.

    With a, b the two sides of a line minus its middle: ``max(min(a, b), min(-a, -b))``, clipped to ±RESPONSE_CLIP. It
    is positive where both sides are brighter (dark wire on sky) or both darker (sunlit wire before trees), and negative
    on a mere edge. Samples of which anything is outside the frame are NaN.

    Args:
        image: raw grey frame.
        pixels: the curves.
        normal: their unit normals, broadcasting to (..., N, 2).
        place: middle of each line across the curve, px (m, N).
        side: distance of its sides from there, px (m, N).
    """
    shape = pixels.shape[:-1]
    normal = np.broadcast_to(normal, pixels.shape)
    parts = (pixels[..., 0], pixels[..., 1], normal[..., 0], normal[..., 1])
    u, v, nu, nv = (np.asarray(part, dtype=np.float32).reshape(-1, shape[-1]) for part in parts)
    across = [np.asarray(part, dtype=np.float32)[:, None, :] for part in (place, side)]
    response, seen = pooled_response(image, (u, v), (nu, nv), (across[0], across[1]), NO_BAND)
    return np.where(seen, response, np.float32(np.nan)).astype(np.float32).reshape(shape)


def pooled_response(
    image: GreyImage,
    pixel: tuple[Singles, Singles],
    normal: tuple[Singles, Singles],
    lines: tuple[Singles, Singles],
    band: Singles,
) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """The best response (see :func:`line_response`) within bands across curves, in whole grey levels.

    Args:
        image: raw grey frame.
        pixel: columns and rows (M, N) of the samples, px.
        normal: both components (M, N) of the curves' unit normals.
        lines: where across the curve each line is, and the distance of its sides, px (m, ...), broadcasting to (M, N).
        band: where across the curves to look (B, M), px.

    Returns:
        Responses (M, N), and whether a sample with all its sides is in the frame (M, N); out of it a response says
        nothing.
    """
    if kernels is not None:
        best, seen = np.empty(pixel[0].shape, dtype=np.int16), np.empty(pixel[0].shape, dtype=bool)
        kernels.response(image, *pixel, *normal, *lines, band, best, seen)
        return best, seen
    height, width = image.shape
    (u, v), (nu, nv) = pixel, normal
    places, sides = lines
    seen = np.ones(u.shape, dtype=bool)
    outer = np.max(np.abs(places) + sides, axis=0)
    margin = float(np.max(outer) + np.max(np.abs(band)))
    if not all(_within(p, margin, end - 1 - margin) for p, end in ((u, width), (v, height))):
        with np.errstate(invalid="ignore"):
            for p, n, end in ((u, nu, width), (v, nv, height)):
                reach = np.abs(outer * n)
                seen &= (p >= reach) & (p + reach <= end - 1)
    best = np.full(u.shape, -RESPONSE_CLIP, dtype=np.int16)
    for shift in band:
        total = np.zeros(u.shape, dtype=np.int16)
        for place, side in zip(places, sides, strict=True):
            away = place + shift[:, None]
            base = (u + away * nu, v + away * nv) if away.any() else (u, v)
            total += _response(image, base, (side * nu, side * nv))
        np.maximum(best, total // np.int16(len(places)) if len(places) > 1 else total, out=best)
    return best, seen


def _response(image: GreyImage, at: tuple[Singles, Singles], side: tuple[Singles, Singles]) -> NDArray[np.int16]:
    """Response (M, N) of one line, clipped, from its middle and the way to one of its sides."""
    centre = _grey(image, at[0], at[1])
    left = _grey(image, at[0] - side[0], at[1] - side[1])
    right = _grey(image, at[0] + side[0], at[1] + side[1])
    dark = cv2.subtract(cv2.min(left, right), centre, dtype=cv2.CV_16S)
    bright = cv2.subtract(centre, cv2.max(left, right), dtype=cv2.CV_16S)
    response = np.maximum(np.maximum(dark, bright), np.int16(-RESPONSE_CLIP))
    return np.asarray(np.minimum(response, np.int16(RESPONSE_CLIP)), dtype=np.int16)


def _grey(image: GreyImage, u: Singles, v: Singles) -> GreyImage:
    """Bilinear grey values (M, N), rounded; the frame's edge goes on beyond it."""
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def _within(values: Singles, low: float, high: float) -> bool:
    """Whether all values lie from ``low`` to ``high``; NaN does not."""
    return bool(values.min() >= low and values.max() <= high)
