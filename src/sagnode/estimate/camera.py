"""The camera in one frame, as its landmarks and the survey show it.

Landmarks know nothing but the camera, and all conductors of a frame share them: :func:`solve_camera` is asked once a
frame, and hands on what the landmarks say as a quadratic form that :func:`sagnode.estimate.joint.solve` adds to the
prior of each conductor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sagnode.estimate.steps import SETTLED, robust_weights, solve_scaled, step_length
from sagnode.geometry.camera import FloatArray, project, projection_derivatives
from sagnode.native import kernels
from sagnode.survey import CAMERA, Survey

CAUCHY_LANDMARK = 3.5
"""Standardised residual at which a landmark counts half."""
_SETTINGS = np.array([CAUCHY_LANDMARK, SETTLED])


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


def solve_camera(survey: Survey, landmarks: LandmarkObservations, iterations: int = 10) -> CameraSolution:
    """The camera's pose and lens from landmarks, with the survey as the prior; ten unknowns."""
    sigma0 = survey.prior_sigma()[CAMERA]
    theta = survey.prior_mean()
    if kernels is not None:
        seen = (landmarks.positions, landmarks.position_u, landmarks.pixels, landmarks.pixel_u)
        own = (*(np.ascontiguousarray(part, dtype=np.float64) for part in seen), _SETTINGS, iterations)
        said = CameraKnowledge(np.empty((10, 10)), np.empty(10))
        residual, weight = np.empty((landmarks.count, 2)), np.empty(landmarks.count)
        found = (said.precision, said.vector, residual, weight)
        z = kernels.solve_camera(*survey.packed, theta, sigma0, *own, *found)
        return CameraSolution(theta, said, residual, weight, z)
    prior = np.diag(1 / sigma0**2)
    weight = np.ones(landmarks.count)
    for step_number in range(iterations):
        residual, jacobian, inverse = _landmark_terms(survey, theta, landmarks)
        squared = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        weight = robust_weights(squared, CAUCHY_LANDMARK)
        weighted = np.einsum("nik,nij->nkj", jacobian, inverse * weight[:, None, None])
        precision = np.einsum("nkj,njl->kl", weighted, jacobian)
        pull = np.einsum("nkj,nj->k", weighted, residual)
        step, posterior = solve_scaled(precision + prior, pull - theta[CAMERA] / sigma0**2)
        if step_number >= 2 and step_length(step, posterior) < SETTLED:
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
