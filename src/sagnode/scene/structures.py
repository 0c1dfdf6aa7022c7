"""Towers, poles, buildings and survey targets, with the survey's landmarks as real corners at their true places."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sagnode.config.span import Landmark
from sagnode.geometry.camera import FloatArray
from sagnode.scene.canvas import Canvas, hull
from sagnode.scene.light import SNOW_GREY, Light
from sagnode.scene.spec import LandmarkKind, Scene, SpanFrame, ground_height

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Thing:
    """Something that stands at a distance and can be drawn."""

    distance_m: float
    draw: Callable[[], None]


@dataclass(frozen=True)
class Bar:
    """A straight member between two site points (2, 3)."""

    ends: FloatArray
    width_m: float
    grey: float


def tower(scene: Scene, frame: SpanFrame, *, far: bool) -> list[Bar]:
    """The lattice tower at one end of the span, from its true attachments and crossarm tips, site frame.

    The body is square; every attachment hangs by an insulator string from the tip of a crossarm. A landmark of kind
    ``tower`` that was surveyed near a tip or the peak is where the members truly meet.
    """
    ends = np.array([c.far if far else c.near for c in scene.true.conductors])
    phases = np.array([c.measured for c in scene.true.conductors])
    local = frame.to_span(ends)
    axis = np.array([float(local[:, 0].mean()), float(local[:, 1].min() + local[:, 1].max()) / 2])
    ground = float(ground_height(scene.true, axis[:1])[0])
    top = float(local[:, 2].max())
    if np.any(phases):
        top = max(top, float(local[phases, 2].max()) + scene.world.insulator_m + 1.0)
    waist = float(local[phases, 2].min()) + scene.world.insulator_m if np.any(phases) else top
    bars = _body(frame, axis, ground, waist, top)
    for end, attached, is_phase in zip(ends, local, phases, strict=True):
        if not is_phase:
            bars += _peak(scene, frame, axis, end, top)
            continue
        tip = _true_joint(scene, end + scene.world.insulator_m * UP)
        bars.append(Bar(np.stack([tip, end]), 0.16, 62.0))
        bars += _crossarm(frame, axis, tip, float(attached[2]) + scene.world.insulator_m, ground, waist, top)
    return bars


def _half_width(z: float, ground: float, waist: float, top: float) -> float:
    """Half the side of the tower's body at a height."""
    if z < waist:
        return 0.55 + 1.35 * (waist - z) / max(waist - ground, 1.0)
    return 0.28 + 0.27 * (top - z) / max(top - waist, 0.5)


