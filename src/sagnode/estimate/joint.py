r"""The joint estimate: camera, attachments, sag and swing at once, maximum a posteriori.

The unknowns θ are those of :mod:`sagnode.survey`, whose standard uncertainties are the prior P. Observations are
tracked landmarks and offsets of the wire across the predicted curve, px. With J their derivatives by θ and C their
covariances, Gauss-Newton steps, shortened where they go farther than the prior allows, minimise
``Σ rᵀC⁻¹r + (θ-θ₀)ᵀP⁻¹(θ-θ₀)``; the posterior covariance is ``(Σ JᵀC⁻¹J + P⁻¹)⁻¹``. What does not settle says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sagnode.geometry.camera import FloatArray, project, projection_derivatives
from sagnode.geometry.conductor import conductor_points
from sagnode.survey import CAMERA, SAG, SIZE, SWING, Survey

CORRELATED_PX = 0.10
"""Standard deviation of what neighbouring offsets share: background gradients, residuals of the lens model."""
CORRELATION_LENGTH_PX = 60.0


@dataclass(frozen=True)
class LandmarkObservations:
    """Landmarks seen: surveyed positions (N, 3) with uncertainty (N,) m, pixels (N, 2) with uncertainty (N,) px."""

    positions: FloatArray
    position_u: FloatArray
    pixels: FloatArray
    pixel_u: FloatArray

    @property
    def count(self) -> int:
        """How many."""
        return len(self.positions)


@dataclass(frozen=True)
class CurveObservations:
    """Offsets of the wire across the curve at some parameters.

    Attributes:
        t: curve parameters (M,).
        arc: position along the curve, px (M,).
        normal: unit normals (M, 2).
        measured: pixels (M, 2) on the wire: curve plus offset along the normal.
        sigma: white standard uncertainty of the offsets, px (M,).
    """

    t: FloatArray
    arc: FloatArray
    normal: FloatArray
    measured: FloatArray
    sigma: FloatArray


@dataclass(frozen=True)
class Solution:
    """A maximum a posteriori estimate.

    Attributes:
        theta: estimate (18,).
        covariance: posterior (18, 18).
        information: by source of uncertainty, the matrices G with Σ G = covariance (18, 18): the printed budget.
        residual: curve residuals, px (M,).
        weight: robust weights (M,) in [0, 1].
        landmark_residual: px (N, 2).
        landmark_weight: robust weights (N,).
        landmark_z: root mean square of the landmarks' residuals over their standard uncertainties.
        inflation: factor by which the curve's variance exceeded what was expected (at least 1).
        converged: the last step was smaller than a hundredth of a standard uncertainty.
    """

    theta: FloatArray
    covariance: FloatArray
    information: dict[str, FloatArray]
    residual: FloatArray
    weight: FloatArray
    landmark_residual: FloatArray
    landmark_weight: FloatArray
    landmark_z: float
    inflation: float
    converged: bool


_STEPS = np.array([1e-3] * 6 + [1e-3, 1e-4])
"""Steps of the numerical derivatives by attachments (m), sag (m) and swing (rad)."""


def _landmark_terms(
    survey: Survey, theta: FloatArray, seen: LandmarkObservations
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (N, 2), derivatives (N, 2, 18) and covariances (N, 2, 2) of the landmarks."""
    intrinsics, pose = survey.camera(theta)
    residual = seen.pixels - project(intrinsics, pose, seen.positions)[0]
    by_point, by_camera = projection_derivatives(intrinsics, pose, seen.positions)
    jacobian = np.zeros((seen.count, 2, SIZE))
    jacobian[..., CAMERA] = by_camera
    covariance = np.einsum("nik,njk->nij", by_point, by_point) * (seen.position_u**2)[:, None, None]
    covariance += np.eye(2) * (seen.pixel_u**2)[:, None, None]
    return residual, jacobian, covariance


