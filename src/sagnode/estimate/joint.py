r"""The joint estimate: camera, attachments, sag, swing and load at once, maximum a posteriori.

The unknowns θ are those of :mod:`sagnode.survey`, whose standard uncertainties are the prior P. Observations are
tracked landmarks and offsets of the wire across the predicted curve, px. With J their derivatives by θ and C their
covariances, Gauss-Newton steps, shortened where they go farther than the prior allows, minimise
``Σ rᵀC⁻¹r + (θ-θ₀)ᵀP⁻¹(θ-θ₀)``; the posterior covariance is ``(Σ JᵀC⁻¹J + P⁻¹)⁻¹``. What does not settle says so. A
step that leads nowhere, to where an offset has no finite residual, is not taken, and no other after it.

What landmarks say (:mod:`sagnode.estimate.camera`) comes as a quadratic form that is added to each conductor's prior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType

import numpy as np

from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.offsets import (
    CORRELATION_LENGTH_PX,
    CurveObservations,
    aside_by_sliding,
    correlated_error,
    curve_residual,
    curve_terms,
    finer_load_error,
    slid,
    words,
)
from sagnode.estimate.steps import SETTLED, robust_weights, solve_scaled, solved, step_length
from sagnode.estimate.whitened import whitened_products
from sagnode.geometry.camera import FloatArray
from sagnode.match.robust import median
from sagnode.native import kernels
from sagnode.survey import CAMERA, LOAD, SAG, SIZE, SWING, Survey

CAUCHY_CURVE = 2.5
"""Standardised residual at which an offset counts half."""
SLID, SLIDES_MOST = 0.2, 4
"""Share of an offset's uncertainty by which it may be off for having slid along the curve, and most solutions anew."""
STILL = 0.5
"""Standard uncertainties of sag and swing within which a solution is where it began."""
ANEW = 0.5
"""A step of more than this many standard uncertainties makes the derivatives be taken anew."""
BENT = 0.02
"""So does a :func:`bend` of more than this, however many steps it took."""
STRIDE = (0.1, np.radians(2.0))
"""Longest steps: of sag, as a share of its surveyed range, and of swing."""
SWING_MAX = 1.4
"""Farthest swing that an estimate goes to, rad."""
_SETTINGS = (CORRELATION_LENGTH_PX, CAUCHY_CURVE, SETTLED, ANEW, BENT)
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
EVERY = slice(0, SIZE)


