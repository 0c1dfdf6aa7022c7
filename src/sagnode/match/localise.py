"""Where a wire lies across a nearly right curve, block by block, to a few hundredths of a pixel.

The picture is straightened along the curve (1 sample a pixel along, ½ px across), blocks of some 8 px are averaged
along it, and each block's profile is compared with the profile that a wire of the expected width would have: a box of
that width, blurred by the lens and the sensor. The kernel and every window have their mean and slope taken out, so
that a sky's gradient or a hillside's edge does not pull the wire; the sign is free, so that a wire may be dark before
the sky and bright before trees.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.ribbon import arc_length, lookup

AnyGrey = GreyImage | NDArray[np.float32]

STEP_PX = 0.5
"""Sampling across the curve."""
BLUR_PX = 0.9
"""Standard deviation of lens, sensor and bilinear sampling together; 0.7 to 1.3 hardly matters."""
MARGIN_PX = 3.0
"""Background that a kernel takes in on either side of the wire's blurred edge."""
FLOOR_GREY = 0.2
"""Structure below this many grey levels is taken for 8-bit rounding: it cannot make a peak."""
ROUNDING_GREY = 0.15
"""Least noise of a block's mean profile: 8-bit rounding, averaged along the block."""
CORRELATED = 2.7
"""Variance factor of the offset for neighbouring samples sharing pixels (bilinear, ½ px apart); see the tests."""


@dataclass(frozen=True)
class Blocks:
    """One wire position per block (M blocks in order along the curve).

    Attributes:
        index: centre of the block as a fractional index into the curve's samples (M,).
        arc: position of that centre along the curve, px (M,).
        offset: of the wire from the curve along the normal, px (M,); NaN where not valid.
        sigma: standard uncertainty of the offset from white noise, px (M,); NaN where not valid.
        snr: amplitude of the wire's profile over its own uncertainty (M,); 0 where not valid.
        correlation: of the profile with the kernel, 0..1 (M,); how much the block looks like a wire at all.
        contrast: wire minus background, grey levels (M,); negative for a dark wire.
        valid: a peak inside the range, in a block inside the frame (M,).
    """

    index: FloatArray
    arc: FloatArray
    offset: FloatArray
    sigma: FloatArray
    snr: FloatArray
    correlation: FloatArray
    contrast: FloatArray
    valid: NDArray[np.bool_]


def wire_kernel(width_px: ArrayLike, positions: FloatArray, blur_px: float = BLUR_PX) -> FloatArray:
    """Blurred box of ``width_px`` (...) and height 1 at ``positions`` (N,) px across: shape (..., N).

    A wire thinner than a pixel keeps the shape of the blur, with its peak scaled down by its width.
    """
    half = 0.5 * np.maximum(np.asarray(width_px, dtype=np.float64), 0.05)[..., None]
    scale = 1 / (blur_px * np.sqrt(2.0))
    return 0.5 * (_erf((positions + half) * scale) - _erf((positions - half) * scale))


def _erf(x: FloatArray) -> FloatArray:
    """Error function, absolute error under 1.5e-7 (Abramowitz and Stegun 7.1.26)."""
    t = 1 / (1 + 0.3275911 * np.abs(x))
    series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    return np.asarray(np.sign(x) * (1 - series * np.exp(-x * x)))


def localise(
    image: AnyGrey,
    pixels: FloatArray,
    normal: FloatArray,
    width_px: ArrayLike,
    half_range_px: float,
    block_px: float = 8.0,
    blur_px: float = BLUR_PX,
    margin_px: float = MARGIN_PX,
) -> Blocks:
    """Measure the wire's offset across a curve in blocks along it.

    Args:
        image: grey picture (height, width), 8 bit or single precision.
        pixels: the curve (N, 2), samples about 1 px apart.
        normal: its unit normals (N, 2).
        width_px: expected width of the wire, one value or (N,).
        half_range_px: greatest offset looked for, either side.
        block_px: length of a block along the curve.
        blur_px: standard deviation of the picture's blur.
        margin_px: background taken in on either side; less than MARGIN_PX where a neighbour is near.

    Returns:
        The blocks; empty arrays for fewer than two samples.
    """
    if len(pixels) < 2:
        nothing = np.empty(0)
        return Blocks(nothing, nothing, nothing, nothing, nothing, nothing, nothing, np.empty(0, dtype=bool))
    arc = arc_length(pixels)
    starts = block_starts(arc, block_px)
    size = np.diff(np.append(starts, len(pixels)))
    widths = np.broadcast_to(np.asarray(width_px, dtype=np.float64), arc.shape)
    width = np.add.reduceat(widths, starts) / size
    near = kernel_reach(float(np.max(width)), blur_px, margin_px)
    far = int(np.ceil(half_range_px / STEP_PX)) + 1
    profiles, seen = block_profiles(image, pixels, normal, STEP_PX * _steps(far + near), starts)
    kernel = unit_kernels(width, STEP_PX * _steps(near), blur_px)
    position, sigma, snr, likeness, contrast = _peaks(profiles, kernel)
    offset = STEP_PX * (position - far)
    valid = seen & np.isfinite(offset) & (np.abs(offset) <= half_range_px)
    return Blocks(
        index=starts + 0.5 * (size - 1),
        arc=np.add.reduceat(arc, starts) / size,
        offset=np.where(valid, offset, np.nan),
        sigma=np.where(valid, sigma, np.nan),
        snr=np.where(valid, snr, 0.0),
        correlation=np.where(valid, likeness, 0.0),
        contrast=np.where(valid, contrast, 0.0),
        valid=valid,
    )


