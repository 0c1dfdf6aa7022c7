"""The last step of an uncalibrated fit: sub-pixel positions of the wire, block by block, and the curve through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.fit_curve import Curve, Prior, adjust
from sagnode.match.fit_follow import KERNELS, block_length
from sagnode.match.localise import localise
from sagnode.match.ribbon import normals

HALF_RANGES_PX = (3.0, 2.5, 2.0, 2.0)
MODEL_PX = 0.2
"""Standard deviation of what no model follows: strands, twist, compression, clouds behind."""
ORDERS = 5
"""Orders of slow departure from the Bézier (lens distortion, weights, splices) that are tried."""
BEND_PX = 3.0
"""Typical size of the first of them for a chord of a thousand pixels."""
BIWEIGHT = 4.0
"""Tukey's constant, standard deviations: a block further off than this is another thing."""


@dataclass(frozen=True)
class Refined:
    """The final curve and how the blocks lie about it.

    Attributes:
        curve: in pixels of the picture.
        fraction: arc fractions of the blocks (M,).
        rest: offset of the wire from the curve, px (M,); NaN where none was seen.
        agrees: blocks that lie where the curve does, within what they and the model are unsure of (M,).
        residual_px: root mean square of the rest over those; infinite without any.
    """

    curve: Curve
    fraction: FloatArray
    rest: FloatArray
    agrees: NDArray[np.bool_]
    residual_px: float


def refine(
    picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int], anchors: FloatArray, slack: float
) -> Refined:
    """Fit the curve to sub-pixel positions, with a slow departure from the Bézier if the picture demands one.

    Args:
        picture: grey, single precision.
        curve: within a pixel or two of the wire.
        kernels: numbers of the kernels (see ``fit_follow.KERNELS``) that fit its start and its end.
        anchors: the points given (2, 2), px of the picture.
        slack: their standard uncertainty, px.
    """
    plain = Prior(anchors, slack)
    for half_range in HALF_RANGES_PX:
        fraction, offset, sigma = _measure(picture, curve, kernels, half_range)
        curve, _ = _robust(curve, fraction, offset, sigma, plain, 0)
    fraction, offset, sigma = _measure(picture, curve, kernels, HALF_RANGES_PX[-1])
    curve, cost = _robust(curve, fraction, offset, sigma, plain, 0)
    chord = float(np.linalg.norm(anchors[1] - anchors[0]))
    bent_prior = Prior(anchors, slack, bend=BEND_PX * min(1.0, chord / 1000))
    bent, bent_cost = _robust(curve, fraction, offset, sigma, bent_prior, ORDERS)
    # Bayesian information criterion: each order must earn the logarithm of the number of blocks
    if cost - bent_cost > ORDERS * np.log(max(2, len(fraction))):
        for _ in range(2):
            fraction, offset, sigma = _measure(picture, bent, kernels, HALF_RANGES_PX[-1])
            bent, _ = _robust(bent, fraction, offset, sigma, bent_prior, ORDERS)
        curve = bent
    fraction, offset, sigma = _measure(picture, curve, kernels, HALF_RANGES_PX[-1])
    near = np.abs(offset) <= 3 * np.hypot(sigma, MODEL_PX) + 0.3
    agrees = np.isfinite(offset) & near & (np.abs(offset) < 1.5)
    residual = float(np.sqrt(np.mean(offset[agrees] ** 2))) if agrees.any() else float("inf")
    return Refined(curve, fraction, offset, agrees, residual)


def _measure(
    picture: NDArray[np.float32], curve: Curve, kernels: tuple[int, int], half_range: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arc fractions, offsets (NaN where nothing was seen) and their standard uncertainties (M,)."""
    length = curve.length()
    count = max(16, int(length) + 1)
    _, pixels = curve.evenly(count)
    (first, margin), (last, end_margin) = KERNELS[kernels[0]], KERNELS[kernels[1]]
    width = np.linspace(first, last, count)
    blocks = localise(
        picture,
        pixels,
        normals(pixels),
        width,
        half_range,
        block_length(length),
        margin_px=min(margin, end_margin),
    )
    return blocks.index / (count - 1), blocks.offset, blocks.sigma


def _robust(
    curve: Curve, fraction: FloatArray, offset: FloatArray, sigma: FloatArray, prior: Prior, orders: int
) -> tuple[Curve, float]:
    """Curve through the offsets by iteratively reweighted least squares (Tukey), and its robust cost."""
    seen = np.isfinite(offset)
    variance = np.where(seen, sigma, 1.0) ** 2 + MODEL_PX**2
    measured = np.where(seen, offset, 0.0)
    weight = np.where(seen, 1.0, 0.0)
    moved, cost = curve, 0.0
    # wide at first, so that a curve a pixel off is not taken for a good one with outliers
    for widen in (5.0, 3.0, 2.0, 1.0, 1.0):
        moved, predicted = adjust(curve, fraction, measured, weight / variance, prior, orders)
        squared = np.minimum((measured - predicted) ** 2 / variance / (BIWEIGHT * widen) ** 2, 1.0)
        weight = np.where(seen, (1 - squared) ** 2, 0.0)
        cost = float(np.sum(np.where(seen, BIWEIGHT**2 / 3 * (1 - (1 - squared) ** 3), 0.0)))
    return moved, cost