def _curve_terms(survey: Survey, theta: FloatArray, curve: CurveObservations) -> tuple[FloatArray, FloatArray]:
    """Residuals (M,) and derivatives (M, 18) of the offsets across the curve."""
    intrinsics, pose = survey.camera(theta)
    # the shape at θ, and at θ ± each of its eight own unknowns, in one call
    shifts = np.zeros((17, 8))
    shifts[1:9] = np.diag(_STEPS)
    shifts[9:] = -np.diag(_STEPS)
    own = theta[10:18] + shifts
    near, far = survey.near + own[:, 0:3], survey.far + own[:, 3:6]
    points = conductor_points(near, far, own[:, 6], own[:, 7], curve.t)
    residual = np.sum((curve.measured - project(intrinsics, pose, points[0])[0]) * curve.normal, axis=1)
    by_point, by_camera = projection_derivatives(intrinsics, pose, points[0])
    by_shape = (points[1:9] - points[9:]) / (2 * _STEPS)[:, None, None]
    jacobian = np.empty((len(curve.t), SIZE))
    jacobian[:, CAMERA] = np.einsum("mi,mik->mk", curve.normal, by_camera)
    jacobian[:, 10:] = np.einsum("mi,mij,kmj->mk", curve.normal, by_point, by_shape)
    return residual, jacobian


def _curve_covariance(curve: CurveObservations) -> tuple[FloatArray, FloatArray]:
    """White (M,) variances and correlated (M, M) covariance of the offsets, px²."""
    distance = np.abs(curve.arc[:, None] - curve.arc[None, :])
    return curve.sigma**2, CORRELATED_PX**2 * np.exp(-distance / CORRELATION_LENGTH_PX)


def _robust(z2: FloatArray, limit: float) -> FloatArray:
    """Cauchy weights of squared standardised residuals."""
    return np.asarray(1.0 / (1.0 + z2 / limit**2))


def solve(
    survey: Survey,
    start: FloatArray,
    landmarks: LandmarkObservations | None,
    curve: CurveObservations | None,
    iterations: int = 10,
) -> Solution:
    """Maximum a posteriori θ from landmarks and curve offsets, either of which may be missing.

    A curve keeps its measured pixels while θ moves; call again with offsets measured about the new curve until
    nothing changes. Without a curve only the camera's ten unknowns move.
    """
    sigma0 = survey.prior_sigma()
    mean0 = survey.prior_mean()
    active = np.arange(SIZE) if curve is not None else np.arange(10)
    theta = start.copy()
    precision0 = np.diag(1 / sigma0**2)
    weight = np.ones(0 if curve is None else len(curve.t))
    landmark_weight = np.ones(0 if landmarks is None else landmarks.count)
    white = correlated = np.zeros(0)
    if curve is not None:
        white, correlated = _curve_covariance(curve)
    inflation, converged = 1.0, False
    lr, lj, lc = np.zeros((0, 2)), np.zeros((0, 2, SIZE)), np.zeros((0, 2, 2))
    cr, cj = np.zeros(0), np.zeros((0, SIZE))

    def terms(th: FloatArray) -> None:
        nonlocal lr, lj, lc, cr, cj
        if landmarks is not None and landmarks.count:
            lr, lj, lc = _landmark_terms(survey, th, landmarks)
        if curve is not None:
            cr, cj = _curve_terms(survey, th, curve)

    information: dict[str, FloatArray] = {}
    normal_matrix = precision0.copy()
    for step_number in range(iterations):
        terms(theta)
        if len(lr):
            inverse = np.linalg.inv(lc)
            landmark_weight = _robust(np.einsum("ni,nij,nj->n", lr, inverse, lr), 3.5)
        gradient = precision0 @ (mean0 - theta)
        normal_matrix = precision0.copy()
        if len(lr):
            weighted = inverse * landmark_weight[:, None, None]
            normal_matrix += np.einsum("nik,nij,njl->kl", lj, weighted, lj)
            gradient += np.einsum("nik,nij,nj->k", lj, weighted, lr)
        if curve is not None:
            spread = max(1.4826 * float(np.median(np.abs(cr))), 1e-3)
            scale2 = white + CORRELATED_PX**2 + (0.0 if step_number > 1 else spread**2)
            weight = _robust(cr**2 / scale2, 2.5)
            covariance = np.diag(white / np.maximum(weight, 1e-6)) + correlated
            solved = np.linalg.solve(covariance, np.column_stack([cj, cr]))
            inflation = _inflation(cr, covariance, weight)
            normal_matrix += cj.T @ solved[:, :-1] / inflation
            gradient += cj.T @ solved[:, -1] / inflation
        scale = np.sqrt(np.diag(normal_matrix))
        scaled = normal_matrix / np.outer(scale, scale) + 1e-9 * np.eye(SIZE)
        step = np.linalg.solve(scaled, gradient / scale) / scale
        step[np.setdiff1d(np.arange(SIZE), active)] = 0.0
        # a step farther than the prior allows is a sign of a wrong wire or a wrong survey: walk, don't jump
        ratio = float(np.max(np.abs(step[active]) / (3 * sigma0[active])))
        theta = theta + step / max(1.0, ratio)
        theta[SAG] = np.clip(theta[SAG], 0.2 * survey.sag_range[0], 2 * survey.sag_range[1])
        theta[SWING] = np.clip(theta[SWING], -1.4, 1.4)
        posterior = np.linalg.inv(normal_matrix)
        if step_number >= 2 and np.all(np.abs(step[active]) < 0.01 * np.sqrt(np.diag(posterior))[active]):
            converged = True
            break
    terms(theta)
    posterior = np.linalg.inv(normal_matrix)
    posterior = 0.5 * (posterior + posterior.T)
    information = _budget(posterior, sigma0, lj, lc, landmark_weight, cj, white, correlated, weight, inflation)
    landmark_z = 0.0
    if len(lr):
        squared = np.einsum("ni,nij,nj->n", lr, np.linalg.inv(lc), lr)
        landmark_z = float(np.sqrt(np.sum(landmark_weight * squared) / (2 * max(float(landmark_weight.sum()), 1e-9))))
    return Solution(theta, posterior, information, cr, weight, lr, landmark_weight, landmark_z, inflation, converged)