def _body(frame: SpanFrame, axis: FloatArray, ground: float, waist: float, top: float) -> list[Bar]:
    heights = [ground]
    while heights[-1] < top - 0.3:
        step = 1.9 * _half_width(heights[-1], ground, waist, top)
        heights.append(min(heights[-1] + max(step, 0.8), top))
    rings = []
    for z in heights:
        b = _half_width(z, ground, waist, top)
        corners = [[axis[0] + i * b, axis[1] + j * b, z] for i, j in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
        rings.append(frame.to_site(np.array(corners)))
    bars: list[Bar] = []
    for lower, upper in itertools.pairwise(rings):
        for k in range(4):
            n = (k + 1) % 4
            bars.append(Bar(np.stack([lower[k], upper[k]]), 0.13, 84.0))
            bars.append(Bar(np.stack([lower[k], upper[n]]), 0.06, 92.0))
            bars.append(Bar(np.stack([lower[n], upper[k]]), 0.06, 78.0))
            bars.append(Bar(np.stack([upper[k], upper[n]]), 0.06, 86.0))
    return bars


def _crossarm(
    frame: SpanFrame, axis: FloatArray, tip: FloatArray, height: float, ground: float, waist: float, top: float
) -> list[Bar]:
    """Two lower chords and two upper ones that meet at the tip, with lacing between them."""
    across = float(frame.to_span(tip)[1])
    side = 1.0 if across > axis[1] else -1.0
    bars: list[Bar] = []
    rise = min(1.15, max(top - height, 0.4))
    for i in (-1.0, 1.0):
        roots = []
        for z in (height, height + rise):
            b = _half_width(z, ground, waist, top)
            roots.append(frame.to_site(np.array([axis[0] + i * b, axis[1] + side * b, z])))
        bars += [Bar(np.stack([root, tip]), 0.10, 80.0) for root in roots]
        knots = np.linspace(0.0, 1.0, 6)[:-1]
        lower = [roots[0] + t * (tip - roots[0]) for t in knots]
        upper = [roots[1] + t * (tip - roots[1]) for t in knots]
        for a, b_, c in zip(lower, upper, lower[1:], strict=False):
            bars += [Bar(np.stack([a, b_]), 0.05, 88.0), Bar(np.stack([b_, c]), 0.05, 74.0)]
    return bars


def _peak(scene: Scene, frame: SpanFrame, axis: FloatArray, end: FloatArray, top: float) -> list[Bar]:
    """The spire of an earth wire."""
    tip = _true_joint(scene, end)
    foot = frame.to_site(np.array([[axis[0] + i * 0.3, axis[1] + j * 0.3, top] for i in (-1, 1) for j in (-1, 1)]))
    return [Bar(np.stack([f - 0.8 * UP, tip]), 0.10, 82.0) for f in foot]


def _true_joint(scene: Scene, place: FloatArray) -> FloatArray:
    """The true position of the tower landmark that belongs to a joint, or the joint's own."""
    best, reach = place, 0.8
    for mark in scene.true.landmarks:
        distance = float(np.linalg.norm(np.array(mark.position) - place))
        if distance < reach and landmark_kind(scene, mark.id) == "tower":
            best, reach = np.array(mark.position), distance
    return best


def landmark_kind(scene: Scene, name: str) -> LandmarkKind:
    """What a landmark is: as the world says, else the joint of a drawn tower at which it was surveyed, or a target."""
    if name in scene.world.landmark_kinds:
        return scene.world.landmark_kinds[name]
    if scene.world.backdrop != "country" or not scene.world.towers:
        return "target"
    # the survey leaves out what it could not click; it stands there all the same
    known = (m.position for m in (*scene.surveyed.landmarks, *scene.true.landmarks) if m.id == name)
    place = np.array(next(known))
    for conductor in scene.surveyed.conductors:
        for end in (conductor.near, conductor.far):
            joint = np.array(end) + (scene.world.insulator_m if conductor.measured else 0.0) * UP
            if float(np.linalg.norm(joint - place)) < 0.3:
                return "tower"
    return "target"


def landmark_things(canvas: Canvas, scene: Scene, frame: SpanFrame, light: Light) -> list[Thing]:
    """What stands at the landmarks (towers draw their own)."""
    things: list[Thing] = []
    for mark in scene.true.landmarks:
        kind = landmark_kind(scene, mark.id)
        place = np.array(mark.position)
        distance = float(np.linalg.norm(place - canvas.pose.position))
        if kind == "target":
            things.append(Thing(distance, _target(canvas, scene, frame, mark, light)))
        elif kind == "roof":
            things.append(Thing(distance, _house(canvas, scene, frame, place, light)))
        elif kind == "pole":
            things.append(Thing(distance, _pole(canvas, scene, frame, place, light)))
    return things


def _facing(canvas: Canvas, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors to the right and up of a plate that faces the camera at rest."""
    view = place - canvas.pose.position
    right = np.array([view[1], -view[0], 0.0])
    right /= max(float(np.linalg.norm(right)), 1e-9)
    return right, UP


def _target(canvas: Canvas, scene: Scene, frame: SpanFrame, mark: Landmark, light: Light) -> Callable[[], None]:
    """A plate of four quarters, black and white, on a post; the landmark is its centre."""
    place = np.array(mark.position)
    # The plate's plane is fixed by the surveyed camera, so that it does not turn with the sway.
    right, up = _facing(canvas, place)
    distance = float(np.linalg.norm(place - canvas.pose.position))
    side = scene.world.target_side_m or 26.0 * distance / canvas.intrinsics.fx
    lit = light.on_face(np.cross(right, up), 1.0)

    def corner(i: float, j: float) -> FloatArray:
        return np.asarray(place + i * side / 2 * right + j * side / 2 * up)

    def draw() -> None:
        foot = _foot(scene, frame, place)
        canvas.segment(np.stack([foot, corner(0, -1)]), max(0.10 * side, 0.004), 70.0)
        canvas.polygon(np.stack([corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)]), 214.0 * lit)
        for i, j in ((-1.0, 1.0), (1.0, -1.0)):
            quarter = [corner(0, 0), corner(0.9 * i, 0), corner(0.9 * i, 0.9 * j), corner(0, 0.9 * j)]
            canvas.polygon(np.stack(quarter), 26.0 * lit)
        _weathered_plate(canvas, place, corner, light)

    return draw


def _weathered_plate(
    canvas: Canvas, place: FloatArray, corner: Callable[[float, float], FloatArray], light: Light
) -> None:
    """Snow and a neighbour's shadow on a survey target."""
    if light.snow > 0:
        # a cap, and what the wind has driven against the lower edge
        for low, high in ((1 - 0.5 * light.snow, 1.0), (-1.0, -1 + 0.3 * light.snow)):
            strip = [corner(-1, low), corner(1, low), corner(1, high), corner(-1, high)]
            canvas.polygon(np.stack(strip), SNOW_GREY)
    if light.relief > 0:
        edge = light.shadow_edge(place)
        dark = [corner(-1, -1), corner(edge - 0.3, -1), corner(edge + 0.3, 1), corner(-1, 1)]
        canvas.shade(np.stack(dark), light.shadow(place))


def _foot(scene: Scene, frame: SpanFrame, place: FloatArray) -> FloatArray:
    local = frame.to_span(place)
    ground = float(ground_height(scene.true, local[:1])[0])
    return np.array([place[0], place[1], min(ground, float(place[2]) - 0.05)])


def _pole(canvas: Canvas, scene: Scene, frame: SpanFrame, place: FloatArray, light: Light) -> Callable[[], None]:
    """A concrete pole whose top, beside the crosspiece, is the landmark."""
    right, _ = _facing(canvas, place)
    lit = light.on_face(np.cross(right, UP), 1.0)

    def draw() -> None:
        canvas.segment(np.stack([_foot(scene, frame, place), place]), 0.26, 158.0 * lit)
        for below, half in ((0.35, 1.1), (1.1, 0.8)):
            middle = place - below * UP
            canvas.segment(
                np.stack([middle - half * right, middle + half * right]), 0.18, light.snowed(172.0 * lit, 0.8)
            )

    return draw


def _house(canvas: Canvas, scene: Scene, frame: SpanFrame, place: FloatArray, light: Light) -> Callable[[], None]:
    """A house whose ridge ends, on the side of the span, at the landmark."""
    local = frame.to_span(place)
    outwards = 1.0 if local[1] > 0 else -1.0
    ground = float(ground_height(scene.true, local[:1])[0])
    ridge = float(local[2]) - ground
    eaves, long, half = 0.58 * ridge, 1.9 * ridge, 0.62 * ridge

    def at(outward: float, along: float, height: float) -> FloatArray:
        return np.asarray(frame.to_site(local + np.array([along, outwards * outward, height - ridge])))

    def draw() -> None:
        even = 0.75 + 0.5 * light.sun
        towards_span, towards_near = -outwards * frame.across, -frame.along
        pitched = np.array([-(ridge - eaves), 0.0, half]) / float(np.hypot(ridge - eaves, half))
        of_gable, of_front = light.on_face(towards_span, even), light.on_face(towards_near, even)
        of_roof = light.on_face(pitched @ frame.rotation, even)
        gable = np.stack([at(0, -half, 0), at(0, half, 0), at(0, half, eaves), at(0, 0, ridge), at(0, -half, eaves)])
        front = np.stack([at(0, -half, 0), at(long, -half, 0), at(long, -half, eaves), at(0, -half, eaves)])
        roof = np.stack([at(0, -half, eaves), at(long, -half, eaves), at(long, 0, ridge), at(0, 0, ridge)])
        outline = np.concatenate([gable, front, roof])
        pixels, _ = canvas.project(outline)
        if not np.all(np.isfinite(pixels)):
            return
        canvas.polygon(outline[hull(pixels)], 150.0 * of_front)
        canvas.polygon(gable, 172.0 * of_gable)
        canvas.polygon(front, 150.0 * of_front)
        canvas.polygon(roof, light.snowed(64.0 * of_roof))
        count = 5
        for k in range(count):
            x = long * (k + 0.6) / (count + 0.4)
            window = [at(x, -half, 0.22 * ridge), at(x + 0.12 * ridge, -half, 0.22 * ridge)]
            window += [at(x + 0.12 * ridge, -half, 0.42 * ridge), at(x, -half, 0.42 * ridge)]
            canvas.polygon(np.stack(window), 48.0)

    return draw
