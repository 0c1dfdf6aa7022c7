r"""The joint estimate: camera, attachments, sag, swing and load at once, maximum a posteriori.

The unknowns θ are those of :mod:`sagnode.survey`, whose standard uncertainties are the prior P. Observations are
tracked landmarks and offsets of the wire across the predicted curve, px. With J their derivatives by θ and C their
covariances, Gauss-Newton steps, shortened where they go farther than the prior allows, minimise
``Σ rᵀC⁻¹r + (θ-θ₀)ᵀP⁻¹(θ-θ₀)``; the posterior covariance is ``(Σ JᵀC⁻¹J + P⁻¹)⁻¹``. What does not settle says so.

Landmarks know nothing but the camera, and all conductors of a frame share them: :func:`solve_camera` is asked once a
frame, and hands on what the landmarks say as a quadratic form that :func:`solve` adds to the prior of each conductor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sagnode.geometry.camera import FloatArray, project, projection_derivatives
from sagnode.geometry.conductor import conductor_derivatives, gravity_direction, load_shapes
from sagnode.match.robust import median
from sagnode.survey import CAMERA, LOAD, SAG, SIZE, SWING, Survey

CORRELATED_PX = 0.03
"""Least standard deviation of what neighbouring offsets share: residuals of the lens model, the wire's own shading."""
CORRELATED_SHARE = 0.7
"""The same, relative to an offset's own: what makes a block uncertain, texture behind it, reaches over to the next."""
CORRELATION_LENGTH_PX = 60.0
CAUCHY_LANDMARK, CAUCHY_CURVE = 3.5, 2.5
"""Standardised residuals at which an observation counts half."""
SETTLED = 0.01
"""A step of less than this share of a standard uncertainty is the last."""
ANEW = 0.5
"""A step of more than this many standard uncertainties makes the derivatives be taken anew."""
SHAPE = slice(10, 18)
"""Attachments, sag and swing among the unknowns."""
STRIDE = (0.1, np.radians(2.0))
"""Longest steps: of sag, as a share of its surveyed range, and of swing."""
SOURCES = {
    "orientation prior": slice(0, 3),
    "camera position": slice(3, 6),
    "intrinsics": slice(6, 10),
    "near attachment": slice(10, 13),
    "far attachment": slice(13, 16),
    "sag prior": slice(SAG, SAG + 1),
    "swing prior": slice(SWING, SWING + 1),
    "load prior": LOAD,
}
"""The prior's sources of uncertainty, by their unknowns."""


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
class CameraKnowledge:
    """What landmarks say about the camera's unknowns x (10,): they add ``xᵀAx - 2bᵀx`` to the misfit.

    Attributes:
        precision: A (10, 10).
        vector: b (10,).
    """

    precision: FloatArray
    vector: FloatArray


NOTHING_KNOWN = CameraKnowledge(np.zeros((10, 10)), np.zeros(10))


@dataclass(frozen=True)
class CameraSolution:
    """The camera as landmarks and survey show it.

    Attributes:
        theta: estimate (28,), nothing but the camera moved from the prior's mean.
        knowledge: what the landmarks say, without the prior.
        residual: of the landmarks, px (N, 2).
        weight: their robust weights (N,).
        z: root mean square of the residuals over their standard uncertainties.
    """

    theta: FloatArray
    knowledge: CameraKnowledge
    residual: FloatArray
    weight: FloatArray
    z: float


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

    @cached_property
    def load_shapes(self) -> FloatArray:
        """What the terms of an uneven load add to the depth there, over the sag (10, M)."""
        return load_shapes(self.t, LOAD.stop - LOAD.start)


@dataclass(frozen=True)
class Solution:
    """A maximum a posteriori estimate.

    Attributes:
        theta: estimate (28,).
        covariance: posterior (28, 28); zero where nothing is unknown.
        residual: curve residuals, px (M,).
        weight: robust weights (M,) in [0, 1].
        inflation: factor by which the curve's variance exceeded what was expected (at least 1).
        misfit: what was minimised, at its end: residuals and corrections to the prior, each over its variance.
        converged: the last step was smaller than a hundredth of a standard uncertainty.
        jacobian: derivatives of the residuals (M, 28).
        noise: white (M,) and correlated (M, M) variances of the offsets as weighted, px².
        camera: what the landmarks said.
    """

    theta: FloatArray
    covariance: FloatArray
    residual: FloatArray
    weight: FloatArray
    inflation: float
    misfit: float
    converged: bool
    jacobian: FloatArray
    noise: tuple[FloatArray, FloatArray]
    camera: CameraKnowledge

    def information(self, survey: Survey) -> dict[str, FloatArray]:
        """The printed budget: the covariance split by source, Σ (P⁻¹ + Σ JᵀC⁻¹J) Σ term by term, each (28, 28)."""
        posterior, sigma0 = self.covariance, survey.prior_sigma()
        pieces: dict[str, FloatArray] = {}
        for name, part in SOURCES.items():
            columns = posterior[:, part] / sigma0[part]
            pieces[name] = columns @ columns.T
        pieces["landmarks"] = posterior[:, CAMERA] @ self.camera.precision @ posterior[CAMERA]
        white, correlated = self.noise
        gain = posterior @ np.linalg.solve(np.diag(white) + correlated, self.jacobian).T / self.inflation
        pieces["pixel noise"] = (gain * (white * self.inflation)) @ gain.T
        pieces["correlated curve error"] = gain @ (correlated * self.inflation) @ gain.T
        return pieces