def _steps(reach: int) -> FloatArray:
    return np.arange(-reach, reach + 1, dtype=np.float64)


def kernel_reach(width_px: float, blur_px: float = BLUR_PX, margin_px: float = MARGIN_PX) -> int:
    """Half length of the kernel of a wire with its background, in steps across the curve."""
    return int(np.ceil((0.5 * width_px + 1.5 * blur_px + margin_px) / STEP_PX))


def block_starts(arc: FloatArray, block_px: float) -> NDArray[np.intp]:
    """First sample of each of the equal blocks that come nearest to ``block_px``."""
    count = max(1, round(float(arc[-1]) / block_px))
    member = np.minimum((arc * (count / max(float(arc[-1]), 1e-9))).astype(np.intp), count - 1)
    return np.flatnonzero(np.diff(member, prepend=-1))


def block_profiles(
    image: AnyGrey, pixels: FloatArray, normal: FloatArray, offsets: FloatArray, starts: NDArray[np.intp]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Mean grey profiles of blocks across a curve, and which blocks lie wholly inside the frame.

    Args:
        image: grey picture (height, width), 8 bit or single precision.
        pixels: the curve (N, 2).
        normal: its unit normals (N, 2).
        offsets: where to sample across it (K,), px, rising.
        starts: first sample of each block (M,).

    Returns:
        Profiles (M, K), and a mask (M,).
    """
    height, width = image.shape
    ends = pixels[:, None, :] + offsets[[0, -1], None] * normal[:, None, :]
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((ends >= 0) & (ends <= (width - 1, height - 1))).all(axis=(1, 2)))
    seen = np.minimum.reduceat(inside, starts)
    # in single precision either way: 8-bit interpolation would round a faint wire away
    if image.dtype == np.float32:
        across = offsets.astype(np.float32)
        point, turned = (np.where(inside[:, None], part, 0.0).astype(np.float32) for part in (pixels, normal))
        maps = [point[:, i : i + 1] + across * turned[:, i : i + 1] for i in (0, 1)]
        grey = cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    else:
        # only the pixels that are needed, instead of the conversion of a whole frame
        grey = np.nan_to_num(lookup(image, pixels[:, None, :] + offsets[:, None] * normal[:, None, :]))
    size = np.diff(np.append(starts, len(pixels)))
    return np.add.reduceat(grey, starts, axis=0, dtype=np.float64) / size[:, None], seen


def unit_kernels(width: FloatArray, positions: FloatArray, blur_px: float = BLUR_PX) -> FloatArray:
    """Wire profiles (M, n) without mean, of unit norm; symmetric, so they have no slope either."""
    kernel = wire_kernel(width, positions, blur_px)
    kernel -= kernel.mean(axis=1, keepdims=True)
    return np.asarray(kernel / np.linalg.norm(kernel, axis=1, keepdims=True))


def _peaks(
    profiles: FloatArray, kernel: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Best position (fractional window number), sigma px, snr, correlation and contrast of each block."""
    n = kernel.shape[1]
    amplitude, energy = compare(profiles, kernel)
    score = correlation(amplitude, energy, n)
    rows = np.arange(len(score))
    # the outermost windows only serve the parabola
    peak = np.argmax(score[:, 1:-1], axis=1) + 1
    here, sign = score[rows, peak], np.sign(amplitude[rows, peak])
    before, after = (np.where(np.sign(amplitude[rows, peak + d]) == sign, score[rows, peak + d], 0.0) for d in (-1, 1))
    bend = before - 2 * here + after
    summit = (here >= before) & (here >= after) & (bend < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        position = np.where(summit, peak + 0.5 * (before - after) / bend, np.nan)
    size = np.abs(amplitude[rows, peak])
    noise = np.sqrt(np.maximum(energy[rows, peak] - size**2, 0.0) / (n - 3) + ROUNDING_GREY**2)
    steepness = np.linalg.norm(np.gradient(kernel, STEP_PX, axis=1), axis=1)
    snr = size / (noise * np.sqrt(CORRELATED))
    sigma = 1 / np.maximum(snr * steepness, 1e-6)
    return position, sigma, snr, here, sign * size * np.ptp(kernel, axis=1)


def compare(profiles: FloatArray, kernel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slide kernels (M, n) of :func:`unit_kernels` over profiles (M, K).

    Returns:
        Amplitude (M, K-n+1) of the kernel in each window, signed, and the window's energy without mean and slope.
    """
    n = kernel.shape[1]
    slope = np.linspace(-1, 1, n)
    slope /= np.linalg.norm(slope)
    windows = sliding_window_view(profiles, n, axis=1)
    amplitude = np.einsum("mkn,mn->mk", windows, kernel)
    mean = windows.mean(axis=2)
    energy = np.einsum("mkn,mkn->mk", windows, windows) - n * mean**2 - (windows @ slope) ** 2
    return amplitude, np.maximum(energy, 0.0)


def correlation(amplitude: FloatArray, energy: FloatArray, n: int) -> FloatArray:
    """Correlation 0..1 of windows of n samples with their kernel, either sign, small where there is only rounding."""
    return np.asarray(np.abs(amplitude) / np.sqrt(energy + n * FLOOR_GREY**2))
