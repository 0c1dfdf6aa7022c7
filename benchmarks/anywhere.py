"""Sites drawn at random: spans, towers, conductors, cameras and landmarks that nobody has designed for.

Every other group of the suite keeps to one of nine surveys; a rule that helps those alone shows here. Everything is
drawn in coordinates of the span (across to the right, along, up), which are then turned and put somewhere in the site.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sagnode.calibrate.files import save_intrinsics
from sagnode.config.base import Point
from sagnode.config.span import CameraSurvey, Conductor, Ground, Landmark, Span, Swing
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, project, rotation_from_angles, undistort
from sagnode.scene.catenary import WireState, wire_points

SIZES = ((640, 480), (1280, 720), (1456, 1088), (1088, 1456), (2028, 1520), (4056, 3040))
DIAMETERS_M = (0.0114, 0.0155, 0.0218, 0.0266, 0.0306, 0.0363)
FEWEST = 5
"""Landmarks that a site has at least."""
PLACES = 400
"""Draws of places for landmarks in a picture."""
WIRE_AWAY_PX = 45.0
"""Landmarks stand farther from the wires than this, as a technician would choose them."""


@dataclass(frozen=True)
class _Eye:
    """A camera in span coordinates."""

    position: FloatArray
    seen_from: float
    """The part of the span, by its share from A, that its lens takes in starts here."""
    seen_to: float


Place = Callable[[float, float, np.random.Generator], _Eye]
"""Draws a camera for a span of some length whose lowest attachment has some height."""


def anywhere(place: Place) -> Callable[[Span, np.random.Generator], Span]:
    """A change of a survey into one drawn at random, with the camera at a place drawn by ``place``.

    The calibration is written beside the one of the survey that is changed.
    """

    def survey(span: Span, rng: np.random.Generator) -> Span:
        while True:
            drawn, lens = _draw(place, rng)
            if len(drawn.landmarks) >= FEWEST:
                break
        file = span.camera.intrinsics.with_name("anywhere.yaml")
        save_intrinsics(file, lens)
        camera = drawn.camera.model_copy(update={"intrinsics": file})
        turned_deg, origin = float(rng.uniform(-180.0, 180.0)), rng.uniform(-300.0, 300.0, 2)
        return _put(drawn.model_copy(update={"camera": camera}), turned_deg, origin)

    return survey


def _draw(place: Place, rng: np.random.Generator) -> tuple[Span, Intrinsics]:
    length = math.exp(rng.uniform(math.log(70.0), math.log(550.0)))
    conductors, ground = _line(length, rng)
    eye = place(length, min(min(c.near[2], c.far[2]) for c in conductors), rng)
    wires = np.concatenate(list(_wires(conductors, eye)))
    lens, (azimuth, elevation) = _lens(wires - eye.position, rng)
    pose = Pose(rotation_from_angles(azimuth, elevation, 0.0), eye.position)
    camera = CameraSurvey(
        position=_point(eye.position),
        position_u_m=float(rng.uniform(0.02, 0.10)),
        azimuth_deg=azimuth,
        elevation_deg=elevation,
        orientation_u_deg=float(rng.uniform(0.2, 0.5)),
        intrinsics=Path("camera.yaml"),
        focal_u_rel=float(rng.uniform(0.0005, 0.002)),
        max_movement_px=max(60.0, 0.04 * lens.width),
    )
    marks = _landmarks(lens, pose, wires, length, ground, rng)
    swing = Swing(max_deg=20.0, prior_u_deg=6.0, questionable_deg=12.0)
    return Span(
        name="anywhere", conductors=conductors, ground=ground, camera=camera, landmarks=marks, swing=swing
    ), lens


# --- where the camera is ----------------------------------------------------------------------------------------------


def on_the_tower(_length: float, lowest: float, rng: np.random.Generator) -> _Eye:
    """On the near tower's body, below the arms."""
    height = max(4.0, lowest - float(rng.uniform(2.0, 7.0)))
    position = np.array([rng.uniform(-1.5, 1.5), rng.uniform(0.8, 3.0), height])
    return _Eye(position, float(rng.uniform(0.08, 0.25)), 1.0)


def on_the_ground(length: float, _lowest: float, rng: np.random.Generator) -> _Eye:
    """Beside the near tower or a little before it, looking along the line."""
    side = rng.choice([-1.0, 1.0])
    position = np.array([side * rng.uniform(4.0, 15.0), rng.uniform(-0.02, 0.08) * length, rng.uniform(1.6, 3.5)])
    return _Eye(position, float(rng.uniform(0.1, 0.3)), 1.0)