def solve_camera(survey: Survey, landmarks: LandmarkObservations, iterations: int = 10) -> CameraSolution:
    """The camera's pose and lens from landmarks, with the survey as the prior; ten unknowns."""
    sigma0 = survey.prior_sigma()[CAMERA]
    theta = survey.prior_mean()
    prior = np.diag(1 / sigma0**2)
    weight = np.ones(landmarks.count)
    for step_number in range(iterations):
        residual, jacobian, inverse = _landmark_terms(survey, theta, landmarks)
        squared = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        weight = _robust(squared, CAUCHY_LANDMARK)
        weighted = np.einsum("nik,nij->nkj", jacobian, inverse * weight[:, None, None])
        precision = np.einsum("nkj,njl->kl", weighted, jacobian)
        pull = np.einsum("nkj,nj->k", weighted, residual)
        step, posterior = _scaled_solve(precision + prior, pull - theta[CAMERA] / sigma0**2)
        if step_number >= 2 and _length(step, posterior) < SETTLED:
            break
        ratio = float(np.max(np.abs(step) / (3 * sigma0)))
        theta[CAMERA] += step / max(1.0, ratio)
    residual, jacobian, inverse = _landmark_terms(survey, theta, landmarks)
    squared = np.einsum("ni,nij,nj->n", residual, inverse, residual)
    weighted = np.einsum("nik,nij->nkj", jacobian, inverse * weight[:, None, None])
    precision = np.einsum("nkj,njl->kl", weighted, jacobian)
    vector = precision @ theta[CAMERA] + np.einsum("nkj,nj->k", weighted, residual)
    z = float(np.sqrt(np.sum(weight * squared) / (2 * max(float(weight.sum()), 1e-9))))
    return CameraSolution(theta, CameraKnowledge(precision, vector), residual, weight, z)


