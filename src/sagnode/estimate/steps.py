"""What Gauss-Newton's method takes whatever it solves for: weights, one step, and its length."""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.native import kernels

SETTLED = 0.01
"""A step of less than this share of a standard uncertainty is the last."""


def robust_weights(z2: FloatArray, limit: float) -> FloatArray:
    """Cauchy weights of squared standardised residuals."""
    return np.asarray(1.0 / (1.0 + z2 / limit**2))


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of linear equations; NaN where the matrix has no inverse, which the caller refuses as a step."""
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)


def solved_each(matrices: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solutions (K, n, r) of equations with symmetric matrices (K, n, n), and their log determinants (K,).

    The unknowns may have very different sizes. NaN where a matrix is not positive definite.
    """
    if kernels is not None:
        solution, log_det = np.empty(right.shape), np.empty(len(matrices))
        own = (np.ascontiguousarray(part, dtype=np.float64) for part in (matrices, right))
        kernels.solve_each(*own, solution, log_det)
        return solution, log_det
    solution, log_det = np.full(right.shape, np.nan), np.full(len(matrices), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1 / np.sqrt(np.diagonal(matrices, axis1=1, axis2=2))
        scaled = matrices * scale[:, :, None] * scale[:, None, :]
    for k, own in enumerate(scale):
        if np.isfinite(scaled[k]).all() and (np.linalg.eigvalsh(scaled[k]) > 0).all():
            factor = np.linalg.cholesky(scaled[k])
            solution[k] = own[:, None] * solved(factor.T, solved(factor, own[:, None] * right[k]))
            log_det[k] = 2 * float(np.log(np.diag(factor) / own).sum())
    return solution, log_det


def solve_scaled(matrix: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solution of a normal equation whose unknowns have very different sizes, and the inverse of its matrix.

    NaN where there is none.
    """
    scale = 1 / np.sqrt(np.diag(matrix))
    both = scale[:, None] * scale
    scaled = matrix * both
    scaled[np.diag_indices_from(scaled)] += 1e-9
    inverse = solved(scaled, np.eye(len(scaled)))
    return np.asarray(scale * (inverse @ (scale * vector))), np.asarray(inverse * both)


def step_length(step: FloatArray, covariance: FloatArray) -> float:
    """Greatest part of a step (n,), in standard uncertainties of a covariance (n, n)."""
    return float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))
