"""Are the landmarks of a survey enough, and do they agree with the surveyed camera and among themselves?

Needs NumPy, as :mod:`sagnode.check.sightlines` does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sagnode.config.lines import KeyPath
from sagnode.config.span import Landmark, Span
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, inside, project, rotation_from_vector, turned

Warned = tuple[KeyPath, str]

FEWEST_LANDMARKS = 4
COVERAGE = 3.0
"""Offsets beyond so many standard uncertainties contradict the survey."""


def landmark_warnings(span: Span, intrinsics: Intrinsics, pose: Pose) -> Iterator[Warned]:
    """Everything about the landmarks that can be used and will disappoint."""
    yield from _as_a_set(span, intrinsics)
    if span.landmarks:
        yield from _one_by_one(span, intrinsics, pose)


def _as_a_set(span: Span, intrinsics: Intrinsics) -> Iterator[Warned]:
    """Are there enough of them, and far enough apart?"""
    count = len(span.landmarks)
    if count < FEWEST_LANDMARKS:
        text = (
            f"there are {count}, and a camera that was knocked or sways needs {FEWEST_LANDMARKS} or more to be noticed"
            " and set right; survey points of the towers that the camera sees"
        )
        yield ("landmarks",), text
        return
    if span.camera.reference_image is None:
        text = (
            "landmarks are given without a reference_image, so they cannot be found again in a frame; name the picture"
            " in which they were clicked"
        )
        yield ("camera",), text
    pixels = np.array([landmark.pixel for landmark in span.landmarks])
    extent = float(np.hypot(*np.ptp(pixels, axis=0))) / math.hypot(intrinsics.width, intrinsics.height)
    if extent < 0.15:
        text = (
            f"all lie within {100 * extent:.0f} % of the picture's diagonal; a turn of the camera about its axis"
            " would be seen badly; add some far from these"
        )
        yield ("landmarks",), text


def _one_by_one(span: Span, intrinsics: Intrinsics, pose: Pose) -> Iterator[Warned]:
    """Does each lie where the survey puts it?"""
    points = np.array([landmark.position for landmark in span.landmarks])
    clicked = np.array([landmark.pixel for landmark in span.landmarks])
    expected, depth = project(intrinsics, pose, points)
    in_picture = inside(intrinsics, clicked)
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(expected).all(axis=-1))
    for index, landmark in enumerate(span.landmarks):
        if not in_picture[index]:
            text = f"{landmark.id} was clicked at ({clicked[index, 0]:.0f}, {clicked[index, 1]:.0f}), outside the"
            yield ("landmarks", index, "pixel"), f"{text} picture of {intrinsics.width}x{intrinsics.height} px"
        if not usable[index]:
            text = "behind the camera" if depth[index] <= 0 else "far outside the camera's field"
            key = ("landmarks", index, "position")
            yield key, f"{landmark.id} lies {text}; check it, and the camera's position and azimuth"
    places_u = np.array(
        [_place_u_px(span, m, intrinsics, float(d)) for m, d in zip(span.landmarks, depth, strict=True)]
    )
    strangers = list(_strangers(span, intrinsics, pose, places_u, usable))
    yield from strangers
    if not strangers and usable.any():
        yield from _whole(span, intrinsics, np.linalg.norm(expected - clicked, axis=-1), places_u)


def _strangers(
    span: Span, intrinsics: Intrinsics, pose: Pose, places_u: FloatArray, usable: NDArray[np.bool_]
) -> Iterator[Warned]:
    """Landmarks that do not fit the others, however the camera is turned."""
    if usable.sum() < 3:
        return
    points = np.array([landmark.position for landmark in span.landmarks])
    clicked = np.array([landmark.pixel for landmark in span.landmarks])
    fitted, _ = project(intrinsics, _turned_to_fit(intrinsics, pose, points[usable], clicked[usable]), points)
    residual = np.linalg.norm(fitted - clicked, axis=-1)
    for index, landmark in enumerate(span.landmarks):
        limit = COVERAGE * places_u[index]
        if usable[index] and residual[index] > limit:
            text = (
                f"{landmark.id} lies {residual[index]:.1f} px from its clicked pixel even with the camera turned to fit"
                f" the landmarks, and its stated uncertainty explains {limit:.1f}; check its position and pixel (is it"
                " another point?)"
            )
            yield ("landmarks", index), text


def _whole(span: Span, intrinsics: Intrinsics, offset: FloatArray, places_u: FloatArray) -> Iterator[Warned]:
    """The camera's surveyed angles against all landmarks together."""
    worst = int(np.nanargmax(offset))
    turn_u = math.radians(span.camera.orientation_u_deg) * intrinsics.fx
    limit = COVERAGE * math.hypot(turn_u, places_u[worst])
    if offset[worst] > limit:
        text = (
            f"landmarks lie up to {offset[worst]:.0f} px ({span.landmarks[worst].id}) from where the surveyed camera"
            f" puts them, and its stated uncertainty explains {limit:.0f}; check azimuth, elevation, roll and position,"
            " or raise orientation_u_deg"
        )
        yield ("camera",), text


def _place_u_px(span: Span, landmark: Landmark, intrinsics: Intrinsics, depth: float) -> float:
    """Standard uncertainty of a landmark's offset from places and lens alone, px in each direction.

    The places of camera and landmark are seen from its distance; the lens counts at the picture's corner.
    """
    places = math.hypot(landmark.position_u_m, span.camera.position_u_m) / max(depth, 1e-6) * intrinsics.fx
    lens = math.hypot(span.camera.principal_point_u_px, span.camera.focal_u_rel * intrinsics.width / 2)
    return math.hypot(places, lens, landmark.pixel_u_px)


def _turned_to_fit(intrinsics: Intrinsics, pose: Pose, points: FloatArray, clicked: FloatArray) -> Pose:
    """The pose turned so that the points (N, 3) fall nearest to the clicked pixels (N, 2), by Gauss-Newton.

    Large residuals count less (Cauchy's weight), so that one wrong landmark does not draw the camera towards itself and
    throw suspicion on the right ones.
    """
    still = np.zeros(3)
    for _ in range(15):
        base, _ = project(intrinsics, pose, points)
        step = 1e-6
        columns = [
            (project(intrinsics, turned(pose, step * axis, still), points)[0] - base) / step for axis in np.eye(3)
        ]
        jacobian = np.stack(columns, axis=-1)
        residual = clicked - base
        good = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(residual).all(axis=1)
        if good.sum() < 2:
            return pose
        length = np.linalg.norm(residual[good], axis=1)
        weight = 1.0 / (1.0 + (length / max(float(np.median(length)), 1.0)) ** 2)
        rows = jacobian[good] * np.sqrt(weight)[:, None, None]
        right = residual[good] * np.sqrt(weight)[:, None]
        turn = np.linalg.lstsq(rows.reshape(-1, 3), right.reshape(-1), rcond=None)[0]
        length_rad = float(np.linalg.norm(turn))
        if length_rad > 0.2:  # far away the linear step is no guide
            turn *= 0.2 / length_rad
        pose = Pose(rotation_from_vector(turn) @ pose.rotation, pose.position)
        if length_rad < 1e-9:
            break
    return pose
