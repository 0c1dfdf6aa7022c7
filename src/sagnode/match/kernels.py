"""What a wire, or a bundle of them, looks like across its curve: the profiles that a picture is compared with."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from sagnode.geometry.camera import FloatArray

STEP_PX = 0.5
"""Sampling across the curve."""
BLUR_PX = 0.9
"""Standard deviation of lens, sensor and bilinear sampling together; 0.7 to 1.3 hardly matters."""
MARGIN_PX = 3.0
"""Background that a kernel takes in on either side of the wire's blurred edge."""


def wire_kernel(width_px: ArrayLike, positions: FloatArray, blur_px: float | FloatArray = BLUR_PX) -> FloatArray:
    """Blurred box of ``width_px`` (...) and height 1 at ``positions`` (..., N) px across: shape (..., N).

    Several blurs (B, ..., 1) give a first axis for them.

    A wire thinner than a pixel keeps the shape of the blur, with its peak scaled down by its width.
    """
    half = 0.5 * np.maximum(np.asarray(width_px, dtype=np.float64), 0.05)[..., None]
    scale = 1 / (blur_px * np.sqrt(2.0))
    return 0.5 * (_erf((positions + half) * scale) - _erf((positions - half) * scale))


def wire_slope(width_px: ArrayLike, positions: FloatArray, blur_px: float = BLUR_PX) -> FloatArray:
    """Derivative of :func:`wire_kernel` by the position, 1/px: shape (..., N)."""
    half = 0.5 * np.maximum(np.asarray(width_px, dtype=np.float64), 0.05)[..., None]
    edges = [np.exp(-0.5 * ((positions + side * half) / blur_px) ** 2) for side in (1, -1)]
    return np.asarray((edges[0] - edges[1]) / (blur_px * np.sqrt(2 * np.pi)))


def _erf(x: FloatArray) -> FloatArray:
    """Error function, absolute error under 1.5e-7 (Abramowitz and Stegun 7.1.26)."""
    t = 1 / (1 + 0.3275911 * np.abs(x))
    series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    return np.asarray(np.sign(x) * (1 - series * np.exp(-x * x)))


def steps(reach: int) -> FloatArray:
    """Whole steps (2 reach + 1,) to both sides of the middle."""
    return np.arange(-reach, reach + 1, dtype=np.float64)


def kernel_reach(width_px: float, blur_px: float = BLUR_PX, margin_px: float = MARGIN_PX) -> int:
    """Half length of the kernel of a wire with its background, in steps across the curve."""
    return int(np.ceil((0.5 * width_px + 1.5 * blur_px + margin_px) / STEP_PX))


def unit_kernels(width: FloatArray, positions: FloatArray, blur_px: float = BLUR_PX) -> FloatArray:
    """Wire profiles (M, n) without mean, of unit norm; symmetric, so they have no slope either."""
    kernel = wire_kernel(width, positions, blur_px)
    kernel -= kernel.mean(axis=1, keepdims=True)
    return np.asarray(kernel / np.linalg.norm(kernel, axis=1, keepdims=True))


def bundle_kernels(
    width: FloatArray, middles: FloatArray, positions: FloatArray, blur_px: float
) -> tuple[list[FloatArray], FloatArray]:
    """Kernels (M, n) about each of the sub-conductors at ``middles`` (m, M) px, which show the others within reach.

    Without mean and slope each, and together of unit norm. And what their norm would be (M,) for wires of height 1.
    """
    slope = positions / np.linalg.norm(positions)
    kernels = []
    for middle in middles:
        shown = [wire_kernel(width, positions - (other - middle)[:, None], blur_px) for other in middles]
        kernel = np.sum(shown, axis=0)
        kernel -= kernel.mean(axis=1, keepdims=True)
        kernels.append(kernel - (kernel @ slope)[:, None] * slope if len(middles) > 1 else kernel)
    norm = np.linalg.norm(np.concatenate(kernels, axis=1), axis=1)
    return [np.asarray(kernel / norm[:, None]) for kernel in kernels], norm


def shared_noise(kernels: list[FloatArray], middles: FloatArray) -> FloatArray:
    """By how much (M,) the noise that windows about sub-conductors at ``middles`` (m, M) px share makes offsets worse.

    An offset's variance goes with the squares of the kernels' slopes; where two of them meet the same pixels, with the
    square of their sum.
    """
    slopes = [np.gradient(kernel, axis=1) for kernel in kernels]
    alone = np.sum([np.sum(slope**2, axis=1) for slope in slopes], axis=0)
    shared = np.zeros_like(alone)
    columns, last = np.arange(kernels[0].shape[1]), kernels[0].shape[1] - 1
    for j, k in combinations(range(len(kernels)), 2):
        place = columns + (middles[j] - middles[k])[:, None] / STEP_PX
        first = np.clip(np.floor(place).astype(np.intp), 0, last - 1)
        here, there = (np.take_along_axis(slopes[k], first + step, axis=1) for step in (0, 1))
        met = np.where((place >= 0) & (place <= last), here + (place - first) * (there - here), 0.0)
        shared += 2 * np.sum(slopes[j] * met, axis=1)
    return np.asarray(np.maximum(1.0, 1 + shared / alone))
