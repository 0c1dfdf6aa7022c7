"""The last step of an uncalibrated fit: sub-pixel positions of the wire, block by block, and the curve through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.fit.curve import Curve, Prior, adjust
from sagnode.fit.follow import KERNELS, MOST, Picture, best_path, block_length, end_costs, look, polarities
from sagnode.geometry.camera import FloatArray
from sagnode.match.localise import Blocks, localise
from sagnode.match.ribbon import normals

HALF_RANGES_PX = (3.0, 2.5, 2.0, 2.0)
MODEL_PX = 0.2
"""Standard deviation of what no model follows: strands, twist, compression, clouds behind."""
ORDERS = 9
"""Orders of slow departure from the Bézier (lens distortion, weights, splices) that are tried."""
BENT_RANGE_PX = 10.0
"""How far the wire may depart from the Bézier."""
BENT_STEP_PX = 1.0
"""Typical difference of its departures from block to block."""
BEND_PX = 4.0
"""Typical size of the first of them for a chord of a thousand pixels."""
SEARCH_PX = 3.0
"""Half range in which the best line must lie on the curve."""
FLANK_REACH_PX = 9.0
"""Half range that holds the lines whose flank the curve might be."""
OWN = 1.0
"""Least evidence of a line that is not the flank of another."""
AS_GOOD = 0.9
"""How like a wire the line on the curve must look, as a share of the best within the half range."""
ON_PX = 0.5
MOST_ON_PX = 1.0
ALIKE = 2.0
"""Greatest ratio of the contrasts of neighbouring blocks of one wire."""
SHIFTS_PX = (-33.0, -25.0, -18.0, -12.0, 12.0, 18.0, 25.0, 33.0)
"""Where the curve is laid beside itself to learn how often chance looks like a wire."""
BIWEIGHT = 4.0
"""Tukey's constant, standard deviations: a block further off than this is another thing."""


@dataclass(frozen=True)
class Refined:
    """The final curve and how the blocks lie about it.

    Attributes:
        curve: in pixels of the picture.
        fraction: arc fractions of the blocks (M,).
        sure: blocks in which the best line across lies on the curve and goes on next door (M,).
        alone: those of them in which nothing within reach across looks more like a wire (M,).
        residual_px: root mean square distance of the wire from the curve in those; infinite without any.
        by_chance: share of sure blocks on the same curve laid beside itself.
        contrast: median of wire less background in sure blocks, grey levels; 0 without any.
    """

    curve: Curve
    fraction: FloatArray
    sure: NDArray[np.bool_]
    alone: NDArray[np.bool_]
    residual_px: float
    by_chance: float
    contrast: float


def refine(
    picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int], anchors: FloatArray, slack: float
) -> Refined:
    """Fit the curve to sub-pixel positions, with a slow departure from the Bézier if the picture demands one.

    Args:
        picture: grey, single precision.
        curve: within a pixel or two of the wire.
        kernels: numbers of the kernels (see ``sagnode.fit.follow.KERNELS``) that fit its start and its end.
        anchors: the points given (2, 2), px of the picture.
        slack: their standard uncertainty, px.
    """
    plain = Prior(anchors, slack)
    for half_range in HALF_RANGES_PX:
        fraction, offset, sigma = _measure(picture, curve, kernels, half_range)
        curve = _robust(curve, fraction, offset, sigma, plain, 0)
    chord = float(np.linalg.norm(anchors[1] - anchors[0]))
    bending = Prior(anchors, slack, bend=BEND_PX * max(0.2, min(1.0, chord / 1000)))
    bent = _bent(picture, curve, bending)
    for half_range in HALF_RANGES_PX[1:]:
        fraction, offset, sigma = _measure(picture, bent, kernels, half_range)
        bent = _robust(bent, fraction, offset, sigma, bending, ORDERS)
    # Bayesian information criterion: each order must earn the logarithm of the number of blocks
    if _cost(picture, curve, kernels) - _cost(picture, bent, kernels) > ORDERS * np.log(max(2, len(fraction))):
        curve = bent
    return _inspect(picture, curve, kernels)


def seen_share(picture: Picture, curve: Curve) -> float:
    """Share of the blocks of a curve (in pixels of the frame) that show a wire of any width, in one picture."""
    here = curve.moved(picture.origin, picture.scale)
    options = [(number, number) for number in range(len(KERNELS))]
    own = _own(picture.grey, here)
    return max(float((own & _sure(picture.grey, here, kernels)[0]).mean()) for kernels in options)


def _inspect(picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int]) -> Refined:
    """Which blocks of the final curve show the wire, beside how many would by chance."""
    sure, blocks, fraction, alone = _sure(picture, curve, kernels)
    sure &= _own(picture, curve)
    offset = blocks.offset[sure]
    chance = [_sure(picture, curve, kernels, shift)[0].mean() for shift in SHIFTS_PX]
    return Refined(
        curve=curve,
        fraction=fraction,
        sure=sure,
        alone=sure & alone,
        residual_px=float(np.sqrt(np.mean(offset**2))) if sure.any() else float("inf"),
        by_chance=float(np.mean(chance)),
        contrast=float(np.median(np.abs(blocks.contrast[sure]))) if sure.any() else 0.0,
    )


