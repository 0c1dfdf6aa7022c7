"""What a scene is: the surveyed and the true world, what stands in it, and one moment of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from sagnode.config.span import Span
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, rotation_from_angles, turned
from sagnode.scene.catenary import WireState

Vector = tuple[float, float, float]
LandmarkKind = Literal["target", "roof", "pole", "tower", "none"]
LensState = Literal["clear", "covered", "fogged", "drops"]


@dataclass(frozen=True)
class Tree:
    """A tree or bush at a place in span coordinates (along, across to the right), metres; it stands on the ground."""

    along_m: float
    across_m: float
    height_m: float
    width_m: float
    tone: float = 60.0
    base_m: float = 0.0
    """Height of the foot above the ground (for branches before the lens)."""


@dataclass(frozen=True)
class OtherWire:
    """A wire that the survey does not know: a crossing line, a telephone wire."""

    near: Vector
    far: Vector
    sag_m: float
    diameter_m: float = 0.015


@dataclass(frozen=True)
class World:
    """What stands around the span."""

    backdrop: Literal["country", "plain", "textured"] = "country"
    """country: everything; plain: an even picture; textured: an even picture of clutter, without anything else."""
    landmark_kinds: Mapping[str, LandmarkKind] = field(default_factory=dict)
    """What is drawn at each landmark; by default a joint of a tower that it was surveyed at, else a survey target."""
    target_side_m: float | None = None
    """Side of a survey target; by default some 26 px."""
    trees: tuple[Tree, ...] = ()
    other_wires: tuple[OtherWire, ...] = ()
    towers: bool = True
    insulator_m: float = 1.3
    """Length of the insulator strings between crossarm tip and attachment."""
    forest_m: float = 19.0
    """Height of the forest at the horizon; 0 for none."""
    horizon_m: float = 430.0
    """Distance of that forest."""
    opening: float = 0.02
    """Trees that the seed grows stay clear of the line by 14 m and by this share of their distance from A."""
    wire_tone: float = 1.0
    """Brightness of all wires over that of weathered aluminium; from 2 on it is new."""
    plain_grey: float = 170.0
    """Mean grey of the backdrops ``plain`` and ``textured``."""


@dataclass(frozen=True)
class Moment:
    """Everything that changes from frame to frame."""

    wires: Mapping[str, WireState]
    """By conductor id; conductors without a state are not drawn (nor true)."""
    time: datetime = datetime(2026, 6, 21, 11, 0, tzinfo=UTC)
    turn_rad: Vector = (0.0, 0.0, 0.0)
    """Rotation vector of the camera in its own frame."""
    shift_m: Vector = (0.0, 0.0, 0.0)
    """Shift of the camera in the site frame."""
    sun_azimuth_deg: float = 180.0
    """Clockwise from the site's north."""
    sun_elevation_deg: float = 50.0
    cloud: float = 0.4
    """Cover from 0 (clear) to 1 (overcast)."""
    cloud_contrast: float = 1.0
    """How strongly clouds stand out from the sky and within themselves; 1 is a fair day."""
    cloud_drift_m: tuple[float, float] = (0.0, 0.0)
    """How far the clouds have travelled east and north."""
    fog_per_m: float = 1.5e-4
    """Extinction; 1.5e-4 is a clear day (26 km), 0.004 mist, 0.02 dense fog."""
    rain: float = 0.0
    """0 to 1."""
    glare: float = 0.0
    """Veiling glare of a sun in or near the frame, 0 to 1."""
    lens: LensState = "clear"
    psf_px: float = 0.75
    """Standard deviation of the point spread (lens, pixel and motion together)."""
    read_noise: float = 0.8
    """Grey levels at unit gain."""
    shot_noise: float = 0.09
    """Standard deviation over the square root of the signal, both in grey levels, at unit gain."""
    exposure: float | None = None
    """Brightness relative to a well exposed picture; by default what an automatic exposure reaches."""
    draw_wires: bool = True
    rounded: float = 0.0
    """How far the sun lights one side of a wire more than the other, 0 (even bands) to 1 (matt cylinders)."""
    relief: float = 0.0
    """How far faces are lit by where they look and shadows lie on things, 0 (all alike) to 1."""
    snow: float = 0.0
    """0 to 1: share of what faces upwards that is white."""
    bare: float = 0.0
    """0 in summer to 1 when leaves and crops are gone."""
    seed: int = 0
    """Of noise and rain."""


@dataclass(frozen=True)
class Scene:
    """A span as surveyed, the truth behind it, the camera and the world.

    Everything that is random about the world (clouds, fields, outlines) comes from ``seed``.
    """

    surveyed: Span
    true: Span
    """The real positions; see :func:`sagnode.scene.perturb.perturbed`."""
    intrinsics: Intrinsics
    """Of the true lens."""
    world: World = World()
    seed: int = 1

    @property
    def pose(self) -> Pose:
        """The true pose of the camera at rest."""
        return survey_pose(self.true)

    def pose_at(self, moment: Moment) -> Pose:
        """The true pose at a moment: at rest, turned and shifted by sway, drift or a knock."""
        return turned(self.pose, np.array(moment.turn_rad), np.array(moment.shift_m))


def survey_pose(span: Span) -> Pose:
    """The pose that the span file states."""
    camera = span.camera
    rotation = rotation_from_angles(camera.azimuth_deg, camera.elevation_deg, camera.roll_deg)
    return Pose(rotation, np.array(camera.position))


@dataclass(frozen=True)
class SpanFrame:
    """Horizontal axes of a span: ``along`` from the first measured conductor's A to its B, ``across`` to the right."""

    origin: FloatArray
    along: FloatArray
    across: FloatArray
    length: float

    @classmethod
    def of(cls, span: Span) -> SpanFrame:
        """The axes of a span."""
        first = next(c for c in span.conductors if c.measured)
        near, far = np.array(first.near), np.array(first.far)
        chord = far - near
        length = float(np.hypot(chord[0], chord[1]))
        along = np.array([chord[0], chord[1], 0.0]) / length
        across = np.array([along[1], -along[0], 0.0])
        return cls(np.array([near[0], near[1], 0.0]), along, across, length)

    @property
    def rotation(self) -> FloatArray:
        """3x3: site directions to (along, across, up)."""
        return np.stack([self.along, self.across, np.array([0.0, 0.0, 1.0])])

    def to_span(self, points: FloatArray) -> FloatArray:
        """(along, across, height) of site points (..., 3)."""
        return np.asarray((points - self.origin) @ self.rotation.T)

    def to_site(self, points: FloatArray) -> FloatArray:
        """Site points of (along, across, height) (..., 3)."""
        return np.asarray(points @ self.rotation + self.origin)


def ground_height(span: Span, along: FloatArray) -> FloatArray:
    """Height of the ground profile alone at ``along``; level beyond its ends."""
    profile = np.array(span.ground.profile)
    return np.asarray(np.interp(along, profile[:, 0], profile[:, 1]))
