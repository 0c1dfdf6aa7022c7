"""What offsets of a wire across a predicted curve say: residuals, their derivatives by θ, and the error they share.

The unknowns θ (28,) are those of :mod:`sagnode.survey`; the frame is the site's, offsets are px.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray, place_derivatives, project, projection_derivatives
from sagnode.geometry.conductor import conductor_derivatives, finer_load_shapes, gravity_direction, load_shapes
from sagnode.native import kernels
from sagnode.survey import CAMERA, LOAD, SAG, SIZE, SWING, Survey

CORRELATED_PX = 0.03
"""Least standard deviation of what neighbouring offsets share: residuals of the lens model, the wire's own shading."""
CORRELATED_SHARE = 0.7
"""The same, relative to an offset's own: what makes a block uncertain, texture behind it, reaches over to the next."""
CORRELATION_LENGTH_PX = 60.0
FINER_STEPS = 2000
"""Steps along the span at which their shapes are kept (they bend little between two)."""
NEARBY = 1e-4
"""Step along the span by which a curve's direction in the picture is told."""
SLIDES, SLIDE_MAX, ENDS = 3, 0.05, 1e-3
"""Steps by which offsets slide along a curve to where they are nearest to it, the longest of them, and how near to an
attachment, all as shares of the span."""
SHAPE = slice(10, 18)
"""Attachments, sag and swing among the unknowns."""
FINEST_LOAD = 40
"""Last term of an uneven load that is reckoned with: those beyond the solved ones are an error that the offsets share.
A weight's kink needs them; beyond this one they move a wire by less than a millimetre."""


@dataclass(frozen=True)
class CurveObservations:
    """Offsets of the wire across the curve at some parameters.

    Attributes:
        t: curve parameters (M,).
        arc: position along the curve, px (M,).
        normal: unit normals (M, 2).
        measured: pixels (M, 2) on the wire: curve plus offset along the normal.
        sigma: white standard uncertainty of the offsets, px (M,).
        texture: standard deviation of what the chance that an offset is no wire's adds to the estimate's uncertainty,
            though it does not weigh in the estimate, px (M,); None where there is none beyond ``sigma``.
        shared_px: least standard deviation of what neighbours share, px.
        shared_share: the same, relative to an offset's own.
        shading: what light from the picture's right, and light from below, moves each offset by if it is one standard
            deviation stronger, px (M, 2); None where the wire's own light cannot move them.
    """

    t: FloatArray
    arc: FloatArray
    normal: FloatArray
    measured: FloatArray
    sigma: FloatArray
    texture: FloatArray | None = None
    shared_px: float = CORRELATED_PX
    shared_share: float = CORRELATED_SHARE
    shading: FloatArray | None = None

    def some(self, kept: NDArray[np.bool_] | NDArray[np.intp]) -> CurveObservations:
        """Those of the offsets (M,) that are kept."""
        texture, shading = (None if part is None else part[kept] for part in (self.texture, self.shading))
        t, arc, normal, measured, sigma = (
            part[kept] for part in (self.t, self.arc, self.normal, self.measured, self.sigma)
        )
        return CurveObservations(t, arc, normal, measured, sigma, texture, self.shared_px, self.shared_share, shading)

    @cached_property
    def load_shapes(self) -> FloatArray:
        """What the terms of an uneven load add to the depth there, over the sag (10, M)."""
        return load_shapes(self.t, LOAD.stop - LOAD.start)

    @cached_property
    def in_order(self) -> bool:
        """Whether the offsets follow each other along the curve."""
        return bool((self.arc[1:] >= self.arc[:-1]).all())

    @cached_property
    def finer_load_shapes(self) -> FloatArray:
        """The same of the terms that are too fine to be solved for (30, M), interpolated to within 1e-6."""
        table = _finer_load_table()
        place = np.clip(self.t, 0.0, 1.0) * FINER_STEPS
        before = np.minimum(place.astype(np.intp), FINER_STEPS - 1)
        share = place - before
        return np.asarray(table[:, before] * (1 - share) + table[:, before + 1] * share)


@cache
def _finer_load_table() -> FloatArray:
    """Shapes of the finer terms at equal steps along the span (30, FINER_STEPS + 1)."""
    return finer_load_shapes(np.linspace(0.0, 1.0, FINER_STEPS + 1), LOAD.stop - LOAD.start + 1, FINEST_LOAD)