def _own(picture: NDArray[np.float32], curve: Curve) -> NDArray[np.bool_]:
    """Blocks (M,) that have some evidence of a line in its own right on the curve."""
    seen = look(picture, curve, FLANK_REACH_PX)
    middle = np.abs(seen.offsets) <= MOST_ON_PX
    result: NDArray[np.bool_] = np.abs(seen.signed[:, :, middle]).max(axis=(0, 2)) > OWN
    return result


def _sure(
    picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int], shift: float = 0.0
) -> tuple[NDArray[np.bool_], Blocks, FloatArray, NDArray[np.bool_]]:
    """Blocks with a line on the curve that goes on next door.

    Returns:
        Which blocks (M,); all blocks; their arc fractions (M,); and where nothing else looks better (M,).

    The line must look about as much like a wire as any within reach (a neighbour may look as good), and a block next to
    it must show one of its sign and roughly its contrast. Texture has lines everywhere, but not on the curve, and not
    the same ones from block to block.
    """
    wide, count = _blocks(picture, curve, kernels, SEARCH_PX, shift)
    near, _ = _blocks(picture, curve, kernels, MOST_ON_PX + 0.25, shift)
    on = near.valid & (np.abs(near.offset) <= np.minimum(ON_PX + 2 * near.sigma, MOST_ON_PX))
    on &= near.correlation >= AS_GOOD * wide.correlation
    # the shoulder of a strong line is a line too, but a faint one
    on &= np.abs(near.contrast) >= 0.5 * np.abs(wide.contrast)
    level = np.where(on, near.contrast, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        alike = np.abs(np.log(level[1:] / level[:-1])) < np.log(ALIKE)
    found: NDArray[np.bool_] = np.append(alike, False) | np.insert(alike, 0, False)
    alone = np.abs(wide.offset) <= MOST_ON_PX
    return found, near, near.index / (count - 1), alone


def _blocks(
    picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int], half_range: float, shift: float = 0.0
) -> tuple[Blocks, int]:
    """Wire positions about a curve, or about the curve shifted along its normals; and its number of samples."""
    length = curve.length()
    count = max(16, int(length) + 1)
    _, pixels = curve.evenly(count)
    normal = normals(pixels)
    (first, margin), (last, end_margin) = KERNELS[kernels[0]], KERNELS[kernels[1]]
    width = np.linspace(first, last, count)
    across = pixels + shift * normal
    blocks = localise(
        picture, across, normal, width, half_range, block_length(length), margin_px=min(margin, end_margin), exact=False
    )
    return blocks, count


def _measure(
    picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int], half_range: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arc fractions, offsets (NaN where nothing was seen) and their standard uncertainties (M,)."""
    blocks, count = _blocks(picture, curve, kernels, half_range)
    return blocks.index / (count - 1), blocks.offset, blocks.sigma


def _bent(picture: NDArray[np.float32], curve: Curve, prior: Prior) -> Curve:
    """The curve with the departure that the most likely smooth path in a wide ribbon asks for."""
    seen = look(picture, curve, BENT_RANGE_PX)
    costs = end_costs(curve, prior.anchors, prior.slack, seen.offsets)
    paths = [(*best_path(e, *costs, BENT_STEP_PX), e) for e in polarities(seen.signed, seen.inside)]
    path, _, evidence = max(paths, key=lambda one: one[1])
    column = np.rint(path).astype(np.intp)
    strength = np.maximum(evidence[np.arange(len(path)), column], 0.0) / MOST
    bent, _ = adjust(curve, seen.fraction, seen.offsets[column], strength / 0.5**2, prior, ORDERS)
    return bent


def _cost(picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int]) -> float:
    """Sum over the blocks of Tukey's loss of the wire's distance from a curve; a block without a wire costs most."""
    _, offset, sigma = _measure(picture, curve, kernels, SEARCH_PX)
    seen = np.isfinite(offset)
    squared = np.where(seen, offset, 0.0) ** 2 / (np.where(seen, sigma, 1.0) ** 2 + MODEL_PX**2) / BIWEIGHT**2
    share = np.where(seen, np.minimum(squared, 1.0), 1.0)
    return float(BIWEIGHT**2 / 3 * (1 - (1 - share) ** 3).sum())


def _robust(
    curve: Curve, fraction: FloatArray, offset: FloatArray, sigma: FloatArray, prior: Prior, orders: int
) -> Curve:
    """Curve through the offsets by iteratively reweighted least squares (Tukey)."""
    seen = np.isfinite(offset)
    variance = np.where(seen, sigma, 1.0) ** 2 + MODEL_PX**2
    measured = np.where(seen, offset, 0.0)
    weight = np.where(seen, 1.0, 0.0)
    moved = curve
    # wide at first, so that a curve a pixel off is not taken for a good one with outliers
    for widen in (5.0, 3.0, 2.0, 1.0, 1.0):
        moved, predicted = adjust(curve, fraction, measured, weight / variance, prior, orders)
        squared = np.minimum((measured - predicted) ** 2 / variance / (BIWEIGHT * widen) ** 2, 1.0)
        weight = np.where(seen, (1 - squared) ** 2, 0.0)
    return moved
