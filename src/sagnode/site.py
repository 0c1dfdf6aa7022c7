"""A site: the survey, the lens and the reference picture, made ready for measuring.

This is the one place where the configuration's models become the arrays and frozen dataclasses of the mathematics.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from sagnode.calibrate.files import load_intrinsics
from sagnode.capture.images import read_grey
from sagnode.config.node import Measure, Method
from sagnode.config.span import Conductor, Ground, Limits, Span
from sagnode.errors import ConfigError, FrameError
from sagnode.geometry.bundle import sub_conductor_offsets
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, rotation_from_angles
from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import Stringing
from sagnode.match.lens import Cells, cells
from sagnode.match.patches import Patch, cut_patch
from sagnode.survey import Survey


@dataclass(frozen=True)
class SiteConductor:
    """One conductor of the span with everything that measuring it needs; angles rad, lengths m."""

    id: str
    phase: str | None
    survey: Survey
    width: float
    """Diameter of one wire."""
    members: FloatArray
    """Sub-conductors of a bundle about its centre line (m, 3); one row of zeros for a single wire."""
    swing_max: float
    unit_weight_n_m: float | None
    stringing: Stringing | None
    measured: bool


@dataclass(frozen=True)
class Site:
    """Everything about a span that does not change from frame to frame."""

    conductors: tuple[SiteConductor, ...]
    ground: GroundProfile
    intrinsics: Intrinsics
    pose: Pose
    landmark_ids: tuple[str, ...]
    landmark_positions: FloatArray
    landmark_position_u: FloatArray
    landmark_clicks: FloatArray
    landmark_click_u: FloatArray
    patches: tuple[Patch | None, ...] | None
    """Landmarks in the reference picture; None where the survey has no reference picture."""
    reference_cells: Cells | None
    """Detail of the reference picture, against which the lens is looked at."""
    max_movement_px: float
    swing_questionable: float
    """rad"""
    limits: Limits
    method: Method
    calibration_id: str


def load_site(span: Span, measure: Measure | None = None, lens: Intrinsics | None = None) -> Site:
    """Read the files that a survey names and prepare it for measuring.

    Args:
        span: the survey, its paths absolute (as :func:`sagnode.config.load.load_node` gives it).
        measure: method and whether the lens distortion is undone; sagnode's own by default.
        lens: instead of the calibration file that the survey names, for one that is still to be bought.

    Raises:
        ConfigError: the calibration or the reference picture cannot be used.
    """
    measure = measure or Measure()
    camera = span.camera
    calibrated = load_intrinsics(camera.intrinsics) if lens is None else lens
    intrinsics = calibrated if measure.undistort else calibrated.without_distortion()
    pose = Pose(
        rotation_from_angles(camera.azimuth_deg, camera.elevation_deg, camera.roll_deg), np.array(camera.position)
    )
    patches = reference_cells = None
    if camera.reference_image is not None:
        try:
            reference = read_grey(camera.reference_image)
        except FrameError as error:
            raise ConfigError(f"camera.reference_image: {error.what}", error.remedy) from error
        if reference.shape != (intrinsics.height, intrinsics.width):
            raise ConfigError(
                f"camera.reference_image: {camera.reference_image} is {reference.shape[1]}x{reference.shape[0]},"
                f" but {camera.intrinsics} is for {intrinsics.width}x{intrinsics.height}",
                "take the reference picture with the calibrated camera and mode",
            )
        reference_cells = cells(reference)
        patches = tuple(cut_patch(reference, mark.pixel, mark.size_px) for mark in span.landmarks)
    return Site(
        conductors=tuple(_conductor(c, span, intrinsics, pose) for c in span.conductors),
        ground=ground_profile(span.ground),
        intrinsics=intrinsics,
        pose=pose,
        landmark_ids=tuple(mark.id for mark in span.landmarks),
        landmark_positions=np.array([mark.position for mark in span.landmarks], dtype=float).reshape(-1, 3),
        landmark_position_u=np.array([mark.position_u_m for mark in span.landmarks], dtype=float),
        landmark_clicks=np.array([mark.pixel for mark in span.landmarks], dtype=float).reshape(-1, 2),
        landmark_click_u=np.array([mark.pixel_u_px for mark in span.landmarks], dtype=float),
        patches=patches,
        reference_cells=reference_cells,
        max_movement_px=camera.max_movement_px,
        swing_questionable=float(np.radians(span.swing.questionable_deg)),
        limits=span.limits,
        method=measure.method,
        calibration_id=_calibration_id(span, calibrated),
    )


def ground_profile(ground: Ground) -> GroundProfile:
    """The ground of a survey as arrays."""
    profile = np.array(ground.profile, dtype=float)
    obstacles = np.array([[*o.along_m, o.height_m] for o in ground.obstacles], dtype=float).reshape(-1, 3)
    return GroundProfile(profile[:, 0], profile[:, 1], obstacles, ground.height_u_m)


def _conductor(conductor: Conductor, span: Span, intrinsics: Intrinsics, pose: Pose) -> SiteConductor:
    camera = span.camera
    survey = Survey(
        intrinsics=intrinsics,
        pose=pose,
        near=np.array(conductor.near, dtype=float),
        far=np.array(conductor.far, dtype=float),
        orientation_u=float(np.radians(camera.orientation_u_deg)),
        position_u=camera.position_u_m,
        focal_u_rel=camera.focal_u_rel,
        principal_point_u=camera.principal_point_u_px,
        distortion_u=camera.distortion_u,
        attachment_u=conductor.attachment_u_m,
        sag_range=(conductor.sag_min_m, conductor.sag_max_m),
        swing_u=float(np.radians(span.swing.prior_u_deg)),
    )
    stringing = None
    if conductor.stringing is not None:
        data = conductor.stringing
        stiffness = data.modulus_gpa * 1e9 * data.section_mm2 * 1e-6
        stringing = Stringing(data.temperature_c, data.tension_n, stiffness, data.expansion_per_k)
    return SiteConductor(
        id=conductor.id,
        phase=conductor.phase,
        survey=survey,
        width=conductor.diameter_m,
        members=sub_conductor_offsets(survey.near, survey.far, conductor.sub_conductors, conductor.bundle_spacing_m),
        swing_max=float(np.radians(span.swing.max_deg)),
        unit_weight_n_m=conductor.unit_weight_n_m,
        stringing=stringing,
        measured=conductor.measured,
    )


def _calibration_id(span: Span, intrinsics: Intrinsics) -> str:
    """Short hash of everything that says where the camera is and how its lens draws."""
    marks = [mark.model_dump_json() for mark in span.landmarks]
    camera = span.camera.model_dump_json(exclude={"intrinsics", "reference_image"})
    return hashlib.sha256(repr((intrinsics, camera, marks)).encode()).hexdigest()[:12]
