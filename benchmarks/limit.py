r"""The least-squares limit of a scene: the smallest standard uncertainty that a reader of this frame can have.

The unknowns θ and their prior P are the node's (:mod:`sagnode.survey`); the model is linearised at the truth. What is
observed is every pixel of the visible wire, at its true place, in nothing but white noise:

- A band of grey c and width w behind a Gaussian point spread s, sampled by pixels of noise σ, shifts by one pixel what
  amounts to an information of ``c²/(σ² s √π) · (1 - exp(-w²/4s²))`` for every pixel of its length: the energy of the
  band's derivative across itself. σ has the frame's read and shot noise there, and the rounding to whole greys.
- Every clicked landmark in the frame, with the survey's uncertainty of its place and of the click.

With J the derivatives of all this by θ and C its covariance, the limit of a quantity with the gradient g is
``√(gᵀ (P⁻¹ + JᵀC⁻¹J)⁻¹ g)``, for the clearance together with the survey's uncertainty of the ground. It is the
Cramér–Rao bound of a Gaussian model with a prior (van Trees). Each conductor is taken for itself; a
truly uneven load has the terms and the prior that the node gives one. Texture behind the
wire, rain and drops are not in it, nor are things that hide landmarks.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from sagnode.config.span import Conductor
from sagnode.estimate.load_kinds import LOAD_U
from sagnode.geometry.camera import FloatArray, inside, project, projection_derivatives
from sagnode.geometry.conductor import load_shapes, sag_profile
from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import Shape, quantities, quantities_of_many
from sagnode.scene.catenary import WireState, profile
from sagnode.scene.optics import exposure_and_gain, noise_level
from sagnode.scene.spec import Moment, Scene
from sagnode.scene.wires import Seen
from sagnode.site import Site, SiteConductor
from sagnode.survey import ATTACHMENTS, CAMERA, LOAD, SAG, SWING, Survey

ROUNDING = 1 / 12
"""Variance of rounding to whole grey levels."""


def limits(site: Site, scene: Scene, moment: Moment, seen: dict[str, tuple[Seen, ...]]) -> dict[str, dict[str, float]]:
    """The limit of every measured conductor's quantities, by conductor and stem.

    Args:
        site: as the node knows it.
        scene: the true world behind it.
        moment: of the frame.
        seen: how the wires came out in it.
    """
    result = {}
    for conductor in site.conductors:
        if conductor.measured and conductor.id in moment.wires:
            true = next(c for c in scene.true.conductors if c.id == conductor.id)
            result[conductor.id] = limit(site, conductor, scene, moment, true, seen.get(conductor.id, ()))
    return result


def limit(
    site: Site, conductor: SiteConductor, scene: Scene, moment: Moment, true: Conductor, seen: tuple[Seen, ...]
) -> dict[str, float]:
    """The limit of one conductor's quantities by stem, in the quantity's unit."""
    state = moment.wires[conductor.id]
    survey = replace(conductor.survey, load_u=LOAD_U) if state.loads else conductor.survey
    theta = true_theta(survey, scene, moment, true)
    free = survey.unknowns()
    information = np.diag(1 / survey.prior_sigma() ** 2)
    information[CAMERA, CAMERA] += landmark_information(site, survey, theta)
    for wire in seen:
        if wire.place.size >= 2:
            jacobian = across(survey, theta, wire.place)
            kept = np.isfinite(jacobian).all(axis=1)
            weight = information_per_pixel(wire, moment)
            information += (jacobian[kept] * weight[kept, None]).T @ jacobian[kept]
    covariance = np.linalg.inv(information[np.ix_(free, free)])
    stems, gradients = _gradients(site, conductor, survey, theta, free)
    values = quantities(survey.shape(theta), site.ground)
    shape = survey.shape(theta)
    places = {
        "clearance": values["clearance_along"],
        "midspan_clearance": float(np.hypot(*(shape.far - shape.near)[:2])) / 2,
    }
    result = {}
    for stem, gradient in zip(stems, gradients.T, strict=True):
        variance = float(gradient @ covariance @ gradient)
        if stem in places:
            variance += ground_variance(site.ground, places[stem])
        result[stem] = float(np.sqrt(variance))
    return result


def ground_variance(ground: GroundProfile, along: float) -> float:
    """Variance of the height below a place: between two points of the profile their errors average out in part."""
    for start, end, top in ground.obstacles:
        if start <= along <= end and top >= np.interp(along, ground.along, ground.height):
            return ground.height_u**2
    after = int(np.clip(np.searchsorted(ground.along, along), 1, len(ground.along) - 1))
    before, beyond = ground.along[after - 1], ground.along[after]
    share = float(np.clip((along - before) / (beyond - before), 0.0, 1.0))
    return ground.height_u**2 * ((1 - share) ** 2 + share**2)


def information_per_pixel(wire: Seen, moment: Moment) -> FloatArray:
    """Information (N,) about the place across the wire, 1/px², of each pixel of its length."""
    brightness, gain = exposure_and_gain(moment)
    noise = noise_level(moment, wire.background * brightness, gain) ** 2 + ROUNDING
    grey = wire.difference.astype(np.float64) * brightness
    psf = moment.psf_px
    edges = 1 - np.exp(-((wire.width.astype(np.float64) / (2 * psf)) ** 2))
    return np.asarray(grey**2 * edges / (noise * psf * np.sqrt(np.pi)))


def true_theta(survey: Survey, scene: Scene, moment: Moment, true: Conductor) -> FloatArray:
    """The unknowns at which the node's model is the truth (with an uneven load: as near as its terms come)."""
    theta = np.zeros_like(survey.prior_mean())
    pose, lens = scene.pose_at(moment), scene.intrinsics
    turn, _ = cv2.Rodrigues(pose.rotation @ survey.pose.rotation.T)
    theta[0:3] = turn.ravel()
    theta[3:6] = pose.position - survey.pose.position
    theta[6] = lens.fx / survey.intrinsics.fx - 1
    theta[7:9] = lens.cx - survey.intrinsics.cx, lens.cy - survey.intrinsics.cy
    if lens.distortion and survey.intrinsics.distortion:
        theta[9] = lens.distortion[0] - survey.intrinsics.distortion[0]
    near, far = np.array(true.near), np.array(true.far)
    theta[ATTACHMENTS] = np.concatenate([near - survey.near, far - survey.far])
    state = moment.wires[true.id]
    theta[SAG], theta[SWING] = state.sag_m, np.radians(state.swing_deg)
    if state.loads:
        theta[SAG], theta[LOAD] = _even_and_uneven(far - near, state)
    return theta


