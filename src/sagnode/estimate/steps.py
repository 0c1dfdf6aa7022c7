"""What Gauss-Newton's method takes whatever it solves for: weights, one step, and its length."""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray

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
