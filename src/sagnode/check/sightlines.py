"""What the surveyed camera would see of the surveyed span: warnings about a survey that contradicts itself.

Needs NumPy; :mod:`sagnode.check.configuration` imports it only where that is installed.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sagnode.check.landmark_sights import landmark_warnings
from sagnode.check.wire_warnings import obstacle_warnings, wire_warnings
from sagnode.config.lines import KeyPath
from sagnode.config.span import Conductor, Span
from sagnode.geometry.camera import Intrinsics, Pose, inside, project, rotation_from_angles
from sagnode.geometry.conductor import conductor_points
from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import Shape, quantities

Warned = tuple[KeyPath, str]

SMALLEST_SHARE = 0.15
"""Of a span less than this in the picture leaves sag to the survey."""


def survey_warnings(span: Span, intrinsics: Intrinsics) -> Iterator[Warned]:
    """Everything in a survey that can be used and will disappoint.

    Args:
        span: the survey.
        intrinsics: of its camera.
    """
    camera = span.camera
    pose = Pose(
        rotation_from_angles(camera.azimuth_deg, camera.elevation_deg, camera.roll_deg), np.asarray(camera.position)
    )
    yield from landmark_warnings(span, intrinsics, pose)
    ground = _ground(span)
    for index, conductor in enumerate(span.conductors):
        yield from ((("conductors", index, *key), text) for key, text in wire_warnings(conductor))
        if conductor.measured:
            warned = [*_in_view(conductor, intrinsics, pose), *_above_ground(span, conductor, ground)]
            yield from ((("conductors", index, *key), text) for key, text in warned)
    yield from obstacle_warnings(span)
    yield from _directions(span)


def _ground(span: Span) -> GroundProfile:
    along, height = np.array(span.ground.profile).T
    obstacles = np.array([(*o.along_m, o.height_m) for o in span.ground.obstacles]).reshape(-1, 3)
    return GroundProfile(along, height, obstacles, span.ground.height_u_m)


def _in_view(conductor: Conductor, intrinsics: Intrinsics, pose: Pose) -> Iterator[Warned]:
    """Is enough of the conductor in the picture at every sag that is searched?"""
    near, far = np.asarray(conductor.near), np.asarray(conductor.far)
    ends, depth = project(intrinsics, pose, np.stack([near, far]))
    if (depth <= 0).all():
        text = f"{conductor.id} lies wholly behind the camera; check the camera's azimuth and position"
        yield (), text
        return
    if depth[1] <= 0:
        yield ("far",), f"far attachment of {conductor.id} lies behind the camera; are near and far swapped?"
    sags = np.linspace(conductor.sag_min_m, conductor.sag_max_m, 21)
    points = conductor_points(near, far, sags, 0.0, np.linspace(0.0, 1.0, 201))
    pixels, _ = project(intrinsics, pose, points)
    share = inside(intrinsics, pixels).mean(axis=-1)
    if share.max() == 0:
        yield (), f"{conductor.id} is not in the picture at any sag that is searched; check the camera's angles"
        return
    hidden = sags[share < SMALLEST_SHARE]
    if len(hidden):
        text = (
            f"less than {100 * SMALLEST_SHARE:.0f} % of {conductor.id} is in the picture at sags from {hidden[0]:.2f}"
            f" to {hidden[-1]:.2f} m; such sags would not be measured; turn the camera or narrow the range"
        )
        yield ("sag_max_m",) if hidden[-1] == sags[-1] else ("sag_min_m",), text
    if not inside(intrinsics, ends).any():
        text = (
            f"neither attachment of {conductor.id} is in the picture; its sag rests on survey and pose alone, which"
            " widens its interval"
        )
        yield (), text
    changed, _ = project(intrinsics, pose, conductor_points(near, far, 1.01 * sags, 0.0, np.linspace(0.0, 1.0, 201)))
    moved = np.linalg.norm(changed - pixels, axis=-1)[inside(intrinsics, pixels)]
    best = float(np.nanmax(moved, initial=0.0))
    if best < 0.1:
        text = (
            f"1 % of the sag of {conductor.id} moves it by at most {best:.2f} px; this camera is too far away or its"
            " lens too short to measure it"
        )
        yield (), text


def _above_ground(span: Span, conductor: Conductor, ground: GroundProfile) -> Iterator[Warned]:
    """Do ground, limits and the searched sags fit together?"""
    near, far = np.asarray(conductor.near), np.asarray(conductor.far)
    length = float(np.hypot(*(far - near)[:2]))
    slack = 0.005 * length
    if ground.along[0] > slack or ground.along[-1] < length - slack:
        text = (
            f"the ground profile goes from {ground.along[0]:g} to {ground.along[-1]:g} m and {conductor.id} from 0 to"
            f" {length:.1f}; beyond its ends the ground is taken as level; survey it as far as the towers"
        )
        yield (), text
    shallow, deep = (quantities(Shape(near, far, s), ground) for s in (conductor.sag_min_m, conductor.sag_max_m))
    if shallow["clearance"] <= 0:
        text = f"{conductor.id} would touch the ground at {shallow['clearance_along']:.0f} m even with its least sag"
        yield ("sag_min_m",), f"{text}; check the heights of attachments and ground (one site frame for both)"
        return
    if deep["clearance"] < 0:
        text = f"at {conductor.sag_max_m:g} m of sag {conductor.id} would be {-deep['clearance']:.2f} m below ground"
        yield ("sag_max_m",), f"{text}, {deep['clearance_along']:.0f} m from A; lower it, or check the heights"
    limit = span.limits.clearance_min_m
    if limit is not None and shallow["clearance"] < limit:
        text = f"even with its least sag {conductor.id} clears the ground by {shallow['clearance']:.2f} m, and"
        yield ("sag_min_m",), f"{text} limits.clearance_min_m = {limit:g}; the alarm would never clear"
    elif limit is not None and deep["clearance"] > limit:
        text = (
            f"the search for {conductor.id} ends at {deep['clearance']:.2f} m of clearance, above"
            f" limits.clearance_min_m = {limit:g}; a conductor that violates the limit would not be found; raise it"
        )
        yield ("sag_max_m",), text
    highest = span.limits.sag_max_m
    if highest is not None and highest <= conductor.sag_min_m:
        text = f"even the least sag of {conductor.id} exceeds limits.sag_max_m = {highest:g}"
        yield ("sag_min_m",), f"{text}; the alarm would never clear"
    elif highest is not None and highest >= conductor.sag_max_m:
        text = f"the search for {conductor.id} ends before limits.sag_max_m = {highest:g}"
        yield ("sag_max_m",), f"{text}; a sag over the limit would not be found; raise it"


def _directions(span: Span) -> Iterator[Warned]:
    """Do all conductors run the same way, away from the camera's tower?"""
    near = np.array([c.near for c in span.conductors])[:, :2]
    chords = np.array([c.far for c in span.conductors])[:, :2] - near
    common = chords[0] / np.linalg.norm(chords[0])
    for index, (conductor, chord) in enumerate(zip(span.conductors, chords, strict=True)):
        if float(chord @ common) < 0:
            yield (
                ("conductors", index),
                f"{conductor.id} runs against {span.conductors[0].id}; are its near and far swapped?",
            )
    position = np.asarray(span.camera.position)[:2]
    to_near = float(np.linalg.norm(near.mean(axis=0) - position))
    to_far = float(np.linalg.norm((near + chords).mean(axis=0) - position))
    if to_near > 1.5 * to_far:
        text = (
            f"the near attachments are {to_near:.0f} m from the camera and the far ones {to_far:.0f}; 'near' is meant"
            " to be the camera's end (distances along the span count from it)"
        )
        yield ("conductors",), text