def _landmark_terms(
    survey: Survey, theta: FloatArray, seen: LandmarkObservations
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (N, 2), derivatives (N, 2, 10) and inverse covariances (N, 2, 2) of the landmarks."""
    intrinsics, pose = survey.camera(theta)
    residual = seen.pixels - project(intrinsics, pose, seen.positions)[0]
    by_point, by_camera = projection_derivatives(intrinsics, pose, seen.positions)
    covariance = np.einsum("nik,njk->nij", by_point, by_point) * (seen.position_u**2)[:, None, None]
    covariance += np.eye(2) * (seen.pixel_u**2)[:, None, None]
    return residual, by_camera, np.linalg.inv(covariance)


def curve_residual(survey: Survey, theta: FloatArray, curve: CurveObservations) -> FloatArray:
    """Residuals (M,) of the offsets across the curve."""
    intrinsics, pose = survey.camera(theta)
    points = survey.shape(theta).points(curve.t)
    return np.asarray(np.sum((curve.measured - project(intrinsics, pose, points)[0]) * curve.normal, axis=1))


def curve_terms(survey: Survey, theta: FloatArray, curve: CurveObservations) -> tuple[FloatArray, FloatArray]:
    """Residuals (M,) of the offsets across the curve, and the curve's derivatives there by θ (M, 28)."""
    intrinsics, pose = survey.camera(theta)
    shape = survey.shape(theta)
    own = (shape.near, shape.far, float(theta[SAG]), float(theta[SWING]))
    points, by_shape = conductor_derivatives(*own, curve.t, shape.load)
    residual = np.sum((curve.measured - project(intrinsics, pose, points)[0]) * curve.normal, axis=1)
    by_point, by_camera = projection_derivatives(intrinsics, pose, points)
    across = np.einsum("mi,mij->mj", curve.normal, by_point)
    jacobian = np.zeros((len(curve.t), SIZE))
    jacobian[:, CAMERA] = np.einsum("mi,mik->mk", curve.normal, by_camera)
    jacobian[:, SHAPE] = np.einsum("mj,mjk->mk", across, by_shape)
    down = across @ gravity_direction(own[0], own[1], own[3])
    jacobian[:, LOAD] = own[2] * down[:, None] * curve.load_shapes.T
    return residual, jacobian


def curve_uncertainty(survey: Survey, solution: Solution, curve: CurveObservations) -> FloatArray:
    """Standard uncertainty (M,) of the solved curve across itself, px; the offsets and their own do not matter."""
    _, jacobian = curve_terms(survey, solution.theta, curve)
    return np.asarray(np.sqrt(np.maximum(np.einsum("mi,ij,mj->m", jacobian, solution.covariance, jacobian), 0.0)))


def correlated_error(arc: FloatArray, sigma: FloatArray) -> FloatArray:
    """Covariance (M, M) of what offsets at ``arc`` (M,) along a curve share, px²; ``sigma`` (M,) is their own."""
    distance = np.abs(arc[:, None] - arc[None, :])
    shared = np.hypot(CORRELATED_PX, CORRELATED_SHARE * sigma)
    return np.asarray(shared[:, None] * shared * np.exp(-distance / CORRELATION_LENGTH_PX))


def _robust(z2: FloatArray, limit: float) -> FloatArray:
    """Cauchy weights of squared standardised residuals."""
    return np.asarray(1.0 / (1.0 + z2 / limit**2))


def _scaled_solve(matrix: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solution of a normal equation whose unknowns have very different sizes, and the inverse of its matrix."""
    scale = 1 / np.sqrt(np.diag(matrix))
    both = scale[:, None] * scale
    scaled = matrix * both
    scaled[np.diag_indices_from(scaled)] += 1e-9
    inverse = np.linalg.inv(scaled)
    return np.asarray(scale * (inverse @ (scale * vector))), np.asarray(inverse * both)


def _length(step: FloatArray, covariance: FloatArray) -> float:
    """Greatest part of a step (n,), in standard uncertainties of a covariance (n, n)."""
    return float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))


def solve(
    survey: Survey, start: FloatArray, camera: CameraKnowledge, curve: CurveObservations, iterations: int = 10
) -> Solution:
    """Maximum a posteriori θ from what is known of the camera and from curve offsets.

    A curve keeps its measured pixels while θ moves; call again with offsets measured about the new curve until
    nothing changes.
    """
    free = survey.unknowns()
    sigma0, mean0 = survey.prior_sigma(), survey.prior_mean()
    known = np.diag(1 / sigma0**2)
    known[CAMERA, CAMERA] += camera.precision
    target = mean0 / sigma0**2
    target[CAMERA] += camera.vector
    known_free, target_free = known[np.ix_(free, free)], target[free]
    # a step farther than the prior allows is a sign of a wrong wire or a wrong survey: walk, don't jump. What hangs in
    # a plane through the camera shows hardly any sag, and its picture stays linear over short steps only
    longest = 3 * sigma0[free]
    longest[SAG] = STRIDE[0] * (survey.sag_range[1] - survey.sag_range[0])
    longest[SWING] = min(longest[SWING], STRIDE[1])
    white, correlated = curve.sigma**2, correlated_error(curve.arc, curve.sigma)
    diagonal = np.diag_indices_from(correlated)
    shared = correlated[diagonal]
    expected = white + shared
    theta, converged, inflation = start.copy(), False, 1.0
    residual, jacobian = curve_terms(survey, theta, curve)
    for step_number in range(iterations):
        spread = max(1.4826 * median(np.abs(residual)), 1e-3) if step_number < 2 else 0.0
        weight = _robust(residual**2 / (expected + spread**2), CAUCHY_CURVE)
        noise = white / np.maximum(weight, 1e-6)
        inflation = _inflation(residual, noise + shared, weight)
        own = jacobian[:, free]
        together = correlated.copy()
        together[diagonal] += noise
        gain = np.linalg.solve(together, np.column_stack([own, residual])).T @ own / inflation
        step, posterior = _scaled_solve(known_free + gain[:-1], target_free - known_free @ theta[free] + gain[-1])
        theta[free] += step / max(1.0, float(np.max(np.abs(step) / longest)))
        theta[SAG] = min(max(theta[SAG], 0.2 * survey.sag_range[0]), 2 * survey.sag_range[1])
        theta[SWING] = min(max(theta[SWING], -1.4), 1.4)
        length = _length(step, posterior)
        if length > ANEW:
            residual, jacobian = curve_terms(survey, theta, curve)
        else:
            residual = curve_residual(survey, theta, curve)
        if step_number >= 2 and length < SETTLED:
            converged = True
            break
    covariance = np.zeros((SIZE, SIZE))
    covariance[np.ix_(free, free)] = 0.5 * (posterior + posterior.T)
    return Solution(
        theta=theta,
        covariance=covariance,
        residual=residual,
        weight=weight,
        inflation=inflation,
        misfit=_misfit(residual, noise, correlated, theta, known, target),
        converged=converged,
        jacobian=jacobian,
        noise=(noise, correlated),
        camera=camera,
    )


def _misfit(
    residual: FloatArray,
    noise: FloatArray,
    correlated: FloatArray,
    theta: FloatArray,
    known: FloatArray,
    target: FloatArray,
) -> float:
    """Residuals over their covariance, and the corrections to what was known before over theirs (up to a constant)."""
    of_curve = residual @ np.linalg.solve(np.diag(noise) + correlated, residual)
    return float(of_curve + theta @ known @ theta - 2 * target @ theta)


def _inflation(residual: FloatArray, variance: FloatArray, weight: FloatArray) -> float:
    """By how much the offsets scatter more than their covariance says: the Birge ratio squared, at least 1."""
    effective = max(float(weight.sum()) - 4.0, 1.0)
    chi2 = float(np.sum(weight * residual**2 / np.maximum(variance, 1e-12)))
    return max(1.0, chi2 / effective)