def curve_residual(survey: Survey, theta: FloatArray, curve: CurveObservations) -> FloatArray:
    """Residuals (M,) of the offsets across the curve."""
    intrinsics, pose = survey.camera(theta)
    points = survey.shape(theta).points(curve.t)
    return np.asarray(np.sum((curve.measured - project(intrinsics, pose, points)[0]) * curve.normal, axis=1))


def curve_terms(survey: Survey, theta: FloatArray, curve: CurveObservations) -> tuple[FloatArray, FloatArray]:
    """Residuals (M,) of the offsets across the curve, and the curve's derivatives there by θ (M, 28)."""
    if kernels is not None:
        residual, jacobian = np.empty(len(curve.t)), np.empty((len(curve.t), SIZE))
        kernels.curve_terms(*words(survey, theta, curve), len(survey.unknowns()), residual, jacobian)
        return residual, jacobian
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


def correlated_error(curve: CurveObservations) -> FloatArray:
    """Covariance (M, M) of what offsets share, px²."""
    distance = np.abs(curve.arc[:, None] - curve.arc[None, :])
    shared = np.hypot(curve.shared_px, curve.shared_share * curve.sigma)
    result = shared[:, None] * shared * np.exp(-distance / CORRELATION_LENGTH_PX)
    return np.asarray(result if curve.shading is None else result + curve.shading @ curve.shading.T)


def finer_load_error(survey: Survey, theta: FloatArray, curve: CurveObservations) -> FloatArray:
    """Covariance (M, M), px², of the offsets by the terms of an uneven load that are too fine to be solved for."""
    intrinsics, pose = survey.camera(theta)
    shape = survey.shape(theta)
    by_point = place_derivatives(intrinsics, pose, shape.points(curve.t))
    down = np.einsum(
        "mi,mij,j->m", curve.normal, by_point, gravity_direction(shape.near, shape.far, float(theta[SWING]))
    )
    moved = float(theta[SAG]) * down * curve.finer_load_shapes
    if survey.load_prior is not None:
        return np.asarray(moved.T @ survey.load_prior.finer @ moved)
    return np.asarray(survey.load_u**2 * (moved.T @ moved))


def aside_by_sliding(survey: Survey, theta: FloatArray, curve: CurveObservations) -> FloatArray:
    """By how much residuals (M,) at θ (28,) are wrong, px, since offsets belong to other places of the curve by now.

    Offsets keep the places and the normals of the curve that they were measured about. Where the solved one runs at
    another angle, and the places have slid along it, that is no longer its distance from what was measured.
    """
    intrinsics, pose = survey.camera(theta)
    ends = survey.shape(theta).points(np.concatenate([curve.t, curve.t + NEARBY]))
    here, ahead = np.split(project(intrinsics, pose, ends)[0], 2)
    along = ahead - here
    along /= np.maximum(np.hypot(*along.T), 1e-12)[:, None]
    slip = np.sum((curve.measured - here) * along, axis=1)
    return np.asarray(np.abs(slip * np.sum(along * curve.normal, axis=1)))


def slid(survey: Survey, theta: FloatArray, curve: CurveObservations) -> CurveObservations:
    """The same offsets at the places of the curve at θ (28,) that they are nearest to, across it there."""
    intrinsics, pose = survey.camera(theta)
    shape = survey.shape(theta)

    def here_and_along(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        both = shape.points(np.concatenate([t, t + NEARBY]))
        here, ahead = np.split(project(intrinsics, pose, both)[0], 2)
        return here, (ahead - here) / NEARBY

    t = curve.t
    for _ in range(SLIDES):
        here, along = here_and_along(t)
        step = np.sum((curve.measured - here) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-9)
        t = np.clip(t + np.clip(np.nan_to_num(step), -SLIDE_MAX, SLIDE_MAX), ENDS, 1 - ENDS)
    _, along = here_and_along(t)
    along /= np.maximum(np.hypot(*along.T), 1e-12)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    normal *= np.where(np.sum(normal * curve.normal, axis=1) < 0, -1.0, 1.0)[:, None]
    there = np.asarray(np.isfinite(normal).all(axis=1))
    return replace(curve, t=np.where(there, t, curve.t), normal=np.where(there[:, None], normal, curve.normal))


def words(survey: Survey, theta: FloatArray, curve: CurveObservations) -> tuple[Any, ...]:
    """Survey, θ and offsets, as compiled functions take them."""
    ends = (np.asarray(part, dtype=np.float64) for part in (survey.near, survey.far))
    seen = (theta, curve.t, curve.normal, curve.measured)
    return (*survey.packed, *ends, *(np.ascontiguousarray(part, dtype=np.float64) for part in seen))