def aside(length: float, _lowest: float, rng: np.random.Generator) -> _Eye:
    """From the side or obliquely, a quarter to three quarters of the span away, on a pole or a slope."""
    side = rng.choice([-1.0, 1.0])
    away = float(rng.uniform(0.25, 0.75)) * length
    position = np.array([side * away, rng.uniform(-0.1, 1.1) * length, rng.uniform(1.6, 12.0)])
    middle, half = float(rng.uniform(0.4, 0.6)), float(rng.uniform(0.25, 0.4))
    return _Eye(position, middle - half, middle + half)


# --- the line ---------------------------------------------------------------------------------------------------------


def _line(length: float, rng: np.random.Generator) -> tuple[tuple[Conductor, ...], Ground]:
    """Conductors on their towers and the ground below them."""
    usual = float(rng.uniform(0.016, 0.040)) * length
    least, most = 0.65 * usual, 1.45 * usual
    rise = float(np.clip(rng.normal(0.0, 0.025), -0.06, 0.06)) * length
    along = np.concatenate([[0.0], np.sort(rng.uniform(0.1, 0.9, int(rng.integers(1, 5)))) * length, [length]])
    heights = rise * along / length + rng.normal(0.0, 0.004 * length, along.size)
    base = most + float(rng.uniform(5.0, 9.0)) + float(np.max(heights - rise * along / length))
    diameter = float(rng.choice(DIAMETERS_M))
    count = int(rng.choice([1, 1, 1, 1, 2, 4]))
    u = float(rng.uniform(0.01, 0.06))
    wires = [
        Conductor(
            id=f"L{number}",
            near=(x, 0.0, base + z),
            far=(x, length, base + z + rise),
            attachment_u_m=u,
            diameter_m=diameter,
            sub_conductors=count,
            unit_weight_n_m=2.0e4 * diameter**2,
            sag_min_m=least,
            sag_max_m=most,
        )
        for number, (x, z) in enumerate(_arrangement(length, rng), 1)
    ]
    if rng.random() < 0.5:
        top = max(c.near[2] for c in wires) + float(rng.uniform(3.0, 6.0))
        wires.append(
            Conductor(
                id="earth",
                near=(0.0, 0.0, top),
                far=(0.0, length, top + rise),
                attachment_u_m=u,
                diameter_m=0.0114,
                sag_min_m=0.5 * least,
                sag_max_m=0.9 * most,
                measured=False,
            )
        )
    profile = tuple((float(a), float(z)) for a, z in zip(along, heights, strict=True))
    return tuple(wires), Ground(profile=profile, height_u_m=float(rng.uniform(0.02, 0.06)))


