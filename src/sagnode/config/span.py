"""The span file: what a surveyor wrote down, each with its standard uncertainty.

Site frame: metres, right-handed, z up (local east, north, up). ``along`` is the horizontal distance from the near
attachments' tower towards the far one, measured along the span; every conductor measures it from its own A.

::

      A (near) *- - - - - - chord - - - - - - -* B (far)
      camera >   `--.__               __.--'
                        ``---___---''        } sag: chord down to conductor, vertical
      ____________________^____________________ ground profile: (along, height)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Literal

from pydantic import Field, field_validator, model_validator

from sagnode.config.base import U_MAX, Coordinate, FileName, Model, Name, Pixel, Point, PositiveM, Text
from sagnode.config.wire_data import contradictions


class Stringing(Model):
    """Stringing data for the state-change equation; gives the derived conductor temperature."""

    temperature_c: float = Field(gt=-273.15, lt=1100)
    """Conductor temperature at which ``tension_n`` was measured."""
    tension_n: float = Field(ge=1e-6, le=1e7)
    """Horizontal tension at ``temperature_c``."""
    section_mm2: float = Field(ge=1e-6)
    """Total cross-section."""
    modulus_gpa: float = Field(gt=0, le=2000)
    """Final modulus of elasticity."""
    expansion_per_k: float = Field(gt=0, lt=1e-3)
    """Coefficient of linear thermal expansion."""


class Conductor(Model):
    """One wire, or one bundle, between its two attachment points."""

    id: Name
    phase: Text | None = None
    circuit: Name | None = None
    """Conductors of one circuit carry one current and warm together; name it where the towers carry several."""
    near: Point
    """Attachment A: where the conductor leaves the clamp at the near tower."""
    far: Point
    """Attachment B, at the far tower."""
    attachment_u_m: float = Field(default=0.05, ge=0, le=U_MAX)
    """Standard uncertainty of each coordinate of both attachments."""
    diameter_m: float = Field(gt=0, lt=0.2)
    sub_conductors: Literal[1, 2, 3, 4] = 1
    """Conductors in the bundle; the bundle's centre line is reported."""
    bundle_spacing_m: float = Field(default=0.4, gt=0, le=10)
    """Side of the bundle, for two or more sub-conductors."""
    unit_weight_n_m: float | None = Field(default=None, ge=1e-6)
    """Weight per metre of one sub-conductor; gives the tension."""
    stringing: Stringing | None = None
    sag_min_m: float = Field(gt=0)
    """Smallest sag that is physically possible here; the search starts there."""
    sag_max_m: float = Field(gt=0)
    """Largest sag that is physically possible here; the search ends there."""
    measured: bool = True
    """False for earth wires and other lines' wires: known, so that they are not taken for a phase, but not reported."""

    @model_validator(mode="after")
    def _possible(self) -> Conductor:
        span = math.hypot(self.far[0] - self.near[0], self.far[1] - self.near[1])
        if span < 1e-3:
            raise ValueError("near and far lie above each other; a span needs horizontal length")
        if self.sag_max_m <= self.sag_min_m:
            raise ValueError("sag_max_m must exceed sag_min_m")
        if self.sag_max_m > 0.25 * span:
            raise ValueError(f"sag_max_m = {self.sag_max_m:g} exceeds a quarter of the span ({span:.1f} m)")
        for impossible in contradictions(self):
            raise ValueError(impossible)
        return self


class Obstacle(Model):
    """Something on the ground that counts for clearance: a road, a roof, a tree."""

    id: Name
    along_m: tuple[Coordinate, Coordinate]
    """From and to, horizontal distance from A."""
    height_m: Coordinate
    """Height of its top in the site frame."""

    @model_validator(mode="after")
    def _ordered(self) -> Obstacle:
        if self.along_m[0] > self.along_m[1]:
            raise ValueError("along_m must go from small to large")
        return self


class Ground(Model):
    """Ground profile below the span."""

    profile: tuple[tuple[Coordinate, Coordinate], ...] = Field(min_length=2)
    """(along, height) pairs, metres, along ascending; straight lines between."""
    obstacles: tuple[Obstacle, ...] = ()
    height_u_m: float = Field(default=0.05, ge=0, le=U_MAX)
    """Standard uncertainty of the heights."""

    @model_validator(mode="after")
    def _ascending(self) -> Ground:
        along = [a for a, _ in self.profile]
        if any(b <= a for a, b in itertools.pairwise(along)):
            raise ValueError("profile: the first number of each pair must ascend")
        return self