def _inflation(residual: FloatArray, covariance: FloatArray, weight: FloatArray) -> float:
    """By how much the offsets scatter more than their covariance says: the Birge ratio squared, at least 1."""
    variance = np.diag(covariance) * weight / np.maximum(weight, 1e-6)
    effective = max(float(weight.sum()) - 4.0, 1.0)
    chi2 = float(np.sum(weight * residual**2 / np.maximum(variance, 1e-12)))
    return max(1.0, chi2 / effective)


def _budget(
    posterior: FloatArray,
    sigma0: FloatArray,
    lj: FloatArray,
    lc: FloatArray,
    landmark_weight: FloatArray,
    cj: FloatArray,
    white: FloatArray,
    correlated: FloatArray,
    weight: FloatArray,
    inflation: float,
) -> dict[str, FloatArray]:
    """Split the posterior by source: Σ = Σ (P⁻¹ + Σ JᵀC⁻¹J) Σ, term by term; each piece is (18, 18)."""
    groups = {
        "orientation prior": [0, 1, 2],
        "camera position": [3, 4, 5],
        "intrinsics": [6, 7, 8, 9],
        "near attachment": [10, 11, 12],
        "far attachment": [13, 14, 15],
        "sag prior": [SAG],
        "swing prior": [SWING],
    }
    pieces: dict[str, FloatArray] = {}
    for name, indices in groups.items():
        precision = np.zeros((SIZE, SIZE))
        precision[indices, indices] = 1 / sigma0[indices] ** 2
        pieces[name] = posterior @ precision @ posterior
    if len(lj):
        weighted = np.linalg.inv(lc) * landmark_weight[:, None, None]
        pieces["landmarks"] = posterior @ np.einsum("nik,nij,njl->kl", lj, weighted, lj) @ posterior
    if len(cj):
        variance = white / np.maximum(weight, 1e-6)
        gain = np.linalg.solve(np.diag(variance) + correlated, cj) / inflation
        pieces["pixel noise"] = posterior @ (gain.T * (variance * inflation)) @ gain @ posterior
        pieces["correlated curve error"] = posterior @ gain.T @ (correlated * inflation) @ gain @ posterior
    return pieces
