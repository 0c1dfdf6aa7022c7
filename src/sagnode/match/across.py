"""What one block after another shows across a curve, in NumPy: what ``sagnode.native.kernels.localise`` computes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.closer import look_closer
from sagnode.match.kernels import STEP_PX, bundle_kernels, kernel_reach, shared_noise, steps
from sagnode.match.ribbon import straighten
from sagnode.match.surer import ROUNDING_GREY, Found, settle

AnyGrey = GreyImage | NDArray[np.float32]

FLOOR_GREY = 0.2
"""Structure below this many grey levels is taken for 8-bit rounding: it cannot make a peak."""
BESIDE_SAMPLES = 6
"""Samples along a block that suffice to see what the surroundings look like."""
SHARING = 1.05
"""Factor of the variance (see ``kernels.shared_noise``) from which windows about sub-conductors share pixels."""
SYMMETRIC_PX = 0.2
"""Sub-conductors are mirrored about a bundle's centre line when their places differ by less."""
CORRELATED = 2.7
"""Variance factor of the offset for neighbouring samples sharing pixels (bilinear, ½ px apart); see the tests."""


@dataclass(frozen=True)
class Stretch:
    """A curve that is looked across in M blocks.

    Attributes:
        pixels: (N, 2).
        normal: unit normals (N, 2).
        width: expected width of one wire, px (N,).
        half_range: greatest offset looked for, px (N,).
        members: offsets of a bundle's sub-conductors across the curve, px (m, N); one row of zeros for a wire.
        starts: first sample of each block (M,).
        blur_px: standard deviation of the picture's blur.
        margin_px: background taken in on either side.
        exact: look closer at what was found.
    """

    pixels: FloatArray
    normal: FloatArray
    width: FloatArray
    half_range: FloatArray
    members: FloatArray
    starts: NDArray[np.int64]
    blur_px: float
    margin_px: float
    exact: bool = True

    def block_sizes(self) -> NDArray[np.int64]:
        """Samples of each block (M,)."""
        ends = np.empty_like(self.starts)
        ends[:-1], ends[-1] = self.starts[1:], len(self.pixels)
        return ends - self.starts


@dataclass(frozen=True)
class Seen:
    """What the blocks of a stretch show.

    Attributes:
        blocks: offset px, its sigma px, snr, correlation and contrast (5, M), as in ``localise.Blocks``.
        valid: which of them count (M,).
        beside: snr at the other places (S, M).
        inside: which blocks have their centres in the frame there (S, M).
    """

    blocks: FloatArray
    valid: NDArray[np.bool_]
    beside: FloatArray
    inside: NDArray[np.bool_]


def look_across(image: AnyGrey, stretch: Stretch, centres: NDArray[np.int64]) -> Seen:
    """Find the wire about the curve itself and about S other places, ``centres`` (S + 1,) steps aside, 0 the first."""
    pixels, normal, starts = stretch.pixels, stretch.normal, stretch.starts
    size = stretch.block_sizes()
    width = np.add.reduceat(stretch.width, starts) / size
    near = kernel_reach(float(np.max(width)), stretch.blur_px, stretch.margin_px)
    half_range = np.add.reduceat(stretch.half_range, starts) / size
    far = int(np.ceil(float(np.max(stretch.half_range)) / STEP_PX)) + 1
    reach = int(np.max(np.abs(centres))) + far
    members = stretch.members
    wires = [pixels + offset[:, None] * normal for offset in members] if len(members) > 1 else [pixels]
    middles = np.add.reduceat(members, starts, axis=1) / size
    kernels, norm = bundle_kernels(width, middles, STEP_PX * steps(near), stretch.blur_px)
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
    at = reach - far + position[0]
    found = Found(
        sigma=sigma[0],
        noise=noise[0],
        uneven=_uneven(profiles, kernels, middles, at),
        height=contrast[0] / (np.ptp(kernel, axis=1) * norm),
        # where windows share pixels, the noise of one side is in the other too
        alike=_symmetric(middles) & (overlap < SHARING) & np.isfinite(at),
        correlated=np.sqrt(CORRELATED * overlap),
    )
    seen = np.all([_inside(image, wire, normal, starts, ends) for wire in wires], axis=0)
    valid = seen & np.isfinite(offset) & (np.abs(offset) <= half_range)
    columns = near + at if stretch.exact else np.full(len(starts), np.nan)
    close = look_closer(profiles, middles, width, columns, stretch.margin_px, near)
    surer, sigma[0] = settle(found, close)
    offset[0] += np.where(surer, close.farther, 0.0)
    unknown = np.array([np.nan, np.nan, 0.0, 0.0, 0.0])[:, None]
    blocks = np.where(valid[0], [offset[0], sigma[0], snr[0], likeness[0], contrast[0]], unknown)
    middle = starts + size // 2
    shifted = np.asarray(STEP_PX * centres[1:, None], dtype=np.float64)
    centred = _inside(image, pixels[middle], normal[middle], np.arange(len(starts)), shifted)
    return Seen(blocks, valid[0], np.where(valid[1:], snr[1:], 0.0), centred)


def _profiles(
    image: AnyGrey, pixels: FloatArray, normal: FloatArray, starts: NDArray[np.int64], wide: int, narrow: int
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


def _block_means(ribbon: NDArray[np.float32], starts: NDArray[np.int64]) -> FloatArray:
    size = np.diff(np.append(starts, len(ribbon)))
    return np.asarray(np.add.reduceat(ribbon, starts, axis=0) / size[:, None].astype(np.float64))


def _inside(
    image: AnyGrey, pixels: FloatArray, normal: FloatArray, starts: NDArray[np.int64], offsets: FloatArray
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


def _uneven(
    profiles: list[FloatArray], kernels: list[FloatArray], middles: FloatArray, start: FloatArray
) -> FloatArray:
    """Mean square (M,) of what is not the same on both sides of a wire, or of a symmetric bundle.

    A wire is wider, sharper or darker within than its kernel says, but alike on both sides, and what is alike on both
    sides does not move it. From profiles (M, K) about every sub-conductor at ``middles`` (m, M), in the windows that
    begin at the columns ``start`` (M,).
    """
    order = np.argsort(middles.mean(axis=1))
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
    return np.asarray(np.sum(rest**2, axis=1) / max(wires * (n // 2) - wires - 1, 1))


def _symmetric(middles: FloatArray) -> bool:
    """Whether sub-conductors at ``middles`` (m, M) are mirrored about a bundle's centre line."""
    ordered = middles[np.argsort(middles.mean(axis=1))]
    return np.allclose(ordered, -ordered[::-1], atol=SYMMETRIC_PX)


def compare(profiles: FloatArray, kernel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slide kernels (M, n) of :func:`sagnode.match.kernels.unit_kernels` over profiles (M, K).

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