def _even_and_uneven(chord: FloatArray, state: WireState) -> tuple[float, FloatArray]:
    """Sag of the mean load and the terms of the uneven one that come nearest to a loaded wire."""
    s = np.linspace(0.0, 1.0, 201)
    span, rise = float(np.hypot(chord[0], chord[1])), float(chord[2])
    true, sag = profile(span, rise, state, s), state.sag_m
    shapes = np.column_stack([4 * s * (1 - s), load_shapes(s, LOAD.stop - LOAD.start).T])
    terms = np.zeros(shapes.shape[1])
    for _ in range(4):
        rest = true - sag_profile(span, rise, sag, s)
        terms = np.linalg.lstsq(shapes, rest, rcond=None)[0]
        sag += float(terms[0])
    return sag, terms[1:] / sag


def landmark_information(site: Site, survey: Survey, theta: FloatArray) -> FloatArray:
    """Information (10, 10) of the landmarks in the frame about the camera."""
    intrinsics, pose = survey.camera(theta)
    pixels, _ = project(intrinsics, pose, site.landmark_positions)
    kept = inside(intrinsics, pixels)
    by_point, by_camera = projection_derivatives(intrinsics, pose, site.landmark_positions[kept])
    covariance = np.einsum("nik,njk->nij", by_point, by_point) * (site.landmark_position_u[kept] ** 2)[:, None, None]
    covariance += np.eye(2) * (site.landmark_click_u[kept] ** 2)[:, None, None]
    return np.asarray(np.einsum("nik,nij,njl->kl", by_camera, np.linalg.inv(covariance), by_camera))


def across(survey: Survey, theta: FloatArray, place: FloatArray) -> FloatArray:
    """Derivatives (N, len θ) of the curve's place across itself at the fractions ``place`` (N,), px."""

    def pixels(at: FloatArray, t: FloatArray = place) -> FloatArray:
        return project(*survey.camera(at), survey.shape(at).points(t))[0]

    along = pixels(theta, place + 1e-5) - pixels(theta, place - 1e-5)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    jacobian = np.zeros((len(place), len(theta)))
    for k, step in zip(survey.unknowns(), _steps(survey), strict=True):
        shift = np.zeros_like(theta)
        shift[k] = step
        jacobian[:, k] = np.sum((pixels(theta + shift) - pixels(theta - shift)) * normal, axis=1) / (2 * step)
    return jacobian


def _steps(survey: Survey) -> FloatArray:
    """Steps of numerical derivatives: a thousandth of each unknown's uncertainty, at most a thousandth of its unit."""
    return np.clip(1e-3 * survey.prior_sigma()[survey.unknowns()], 1e-7, 1e-3)


def _gradients(
    site: Site, conductor: SiteConductor, survey: Survey, theta: FloatArray, free: FloatArray
) -> tuple[list[str], FloatArray]:
    """Stems, and their quantities' derivatives (len free, stems) by the unknowns."""
    steps = _steps(survey)
    around = np.concatenate([theta + np.eye(len(theta))[free] * side * steps[:, None] for side in (1, -1)])
    load = around[:, LOAD] if survey.load_u > 0 else np.empty((len(around), 0))
    shapes = Shape(
        survey.near + around[:, 10:13], survey.far + around[:, 13:16], around[:, SAG], around[:, SWING], load
    )
    values = quantities_of_many(shapes, site.ground, conductor.unit_weight_n_m)
    table = np.column_stack(list(values.values()))
    return list(values), (table[: len(free)] - table[len(free) :]) / (2 * steps[:, None])
