"""A small span to plan with: two conductors of 60 m, six targets, as a model and as a file."""

from __future__ import annotations

from presets import simple_scene
from sagnode.config.span import Span
from sagnode.geometry.camera import Intrinsics
from sagnode.plan.camera import PlannedCamera


def simple_span() -> tuple[Span, PlannedCamera]:
    """The survey, and the camera that it states."""
    scene, _ = simple_scene()
    return scene.surveyed, camera_of(scene.surveyed, scene.intrinsics)


def camera_of(span: Span, intrinsics: Intrinsics) -> PlannedCamera:
    c = span.camera
    return PlannedCamera(intrinsics, c.position, c.azimuth_deg, c.elevation_deg, c.roll_deg)