class CameraSurvey(Model):
    """The camera as surveyed."""

    position: Point
    """Centre of projection."""
    position_u_m: float = Field(default=0.05, ge=0, le=U_MAX)
    azimuth_deg: float = Field(ge=-360, le=360)
    """Direction of the optical axis, clockwise from the site's north (+y), as a compass shows it."""
    elevation_deg: float = Field(gt=-90, lt=90)
    """Optical axis above (+) or below (-) the horizon."""
    roll_deg: float = Field(default=0.0, ge=-180, le=180)
    """Rotation about the optical axis, clockwise seen from behind the camera."""
    orientation_u_deg: float = Field(default=0.5, gt=0, le=180)
    """Standard uncertainty of each of the three angles."""
    intrinsics: FileName
    """Calibration file: OpenCV YAML, XML or JSON, or ROS camera_info YAML; relative to this file."""
    focal_u_rel: float = Field(default=0.001, ge=0, le=1)
    """Relative standard uncertainty of the focal lengths."""
    principal_point_u_px: float = Field(default=1.0, ge=0, le=1e5)
    distortion_u: float = Field(default=0.002, ge=0, le=10)
    """Standard uncertainty of k1."""
    reference_image: FileName | None = None
    """Picture in which the landmarks were clicked; with it they are tracked in every frame."""
    max_movement_px: float = Field(default=60.0, gt=0, le=1e5)
    """Landmarks farther than this from where they were clicked: the camera is knocked, and readings are refused."""


class Landmark(Model):
    """A fixed point that the camera sees: tower, insulator hook, roof corner."""

    id: Name
    position: Point
    position_u_m: float = Field(default=0.05, ge=0, le=U_MAX)
    pixel: Pixel
    """Where it was clicked in the reference image."""
    pixel_u_px: float = Field(default=0.3, gt=0, le=1e5)
    size_px: int = Field(default=33, ge=9, le=255)
    """Side of the square around it that is compared."""


class Swing(Model):
    """What is known about wind before looking."""

    max_deg: float = Field(default=30.0, ge=0, le=75)
    """Largest swing that is searched."""
    prior_u_deg: float = Field(default=10.0, gt=0, le=1000)
    """Standard uncertainty of the prior, centred at zero; it matters where the view cannot see swing."""
    questionable_deg: float = Field(default=20.0, gt=0)
    """Swing above this marks the reading as oscillatory."""


class Limits(Model):
    """The utility's own limits; nothing here has a built-in value."""

    clearance_min_m: float | None = None
    sag_max_m: float | None = None
    clearance_u_max_m: float | None = Field(default=None, gt=0)
    """Readings less certain than this are questionable (inaccurate)."""
    sag_u_max_m: float | None = Field(default=None, gt=0)


class Span(Model):
    """One span as surveyed."""

    name: Name
    conductors: tuple[Conductor, ...] = Field(min_length=1)
    ground: Ground
    camera: CameraSurvey
    landmarks: tuple[Landmark, ...] = ()
    swing: Swing = Swing()
    limits: Limits = Limits()

    @field_validator("conductors")
    @classmethod
    def _one_is_measured(cls, conductors: tuple[Conductor, ...]) -> tuple[Conductor, ...]:
        if not any(c.measured for c in conductors):
            raise ValueError("none has measured = true, so there would be nothing to report")
        return conductors

    @model_validator(mode="after")
    def _consistent(self) -> Span:
        for where, message in inconsistencies(self.conductors, self.landmarks, self.ground.obstacles, self.camera):
            raise ValueError(f"{where}: {message}")
        return self


def inconsistencies(
    conductors: Sequence[Conductor],
    landmarks: Sequence[Landmark],
    obstacles: Sequence[Obstacle],
    camera: CameraSurvey | None,
) -> Iterator[tuple[str, str]]:
    """Contradictions between tables that are each right by themselves: (table, sentence) pairs.

    Takes the tables singly, so that they are found while other tables of the file still hold faults.
    """
    named = {
        "conductors": [c.id for c in conductors],
        "landmarks": [m.id for m in landmarks],
        "ground.obstacles": [o.id for o in obstacles],
    }
    for what, ids in named.items():
        twice = sorted({i for i in ids if ids.count(i) > 1})
        if twice:
            yield what, f"id used twice: {', '.join(twice)}; give each its own"
    if camera is None:
        return
    for conductor in conductors:
        distance = _distance_to_chord(camera.position, conductor.near, conductor.far)
        if conductor.measured and distance < 0.02:
            text = (
                f"position stands on the chord of conductor {conductor.id} ({distance:.3f} m off), from where its sag"
            )
            yield "camera", f"{text} cannot be seen; check position, near and far"


def _distance_to_chord(p: Point, a: Point, b: Point) -> PositiveM:
    """Distance of a point from the straight line through the attachments, metres."""
    ab = [b[i] - a[i] for i in range(3)]
    ap = [p[i] - a[i] for i in range(3)]
    t = sum(x * y for x, y in zip(ab, ap, strict=True)) / sum(x * x for x in ab)
    return math.dist(ap, [t * x for x in ab])
