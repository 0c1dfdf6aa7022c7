"""The true world behind a survey: the survey plus errors drawn from the uncertainties that it states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sagnode.config.base import Point
from sagnode.config.span import Span
from sagnode.geometry.camera import Intrinsics


def perturbed(span: Span, rng: np.random.Generator, scale: float = 1.0) -> Span:
    """A true span that the surveyed one is an honest survey of.

    Every coordinate is moved by a normal error of the standard uncertainty stated for it: attachments, ground heights,
    obstacles, landmarks, camera position and the camera's three angles. What the lens truly is, see
    :func:`perturbed_intrinsics`. Pixels of landmarks are left alone: they are clicks in a picture of the true world.

    Args:
        span: the survey.
        rng: source of the errors.
        scale: multiplies all errors; 0 gives the survey back.
    """

    def point(p: Point, u: float) -> Point:
        x, y, z = np.array(p) + scale * u * rng.standard_normal(3)
        return float(x), float(y), float(z)

    def number(value: float, u: float) -> float:
        return float(value + scale * u * rng.standard_normal())

    conductors = tuple(
        c.model_copy(update={"near": point(c.near, c.attachment_u_m), "far": point(c.far, c.attachment_u_m)})
        for c in span.conductors
    )
    ground = span.ground.model_copy(
        update={
            "profile": tuple((along, number(z, span.ground.height_u_m)) for along, z in span.ground.profile),
            "obstacles": tuple(
                o.model_copy(update={"height_m": number(o.height_m, span.ground.height_u_m)})
                for o in span.ground.obstacles
            ),
        }
    )
    landmarks = tuple(m.model_copy(update={"position": point(m.position, m.position_u_m)}) for m in span.landmarks)
    camera = span.camera.model_copy(
        update={
            "position": point(span.camera.position, span.camera.position_u_m),
            "azimuth_deg": number(span.camera.azimuth_deg, span.camera.orientation_u_deg),
            "elevation_deg": number(span.camera.elevation_deg, span.camera.orientation_u_deg),
            "roll_deg": number(span.camera.roll_deg, span.camera.orientation_u_deg),
        }
    )
    return span.model_copy(
        update={"conductors": conductors, "ground": ground, "landmarks": landmarks, "camera": camera}
    )


def perturbed_intrinsics(
    intrinsics: Intrinsics, span: Span, rng: np.random.Generator, scale: float = 1.0
) -> Intrinsics:
    """The true lens behind a calibration, by the uncertainties that ``span.camera`` states for it.

    Both focal lengths share one error (their ratio is what a calibration knows best); k1 takes the distortion's.
    """
    focal = 1 + scale * span.camera.focal_u_rel * rng.standard_normal()
    cx, cy = scale * span.camera.principal_point_u_px * rng.standard_normal(2)
    k1 = scale * span.camera.distortion_u * rng.standard_normal()
    distortion = intrinsics.distortion
    if distortion:
        distortion = (float(distortion[0] + k1), *distortion[1:])
    return replace(
        intrinsics,
        fx=float(intrinsics.fx * focal),
        fy=float(intrinsics.fy * focal),
        cx=float(intrinsics.cx + cx),
        cy=float(intrinsics.cy + cy),
        distortion=distortion,
    )