@dataclass(frozen=True)
class Solution:
    """A maximum a posteriori estimate.

    Attributes:
        theta: estimate (28,).
        covariance: posterior (28, 28); zero where nothing is unknown; the prior's where no step could be taken.
        residual: curve residuals, px (M,).
        weight: robust weights (M,) in [0, 1].
        inflation: factor by which the curve's variance exceeded what was expected (at least 1).
        misfit: what was minimised, at its end: residuals and corrections to the prior, each over its variance;
            infinite where a step led nowhere.
        converged: the last step was smaller than a hundredth of a standard uncertainty.
        jacobian: derivatives of the residuals (M, 28).
        white: variance of the offsets by themselves as weighted, px² (M,).
        curve: the offsets.
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
    white: FloatArray
    curve: CurveObservations
    camera: CameraKnowledge
    shared: FloatArray | None = None
    """Covariance (M, M) of what the offsets share, px², where an uneven load adds to what neighbours do."""
    log_evidence: float | None = None
    """Of the offsets for all loads together that this is the mean of; None for a single solution."""
    loads: tuple[tuple[float, Survey, Solution], ...] = ()
    """Those of the loads that matter, the likeliest first: the weight of each, what it expects, and the solution."""

    @cached_property
    def noise(self) -> tuple[FloatArray, FloatArray]:
        """White (M,) and correlated (M, M) variances of the offsets as weighted, px²."""
        shared = correlated_error(self.curve) if self.shared is None else self.shared
        return self.white, shared

    @cached_property
    def _markov(self) -> tuple[FloatArray, float] | None:
        """What the next two are, where the offsets share errors with their neighbours alone."""
        if self.shared is not None or not self.curve.in_order:
            return None
        sizes = np.array([[self.curve.shared_px, self.curve.shared_share]])
        inverse, spread = whitened_products(self.curve, self.white, np.eye(len(self.white)), sizes)
        return inverse[0], float(spread[0])

    @cached_property
    def precision(self) -> FloatArray:
        """Inverse (M, M) of the covariance of the offsets as weighted, px⁻²."""
        if self._markov is not None:
            return self._markov[0]
        white, correlated = self.noise
        return solved(np.diag(white) + correlated, np.eye(len(white)))

    @cached_property
    def spread(self) -> float:
        """Logarithm of the determinant of that covariance."""
        if self._markov is not None:
            return self._markov[1]
        white, correlated = self.noise
        return float(np.linalg.slogdet(np.diag(white) + correlated)[1])

    @cached_property
    def products(self) -> FloatArray:
        """Products (29, 29) of the residuals' derivatives and, last, the residuals, weighed by that inverse."""
        rows = np.column_stack([self.jacobian, self.residual])
        return np.asarray(rows.T @ (self.precision @ rows))

    def information(self, survey: Survey, of: slice = EVERY) -> dict[str, FloatArray]:
        """The printed budget: the covariance split by source, Σ (P⁻¹ + Σ JᵀC⁻¹J) Σ term by term, each (28, 28).

        What offsets that are no wire's may do to the estimate comes on top of the covariance. ``of``: of these unknowns
        alone, where no others are asked for.
        """
        if self.loads:
            _, own, one = self.loads[0]
            return {**one.information(own, of), "which load": (self.covariance - one.covariance)[of, of]}
        posterior, known = self.covariance[of], survey.prior_information()
        pieces: dict[str, FloatArray] = {}
        for name, part in SOURCES.items():
            pieces[name] = posterior[:, part] @ known[part, part] @ posterior[:, part].T
        pieces["landmarks"] = posterior[:, CAMERA] @ self.camera.precision @ posterior[:, CAMERA].T
        white, correlated = self.noise
        gain = posterior @ (self.precision @ self.jacobian).T / self.inflation
        pieces["pixel noise"] = (gain * (white * self.inflation)) @ gain.T
        if self.curve.shading is not None:
            lit = gain @ self.curve.shading
            pieces["light on one side"] = self.inflation * (lit @ lit.T)
            correlated = correlated - self.curve.shading @ self.curve.shading.T
        pieces["correlated curve error"] = gain @ (correlated * self.inflation) @ gain.T
        if self.curve.texture is not None:
            pieces["texture taken for wire"] = (gain * self.curve.texture**2) @ gain.T
        return pieces


def curve_uncertainty(
    survey: Survey, theta: FloatArray, covariance: FloatArray, curve: CurveObservations
) -> FloatArray:
    """Standard uncertainty (M,) of a curve across itself, px, by the covariance (28, 28) of θ (28,).

    The offsets and their own uncertainty do not matter.
    """
    _, jacobian = curve_terms(survey, theta, curve)
    return np.asarray(np.sqrt(np.maximum(np.einsum("mi,ij,mj->m", jacobian, covariance, jacobian), 0.0)))


def solve(
    survey: Survey, start: FloatArray, camera: CameraKnowledge, curve: CurveObservations, iterations: int = 10
) -> Solution:
    """Maximum a posteriori θ from what is known of the camera and from curve offsets.

    A curve keeps its measured pixels while θ moves; call again with offsets measured about the new curve until
    nothing changes.
    """
    free = survey.unknowns()
    sigma0 = survey.prior_sigma()
    known = survey.prior_information()
    target = known @ survey.prior_mean()
    known[CAMERA, CAMERA] += camera.precision
    target[CAMERA] += camera.vector
    # a step farther than the prior allows is a sign of a wrong wire or a wrong survey: walk, don't jump. What hangs in
    # a plane through the camera shows hardly any sag, and its picture stays linear over short steps only
    longest = 3 * sigma0[free]
    longest[SAG] = STRIDE[0] * (survey.sag_range[1] - survey.sag_range[0])
    longest[SWING] = min(longest[SWING], STRIDE[1])
    question = _Question(survey, start, camera, curve, known, target, longest, iterations)
    # what finer terms of a load share reaches over the whole curve, and is no Markov process
    markov = curve.in_order and not survey.load_u > 0
    return _solve_compiled(kernels, question) if kernels is not None and markov else _solve(question)


