"""Where a wire lies across a nearly right curve, block by block, to a few hundredths of a pixel.

The picture is straightened along the curve (1 sample a pixel along, ½ px across), blocks of some 8 px are averaged
along it, and each block's profile is compared with the profile that a wire of the expected width would have: a box of
that width, blurred by the lens and the sensor. The kernel and every window have their mean and slope taken out, so
that a sky's gradient or a hillside's edge does not pull the wire; the sign is free, so that a wire may be dark before
the sky and bright before trees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.kernels import BLUR_PX, MARGIN_PX, STEP_PX, bundle_kernels, kernel_reach, shared_noise, steps
from sagnode.match.ribbon import arc_length, straighten

AnyGrey = GreyImage | NDArray[np.float32]

FLOOR_GREY = 0.2
"""Structure below this many grey levels is taken for 8-bit rounding: it cannot make a peak."""
ROUNDING_GREY = 0.15
"""Least noise of a block's mean profile: 8-bit rounding, averaged along the block."""
BESIDE_SAMPLES = 6
"""Samples along a block that suffice to see what the surroundings look like."""
UNEVEN = 1.1
"""Factor of the noise seen on one side more than on the other, for what taking the lesser of two and leaving out the
kernel's slope cost it; see the tests."""
SHARING = 1.05
"""Factor of the variance (see ``kernels.shared_noise``) from which windows about sub-conductors share pixels."""
SYMMETRIC_PX = 0.2
"""Sub-conductors are mirrored about a bundle's centre line when their places differ by less."""
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


@dataclass(frozen=True)
class Beside:
    """What the same blocks show on the same curve shifted across (S shifts, M blocks).

    Attributes:
        snr: as in :class:`Blocks` (S, M).
        inside: which shifted blocks have their centres in the frame (S, M).
    """

    snr: FloatArray
    inside: NDArray[np.bool_]


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
    return localise_beside(image, pixels, normal, width_px, half_range_px, (), block_px, blur_px, margin_px)[0]


def localise_beside(
    image: AnyGrey,
    pixels: FloatArray,
    normal: FloatArray,
    width_px: ArrayLike,
    half_range_px: ArrayLike,
    shifts_px: Sequence[float],
    block_px: float = 8.0,
    blur_px: float = BLUR_PX,
    margin_px: float = MARGIN_PX,
    members: FloatArray | None = None,
) -> tuple[Blocks, Beside]:
    """Measure the wire's offset as :func:`localise` does, and look likewise about the curve shifted across.

    One ribbon serves all: it is as wide as the farthest shift (``shifts_px``, px along the normal) asks for.
    ``half_range_px`` may be one value or (N,): where the wire is known to be near, less need be looked at.

    ``members`` (m, N) are the offsets across the curve, px, of the sub-conductors of a bundle whose centre line the
    curve is. Each has its ribbon, and a kernel that shows the others where they are near; their scores add up, so that
    the offset is that of the whole pattern, and where the pattern lies a whole spacing off, only a part of it fits.
    """
    if len(pixels) < 2:
        nothing = np.empty(0)
        empty = np.empty((len(shifts_px), 0))
        blocks = Blocks(nothing, nothing, nothing, nothing, nothing, nothing, nothing, np.empty(0, dtype=bool))
        return blocks, Beside(empty, empty.astype(bool))
    arc = arc_length(pixels)
    starts = block_starts(arc, block_px)
    size = np.diff(np.append(starts, len(pixels)))
    widths = np.broadcast_to(np.asarray(width_px, dtype=np.float64), arc.shape)
    width = np.add.reduceat(widths, starts) / size
    near = kernel_reach(float(np.max(width)), blur_px, margin_px)
    ranges = np.broadcast_to(np.asarray(half_range_px, dtype=np.float64), arc.shape)
    half_range = np.add.reduceat(ranges, starts) / size
    far = int(np.ceil(float(np.max(ranges)) / STEP_PX)) + 1
    centres = np.rint(np.array([0.0, *shifts_px]) / STEP_PX).astype(np.intp)
    reach = int(np.max(np.abs(centres))) + far
    if members is None:
        members = np.zeros((1, len(pixels)))
    wires = [pixels + offset[:, None] * normal for offset in members] if len(members) > 1 else [pixels]
    middles = np.add.reduceat(members, starts, axis=1) / size
    kernels = bundle_kernels(width, middles, STEP_PX * steps(near), blur_px)
    profiles = [_profiles(image, wire, normal, starts, reach + near, far + near) for wire in wires]
    compared = [compare(profile, kernel) for profile, kernel in zip(profiles, kernels, strict=True)]
    amplitude, energy = (np.sum(part, axis=0) for part in zip(*compared, strict=True))
    kernel = np.concatenate(kernels, axis=1)
    window = reach + centres[:, None, None] + np.arange(-far, far + 1)
    row = np.arange(len(starts))[:, None]
    overlap = shared_noise(kernels, middles)
    position, sigma, snr, likeness, contrast, noise = _peaks(
        amplitude[row, window], energy[row, window], kernel, len(wires), overlap, half_range
    )
    offset = STEP_PX * (position - far)
    ends = np.asarray(STEP_PX * (centres[:, None] + np.array([-far - near, far + near])), dtype=np.float64)
    uneven = _uneven_noise(profiles, kernels, middles, reach - far + position[0])
    # where windows share pixels, the noise of one side is in the other too
    sigma[0] *= np.where(overlap < SHARING, np.minimum(1.0, uneven / np.maximum(noise[0], ROUNDING_GREY)), 1.0)
    seen = np.all([_inside(image, wire, normal, starts, ends) for wire in wires], axis=0)
    valid = seen & np.isfinite(offset) & (np.abs(offset) <= half_range)
    middle = starts + size // 2
    blocks = Blocks(
        index=starts + 0.5 * (size - 1),
        arc=np.add.reduceat(arc, starts) / size,
        offset=np.where(valid[0], offset[0], np.nan),
        sigma=np.where(valid[0], sigma[0], np.nan),
        snr=np.where(valid[0], snr[0], 0.0),
        correlation=np.where(valid[0], likeness[0], 0.0),
        contrast=np.where(valid[0], contrast[0], 0.0),
        valid=valid[0],
    )
    shifted = np.asarray(STEP_PX * centres[1:, None], dtype=np.float64)
    centred = _inside(image, pixels[middle], normal[middle], np.arange(len(starts)), shifted)
    return blocks, Beside(np.where(valid[1:], snr[1:], 0.0), centred)