def _arrangement(length: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """(across, above the lowest) of the attachments: flat, above each other, a triangle or two circuits."""
    apart = float(np.clip(rng.uniform(0.012, 0.03) * length, 1.2, 9.0))
    kind = rng.choice(["flat", "vertical", "triangle", "double", "single"])
    if kind == "flat":
        return [(-apart, 0.0), (0.0, 0.0), (apart, 0.0)]
    if kind == "vertical":
        return [(0.8 * apart, k * apart) for k in range(3)]
    if kind == "triangle":
        return [(-apart, 0.0), (apart, 0.0), (0.9 * apart, apart)]
    if kind == "double":
        return [(side * apart * (1.3 if k == 1 else 1.0), k * apart) for side in (-1, 1) for k in range(3)]
    return [(apart, 0.0)]


def _wires(conductors: tuple[Conductor, ...], eye: _Eye) -> Iterator[FloatArray]:
    """Points of what a camera sees of the conductors at their least and largest sags."""
    s = np.linspace(max(eye.seen_from, 0.0), min(eye.seen_to, 1.0), 60)
    for c in conductors:
        if c.measured:
            for sag in (c.sag_min_m, c.sag_max_m):
                yield wire_points(np.array(c.near), np.array(c.far), WireState(sag), s)


# --- the camera and what it sees --------------------------------------------------------------------------------------


def _lens(rays: FloatArray, rng: np.random.Generator) -> tuple[Intrinsics, tuple[float, float]]:
    """A lens that takes in some directions (N, 3), and azimuth and elevation of its axis in degrees."""
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    low, high = unit.min(axis=0), unit.max(axis=0)
    axis = (low + high) / 2
    azimuth = math.degrees(math.atan2(axis[0], axis[1]))
    elevation = math.degrees(math.atan2(axis[2], math.hypot(axis[0], axis[1])))
    azimuth, elevation = azimuth + float(rng.normal(0.0, 0.3)), elevation + float(rng.normal(0.0, 0.3))
    x, y, z = rotation_from_angles(azimuth, elevation, 0.0) @ unit.T
    reach = np.abs(np.stack([x, y]) / z).max(axis=1)
    width, height = SIZES[int(rng.integers(len(SIZES)))]
    fill = float(rng.uniform(0.75, 0.95))
    focal = fill * min(width / 2 / float(reach[0]), height / 2 / float(reach[1]))
    # no longer and no wider than lenses that are sold
    focal = float(np.clip(focal, 0.42 * width, 8.0 * width))
    corner = math.hypot(width, height) / 2 / focal
    k1 = float(rng.uniform(-0.10, 0.02)) / max(1.0, corner**2)
    centre = rng.normal(0.0, 0.004 * width, 2)
    lens = Intrinsics(
        width,
        height,
        focal,
        focal * float(rng.uniform(0.999, 1.001)),
        (width - 1) / 2 + float(centre[0]),
        (height - 1) / 2 + float(centre[1]),
        (k1, 0.25 * k1 * k1, 0.0, 0.0, 0.0),
    )
    return lens, (azimuth, elevation)


def _landmarks(
    lens: Intrinsics, pose: Pose, wires: FloatArray, length: float, ground: Ground, rng: np.random.Generator
) -> tuple[Landmark, ...]:
    """Five to ten survey targets, poles and roofs, all over the picture, at all distances, clear of the wires."""
    wanted, size = int(rng.integers(5, 11)), int(rng.integers(12, 21)) * 2 + 1
    u = float(rng.uniform(0.01, 0.05))
    of_wires, _ = project(lens, pose, wires)
    chosen: list[FloatArray] = []
    pixels: list[FloatArray] = []
    for _ in range(PLACES):
        pixel = rng.uniform([0.06, 0.06], [0.94, 0.94]) * np.array([lens.width, lens.height])
        x, y = undistort(lens, pixel[:1], pixel[1:])
        ray = pose.rotation.T @ np.array([float(x[0]), float(y[0]), 1.0])
        ray /= np.linalg.norm(ray)
        away = math.exp(rng.uniform(math.log(0.12 * length), math.log(1.1 * length)))
        point = pose.position + away * ray
        if not 0.0 < point[1] < 1.2 * length:
            continue
        above = point[2] - float(np.interp(point[1], *np.array(ground.profile).T))
        if not 0.6 < above < 32.0 or np.min(np.hypot(*(of_wires - pixel).T)) < WIRE_AWAY_PX:
            continue
        if pixels and np.min(np.hypot(*(np.stack(pixels) - pixel).T)) < 0.12 * lens.height:
            continue
        chosen.append(point)
        pixels.append(pixel)
        if len(chosen) == wanted:
            break
    return tuple(
        Landmark(id=f"m{number}", position=_point(p), position_u_m=u, pixel=(0.0, 0.0), pixel_u_px=0.3, size_px=size)
        for number, p in enumerate(chosen, 1)
    )


# --- into the site ----------------------------------------------------------------------------------------------------


def _put(span: Span, azimuth_deg: float, origin: FloatArray) -> Span:
    """The span turned clockwise, seen from above, and moved: nothing may hang on where north is."""
    cos, sin = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))

    def there(p: Point) -> Point:
        x, y, z = p
        return _point(np.array([cos * x + sin * y + origin[0], -sin * x + cos * y + origin[1], z]))

    camera = span.camera.model_copy(
        update={
            "position": there(span.camera.position),
            "azimuth_deg": (span.camera.azimuth_deg + azimuth_deg + 180.0) % 360.0 - 180.0,
        }
    )
    return span.model_copy(
        update={
            "conductors": tuple(
                c.model_copy(update={"near": there(c.near), "far": there(c.far)}) for c in span.conductors
            ),
            "camera": camera,
            "landmarks": tuple(m.model_copy(update={"position": there(m.position)}) for m in span.landmarks),
        }
    )


def _point(p: FloatArray) -> Point:
    return float(p[0]), float(p[1]), float(p[2])