def solve_on_curve(
    survey: Survey, start: FloatArray, camera: CameraKnowledge, curve: CurveObservations, iterations: int = 10
) -> Solution:
    """:func:`solve`, and again with every offset at the place of the solved curve that it is nearest to.

    Where the picture leaves one combination of sag and swing open, a solution goes far along it, and the wire slides
    along its own picture meanwhile.
    """
    solution, before = solve(survey, start, camera, curve, iterations), start
    for _ in range(SLIDES_MOST):
        theta = solution.theta
        # what slides is of second order, and nothing where the solution hardly moved
        if not solution.converged or _near(theta, before, solution.covariance):
            break
        aside = aside_by_sliding(survey, theta, solution.curve)
        if not (aside > SLID * np.sqrt(solution.white + solution.curve.shared_px**2)).any():
            break
        again = solve(survey, theta, camera, slid(survey, theta, solution.curve), iterations)
        if not again.converged:
            break
        solution, before = again, theta
    return solution


def _near(theta: FloatArray, before: FloatArray, covariance: FloatArray) -> bool:
    """Whether sag and swing have moved by less than a part of their standard uncertainties."""
    return all((theta[k] - before[k]) ** 2 <= STILL**2 * covariance[k, k] for k in (SAG, SWING))


@dataclass(frozen=True)
class _Question:
    """What is to be solved: the arguments of :func:`solve`, the prior, and the longest steps."""

    survey: Survey
    start: FloatArray
    camera: CameraKnowledge
    curve: CurveObservations
    known: FloatArray
    """What is known before looking at the curve: inverse covariance (28, 28),"""
    target: FloatArray
    """and that times θ where it would be alone (28,)."""
    longest: FloatArray
    iterations: int

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least and greatest sag and swing."""
        low, high = self.survey.sag_range
        return 0.2 * low, 2 * high, -SWING_MAX, SWING_MAX


def _solve_compiled(compiled: ModuleType, asked: _Question) -> Solution:
    """:func:`_solve`, where the offsets follow each other along the curve."""
    curve, theta = asked.curve, asked.start.astype(np.float64)
    shading = np.empty((len(curve.t), 0)) if curve.shading is None else curve.shading
    along = (np.ascontiguousarray(part, dtype=np.float64) for part in (curve.arc, curve.sigma, shading))
    own = (*words(asked.survey, theta, curve), len(asked.longest), *along)
    settings = np.array([curve.shared_px, curve.shared_share, *_SETTINGS, *asked.bounds])
    own = (*own, asked.known, asked.target, asked.longest, settings, asked.iterations)
    covariance, jacobian = np.empty((SIZE, SIZE)), np.empty((len(curve.t), SIZE))
    residual, weight, noise = np.empty((3, len(curve.t)))
    inflation, misfit, converged = compiled.solve(*own, covariance, residual, weight, noise, jacobian)
    return Solution(
        theta=theta,
        covariance=covariance,
        residual=residual,
        weight=weight,
        inflation=inflation,
        misfit=misfit,
        converged=bool(converged),
        jacobian=jacobian,
        white=noise,
        curve=curve,
        camera=asked.camera,
    )


def _solve(asked: _Question) -> Solution:
    survey, curve, known, target = asked.survey, asked.curve, asked.known, asked.target
    free = survey.unknowns()
    known_free, target_free = known[np.ix_(free, free)], target[free]
    sag_low, sag_high, swing_low, swing_high = asked.bounds
    white, correlated = curve.sigma**2, correlated_error(curve)
    if survey.load_u > 0:
        correlated += finer_load_error(survey, asked.start, curve)
    diagonal = np.diag_indices_from(correlated)
    shared = correlated[diagonal]
    theta, converged, nowhere, inflation = asked.start.copy(), False, False, 1.0
    posterior = solve_scaled(known_free, target_free)[1]
    residual, jacobian = curve_terms(survey, theta, curve)
    taken = theta.copy()
    for step_number in range(asked.iterations):
        weight, noise, inflation = _weighted(residual, white, shared, begun=step_number >= 2)
        own = jacobian[:, free]
        together = correlated.copy()
        together[diagonal] += noise
        gain = solved(together, np.column_stack([own, residual])).T @ own / inflation
        step, after = solve_scaled(known_free + gain[:-1], target_free - known_free @ theta[free] + gain[-1])
        before = theta.copy()
        theta[free] += step / max(1.0, float(np.max(np.abs(step) / asked.longest)))
        theta[SAG] = min(max(theta[SAG], sag_low), sag_high)
        theta[SWING] = min(max(theta[SWING], swing_low), swing_high)
        length, bent = step_length(step, after), bend(theta, taken, after)
        if length > ANEW or bent > BENT:
            residual, jacobian = curve_terms(survey, theta, curve)
            taken = theta.copy()
        else:
            residual = curve_residual(survey, theta, curve)
        if not (np.isfinite(length) and np.isfinite(residual).all()):
            theta, nowhere = before, True
            residual, jacobian = curve_terms(survey, theta, curve)
            break
        posterior = after
        if step_number >= 2 and length < SETTLED and bent <= BENT:
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
        misfit=math.inf if nowhere else _misfit(residual, noise, correlated, theta, known, target),
        converged=converged,
        jacobian=jacobian,
        white=noise,
        curve=curve,
        camera=asked.camera,
        shared=correlated if survey.load_u > 0 else None,
    )


def bend(theta: FloatArray, taken: FloatArray, covariance: FloatArray) -> float:
    """What derivatives that were taken elsewhere do to the uncertainty of sag, as a part of it.

    Where a picture leaves swing open, sag follows it, at a rate that itself changes with both: by as much as the sag in
    its plane has turned and grown since (``taken``, (28,)). Times the uncertainty of swing that is an error of sag.
    ``covariance`` is of the unknowns, in their order.
    """
    moved = abs(theta[SAG] - taken[SAG]) + theta[SAG] * abs(theta[SWING] - taken[SWING])
    return float(moved * np.sqrt(covariance[SWING, SWING] / covariance[SAG, SAG]))


def _misfit(
    residual: FloatArray,
    noise: FloatArray,
    correlated: FloatArray,
    theta: FloatArray,
    known: FloatArray,
    target: FloatArray,
) -> float:
    """Residuals over their covariance, and the corrections to what was known before over theirs (up to a constant)."""
    of_curve = residual @ solved(np.diag(noise) + correlated, residual)
    return float(of_curve + theta @ known @ theta - 2 * target @ theta)


def _weighted(
    residual: FloatArray, white: FloatArray, shared: FloatArray, *, begun: bool
) -> tuple[FloatArray, FloatArray, float]:
    """Robust weights (M,) of offsets, their own variance so weighted, px² (M,), and the inflation of all variances.

    By the inflation the offsets scatter more than their covariance says: the Birge ratio squared, at least 1. Until
    the estimate has ``begun`` to settle, what all are off by is no reason to leave one aside.
    """
    spread = 0.0 if begun else max(1.4826 * median(np.abs(residual)), 1e-3)
    weight = robust_weights(residual**2 / (white + shared + spread**2), CAUCHY_CURVE)
    noise = white / np.maximum(weight, 1e-6)
    effective = max(float(weight.sum()) - 4.0, 1.0)
    chi2 = float(np.sum(weight * residual**2 / np.maximum(noise + shared, 1e-12)))
    return weight, noise, max(1.0, chi2 / effective)
