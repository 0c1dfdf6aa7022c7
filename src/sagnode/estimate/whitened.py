"""Sums of products weighed by the inverse covariance of offsets that share errors with their neighbours.

An error that falls off exponentially along the curve is a first-order Markov process: a scalar Kalman filter follows
it from one offset to the next, and its normalised innovations are rows whitened by the covariance, no matrix by then.
"""

from __future__ import annotations

import numpy as np

from sagnode.estimate.offsets import CORRELATION_LENGTH_PX, CurveObservations
from sagnode.geometry.camera import FloatArray
from sagnode.native import kernels


def whitened_products(
    curve: CurveObservations, white: FloatArray, rows: FloatArray, sizes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Products (G, K, K) of columns of rows (M, K) weighed by the offsets' inverse covariance, and its log det (G,).

    Args:
        curve: the offsets, in order along the curve.
        white: their variances by themselves, px² (M,).
        rows: of every offset.
        sizes: of the shared error (G, 2): least, px, and relative to an offset's own.
    """
    lights = np.empty((len(rows), 0)) if curve.shading is None else curve.shading
    together = np.column_stack([rows, lights])
    if kernels is None:
        whitened, spread = _whitened(curve, white, together, sizes)
        return _without_lights(np.swapaxes(whitened, 1, 2) @ whitened, spread, rows.shape[1])
    products, spread = np.empty((len(sizes), together.shape[1], together.shape[1])), np.empty(len(sizes))
    own = (np.ascontiguousarray(part, dtype=np.float64) for part in (_kept(curve), curve.sigma, white, together))
    kernels.shared_products(*own, sizes, products, spread)
    return _without_lights(products, spread, rows.shape[1])


def _without_lights(products: FloatArray, spread: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """The same where the covariance has what lights do to all offsets: V, the products' columns beyond the first ones.

    ``(C + VVᵀ)⁻¹ = C⁻¹ - C⁻¹V (1 + VᵀC⁻¹V)⁻¹ VᵀC⁻¹``, and ``|C + VVᵀ| = |C| |1 + VᵀC⁻¹V|``.
    """
    if products.shape[1] == columns:
        return products, spread
    both = products[:, columns:, :columns]
    of_lights = products[:, columns:, columns:] + np.eye(products.shape[1] - columns)
    left = products[:, :columns, :columns] - np.swapaxes(both, 1, 2) @ np.linalg.solve(of_lights, both)
    return left, spread + np.linalg.slogdet(of_lights)[1]


def _kept(curve: CurveObservations) -> FloatArray:
    """What an error keeps of itself from one offset to the next (M,); nothing at the first."""
    kept = np.zeros(len(curve.arc))
    np.exp((curve.arc[:-1] - curve.arc[1:]) / CORRELATION_LENGTH_PX, out=kept[1:])
    return kept


def _whitened(
    curve: CurveObservations, white: FloatArray, rows: FloatArray, sizes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Whitened rows (G, M, K), and the logarithm of the covariance's determinant (G,)."""
    shared = sizes[:, :1] ** 2 + (sizes[:, 1:] * curve.sigma) ** 2
    kept = _kept(curve)
    state, variance = np.zeros((len(sizes), rows.shape[1])), np.ones(len(sizes))
    whitened, spread = np.empty((len(sizes), *rows.shape)), np.zeros(len(sizes))
    for n, row in enumerate(rows):
        own = np.sqrt(shared[:, n])
        before = kept[n] ** 2 * variance + (1 - kept[n] ** 2)
        total = shared[:, n] * before + white[n]
        foreseen = kept[n] * state
        surprise = row - own[:, None] * foreseen
        state = foreseen + (own * before / total)[:, None] * surprise
        whitened[:, n] = surprise / np.sqrt(total)[:, None]
        variance = before * white[n] / total
        spread += np.log(total)
    return whitened, spread