def block_starts(arc: FloatArray, block_px: float) -> NDArray[np.intp]:
    """First sample of each of the equal blocks that come nearest to ``block_px``."""
    count = max(1, round(float(arc[-1]) / block_px))
    member = np.minimum((arc * (count / max(float(arc[-1]), 1e-9))).astype(np.intp), count - 1)
    return np.flatnonzero(np.diff(member, prepend=-1))


def _profiles(
    image: AnyGrey, pixels: FloatArray, normal: FloatArray, starts: NDArray[np.intp], wide: int, narrow: int
) -> FloatArray:
    """Mean grey profiles (M, 2 wide + 1) of blocks across a curve, steps apart.

    What lies beyond ``narrow`` steps only serves comparison, and is sampled more sparsely along long blocks.
    """
    # no fewer than one sample a block, the shortest included
    shortest = int(np.diff(np.append(starts, len(pixels))).min())
    every = max(1, min(shortest, len(pixels) // len(starts) // BESIDE_SAMPLES))
    if wide == narrow or every == 1:
        return _block_means(straighten(image, pixels, normal, STEP_PX * steps(wide)), starts)
    some = slice(None, None, every)
    profiles = _block_means(
        straighten(image, pixels[some], normal[some], STEP_PX * steps(wide)), (starts + every - 1) // every
    )
    own = straighten(image, pixels, normal, STEP_PX * steps(narrow))
    profiles[:, wide - narrow : wide + narrow + 1] = _block_means(own, starts)
    return profiles


def _block_means(ribbon: NDArray[np.float32], starts: NDArray[np.intp]) -> FloatArray:
    size = np.diff(np.append(starts, len(ribbon)))
    return np.asarray(np.add.reduceat(ribbon, starts, axis=0) / size[:, None].astype(np.float64))


def _inside(
    image: AnyGrey, pixels: FloatArray, normal: FloatArray, starts: NDArray[np.intp], offsets: FloatArray
) -> NDArray[np.bool_]:
    """Whether blocks lie wholly in the frame at all of several offsets (S, K) across a curve: (S, M)."""
    height, width = image.shape
    ends = np.stack([starts, np.append(starts[1:], len(pixels)) - 1])
    place = pixels[ends] + offsets[:, :, None, None, None] * normal[ends]
    with np.errstate(invalid="ignore"):
        return np.asarray(((place >= 0) & (place <= (width - 1, height - 1))).all(axis=(1, 2, 4)))


def _peaks(
    amplitude: FloatArray,
    energy: FloatArray,
    kernel: FloatArray,
    wires: int,
    overlap: FloatArray,
    half_range: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Best position (fractional window number), sigma px, snr, correlation, contrast and noise (S, M).

    From the amplitude and energy (S, M, K) of the windows about S places of M blocks, with their kernels (M, n) for
    all sub-conductors one after the other, what their windows share makes of the variance (M,), and how far aside the
    wire may be (M,), px.
    """
    n = kernel.shape[1]
    score = correlation(amplitude, energy, n)
    # the outermost windows only serve the parabola
    across = steps(score.shape[-1] // 2)[1:-1] * STEP_PX
    looked_at = np.abs(across) <= half_range[:, None] + STEP_PX
    peak = np.argmax(np.where(looked_at, score[..., 1:-1], -1.0), axis=-1)[..., None] + 1

    def at(values: FloatArray, shift: int = 0) -> FloatArray:
        return np.asarray(np.take_along_axis(values, peak + shift, axis=-1)[..., 0])

    here, height, sign = at(score), at(amplitude), np.sign(at(amplitude))
    before, after = (np.where(np.sign(at(amplitude, d)) == sign, at(score, d), 0.0) for d in (-1, 1))
    bend = before - 2 * here + after
    summit = (here >= before) & (here >= after) & (bend < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        position = np.where(summit, peak[..., 0] + 0.5 * (before - after) / bend, np.nan)
    size = np.abs(height)
    noise = np.sqrt(np.maximum(at(energy) - size**2, 0.0) / (n - 3 * wires) + ROUNDING_GREY**2)
    slopes = np.asarray(np.gradient(kernel.reshape(len(kernel), wires, -1), STEP_PX, axis=2))
    steepness = np.sqrt(np.sum(slopes**2, axis=(1, 2)))
    snr = size / (noise * np.sqrt(CORRELATED * overlap))
    sigma = 1 / np.maximum(snr * steepness, 1e-6)
    return position, sigma, snr, here, height * np.ptp(kernel, axis=1), noise


def _uneven_noise(
    profiles: list[FloatArray], kernels: list[FloatArray], middles: FloatArray, start: FloatArray
) -> FloatArray:
    """Noise (M,), grey levels, of what is not the same on both sides of a wire, or of a bundle; infinite if not known.

    A wire is wider, sharper or darker within than its kernel says, but alike on both sides, and what is alike on both
    sides does not move it. From profiles (M, K) about every sub-conductor at ``middles`` (m, M), in the windows that
    begin at the columns ``start`` (M,).
    """
    order = np.argsort(middles.mean(axis=1))
    unknown = np.full(len(start), np.inf)
    if not np.allclose(middles[order], -middles[order[::-1]], atol=SYMMETRIC_PX):
        return unknown
    wires, n = len(order), kernels[0].shape[1]
    first = np.rint(np.nan_to_num(start)).astype(np.intp)[:, None]
    columns = np.clip(first + np.arange(n), 0, profiles[0].shape[1] - 1)
    windows = np.stack([np.take_along_axis(profiles[k], columns, axis=1) for k in order], axis=1)
    windows -= windows.mean(axis=2, keepdims=True)
    slope = steps(n // 2) / np.linalg.norm(steps(n // 2))
    windows -= (windows @ slope)[..., None] * slope
    turned = np.stack([np.gradient(kernels[k], axis=1) for k in order], axis=1)
    turned -= (turned @ slope)[..., None] * slope
    rest = (0.5 * (windows - windows[:, ::-1, ::-1])).reshape(len(start), -1)
    # a fraction of a step between window and wire looks like the kernel's slope, and is no noise
    turned = turned.reshape(len(start), -1)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    rest -= np.sum(rest * turned, axis=1, keepdims=True) * turned
    own = np.sum(rest**2, axis=1) / max(wires * (n // 2) - wires - 1, 1)
    around = own.copy()
    around[1:-1] = (own[:-2] + own[1:-1] + own[2:]) / 3
    noise = UNEVEN * np.sqrt(np.maximum(own, around))
    return np.where(np.isfinite(start), np.hypot(noise, ROUNDING_GREY), np.inf)


def compare(profiles: FloatArray, kernel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slide kernels (M, n) of :func:`unit_kernels` over profiles (M, K).

    Returns:
        Amplitude (M, K-n+1) of the kernel in each window, signed, and the window's energy without mean and slope.
    """
    n = kernel.shape[1]
    level = profiles - profiles.mean(axis=1, keepdims=True)
    amplitude = np.einsum("mkn,mn->mk", sliding_window_view(level, n, axis=1), kernel)
    # sums over windows are differences of running sums
    columns = np.arange(profiles.shape[1])
    total, tilted, squared = (_window_sums(part, n) for part in (level, level * columns, level * level))
    middle = columns[: total.shape[1]] + 0.5 * (n - 1)
    steepest = n * (n * n - 1) / 12
    energy = squared - total**2 / n - (tilted - middle * total) ** 2 / steepest
    return amplitude, np.maximum(energy, 0.0)


def _window_sums(values: FloatArray, n: int) -> FloatArray:
    """Sums (M, K-n+1) over the windows of n columns of values (M, K)."""
    running = np.zeros((len(values), values.shape[1] + 1))
    np.cumsum(values, axis=1, out=running[:, 1:])
    return running[:, n:] - running[:, :-n]


def correlation(amplitude: FloatArray, energy: FloatArray, n: int) -> FloatArray:
    """Correlation 0..1 of windows of n samples with their kernel, either sign, small where there is only rounding."""
    return np.asarray(np.abs(amplitude) / np.sqrt(energy + n * FLOOR_GREY**2))
