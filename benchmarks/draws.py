"""What the groups differ in: weather, loads, movement of the camera, things in the way; each drawn at random.

A change takes a setting and a frame and gives the frame as the group's theme has it; :func:`frames` makes shots of
ordinary moments with changes upon them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from sagnode.config.span import Span, Swing
from sagnode.geometry.camera import FloatArray, inside, project
from sagnode.scene.catenary import Load, PartialLoad, PointLoad, wire_points
from sagnode.scene.day import DayPlan, Spell, day_of_moments
from sagnode.scene.spec import LensState, OtherWire, SpanFrame, Tree, World
from views import View, raised
from worlds import Setting, Shot, any_moment

Change = Callable[[Setting, Shot], Shot]
Generator = np.random.Generator


def frames(*changes: Change, count: int = 1) -> Callable[[Setting], Iterable[Shot]]:
    """``count`` ordinary frames with these changes."""

    def shots(setting: Setting) -> Iterable[Shot]:
        for _ in range(count):
            shot = Shot(setting.scene, any_moment(setting))
            for change in changes:
                shot = change(setting, shot)
            yield shot

    return shots


# --- weather and light ------------------------------------------------------------------------------------------------


def fog(setting: Setting, shot: Shot) -> Shot:
    """From mist to a fog in which the far half of a span is gone: 1.3 km to 130 m of sight (3.9 / extinction)."""
    extinction = math.exp(setting.rng.uniform(math.log(0.003), math.log(0.03)))
    return replace(shot, moment=replace(shot.moment, fog_per_m=extinction))


def rain(setting: Setting, shot: Shot) -> Shot:
    """A shower, in half of the frames with drops on the lens."""
    rng = setting.rng
    lens: LensState = "drops" if rng.random() < 0.5 else "clear"
    fall, cloud = float(rng.uniform(0.2, 0.9)), float(rng.uniform(0.7, 1.0))
    return replace(shot, moment=replace(shot.moment, rain=fall, cloud=cloud, lens=lens))


def night(setting: Setting, shot: Shot) -> Shot:
    """From sunset to the dark, with the blur of a long exposure."""
    elevation = float(setting.rng.uniform(-8.0, 0.0))
    psf = shot.moment.psf_px + 0.03 * max(-elevation, 0.0)
    return replace(shot, moment=replace(shot.moment, sun_elevation_deg=elevation, psf_px=psf), fair=False)


def glare(setting: Setting, shot: Shot) -> Shot:
    """A low sun in the picture or just beside it."""
    rng = setting.rng
    azimuth = setting.survey.camera.azimuth_deg + float(rng.uniform(-25.0, 25.0))
    return replace(
        shot,
        moment=replace(
            shot.moment,
            sun_azimuth_deg=azimuth % 360,
            sun_elevation_deg=float(rng.uniform(3.0, 22.0)),
            cloud=float(rng.uniform(0.0, 0.4)),
            glare=float(rng.uniform(0.2, 0.8)),
        ),
    )


def sunlit(setting: Setting, shot: Shot) -> Shot:
    """A clear day with a sun that lights one side of the wires."""
    rng = setting.rng
    elevation, cloud = float(rng.uniform(8.0, 40.0)), float(rng.uniform(0.0, 0.3))
    return replace(shot, moment=replace(shot.moment, sun_elevation_deg=elevation, cloud=cloud))


def strong_clouds(setting: Setting, shot: Shot) -> Shot:
    """Towering clouds: edges as strong as a wire, dark and bright beside each other."""
    rng = setting.rng
    cloud, contrast = float(rng.uniform(0.35, 0.75)), float(rng.uniform(2.0, 3.5))
    return replace(shot, moment=replace(shot.moment, cloud=cloud, cloud_contrast=contrast))


# --- the wires --------------------------------------------------------------------------------------------------------


def windy(span: Span, _rng: Generator) -> Span:
    """A site where swings of 30° happen, and whose survey says so (17.3° is the deviation of an even draw to ±30°)."""
    swing = Swing(max_deg=35.0, prior_u_deg=17.3, questionable_deg=span.swing.questionable_deg)
    return span.model_copy(update={"swing": swing})


def wind(setting: Setting, shot: Shot) -> Shot:
    """All conductors swung by the same wind, anywhere up to 30° to either side."""
    angle = float(setting.rng.uniform(-30.0, 30.0))
    wires = {
        name: replace(state, swing_deg=angle * float(setting.rng.uniform(0.93, 1.07)))
        for name, state in shot.moment.wires.items()
    }
    return replace(shot, moment=replace(shot.moment, wires=wires))


def _loaded(setting: Setting, shot: Shot, load: Callable[[Generator], Load]) -> Shot:
    measured = {c.id for c in setting.survey.conductors if c.measured}
    wires = {
        name: replace(state, loads=(load(setting.rng),)) if name in measured else state
        for name, state in shot.moment.wires.items()
    }
    return replace(shot, moment=replace(shot.moment, wires=wires))


def partial_ice(setting: Setting, shot: Shot) -> Shot:
    """Ice on a stretch of every conductor: a fifth to two thirds of the span, 0.2 to 1.5 times its own weight."""

    def load(rng: Generator) -> Load:
        length = rng.uniform(0.2, 0.65)
        start = rng.uniform(0.0, 1.0 - length)
        ratio = rng.uniform(0.2, 1.5)
        return PartialLoad(float(start), float(start + length), float(ratio), float(0.012 * ratio))

    return _loaded(setting, shot, load)


def point_load(setting: Setting, shot: Shot) -> Shot:
    """A weight somewhere on every conductor: 2 to 15 % of the weight of the whole span."""

    def load(rng: Generator) -> Load:
        return PointLoad(float(rng.uniform(0.15, 0.85)), float(rng.uniform(0.02, 0.15)), 0.5)

    return _loaded(setting, shot, load)


def bundled(count: int) -> Callable[[Span, Generator], Span]:
    """Every measured conductor a bundle, 0.4 m from one sub-conductor to the next."""

    def survey(span: Span, _rng: Generator) -> Span:
        conductors = tuple(
            c.model_copy(update={"sub_conductors": count, "bundle_spacing_m": 0.4}) if c.measured else c
            for c in span.conductors
        )
        return span.model_copy(update={"conductors": conductors})

    return survey


def unequal_heights(span: Span, rng: Generator) -> Span:
    """One end up to 25 m higher than the other."""
    return raised(span, float(rng.uniform(-25.0, 25.0)))


def day(setting: Setting) -> Iterable[Shot]:
    """Six frames from 3 to 21 h of a day: temperature, load, sun and wind make sag and swing; a shower may pass."""
    rng = setting.rng
    begin = float(rng.uniform(8.0, 17.0))
    shower = Spell((begin, begin + 1.5), rain=float(rng.uniform(0.2, 0.7)), cloud=0.95)
    plan = DayPlan(
        cloud=float(rng.uniform(0.1, 0.8)),
        wind_m_s=float(rng.uniform(1.0, 7.0)),
        focal_px=setting.scene.intrinsics.fx,
        spells=(shower,) if rng.random() < 0.5 else (),
    )
    date = datetime(2026, 1, 15, 3, tzinfo=UTC) + timedelta(days=float(np.floor(rng.uniform(0.0, 350.0))))
    times = [date + timedelta(hours=3 * k + float(rng.uniform(0.0, 3.0))) for k in range(6)]
    for moment in day_of_moments(setting.scene.true, plan, times, int(rng.integers(2**31))):
        yield Shot(setting.scene, moment, fair=moment.sun_elevation_deg > 0)


def same_again(count: int) -> Callable[[Setting], Iterable[Shot]]:
    """Frames of the same moment, which differ by noise alone."""

    def shots(setting: Setting) -> Iterable[Shot]:
        moment = any_moment(setting)
        for _ in range(count):
            yield Shot(setting.scene, replace(moment, seed=int(setting.rng.integers(2**31))))

    return shots


def small_steps(count: int, step_m: float) -> Callable[[Setting], Iterable[Shot]]:
    """Frames of one weather whose sags differ by steps of some centimetres, while the camera sways as ever."""

    def shots(setting: Setting) -> Iterable[Shot]:
        rng, moment = setting.rng, any_moment(setting)
        for _ in range(count):
            wires = {
                name: replace(state, sag_m=state.sag_m + float(rng.normal(0.0, step_m)))
                for name, state in moment.wires.items()
            }
            turn = setting.view.sway_px / setting.scene.intrinsics.fx * rng.standard_normal(3)
            x, y, z = (float(t) for t in turn)
            yield Shot(setting.scene, replace(moment, wires=wires, turn_rad=(x, y, z), seed=int(rng.integers(2**31))))

    return shots


# --- the camera -------------------------------------------------------------------------------------------------------


def moved(low_px: float, high_px: float) -> Change:
    """The camera turned by so many pixels in some direction, with a little roll."""

    def change(setting: Setting, shot: Shot) -> Shot:
        rng = setting.rng
        amount, direction = rng.uniform(low_px, high_px), rng.uniform(0.0, 2 * math.pi)
        x, y = amount * np.array([math.cos(direction), math.sin(direction)]) / setting.scene.intrinsics.fx
        turn = (float(x), float(y), float(0.2 * math.hypot(x, y) * rng.standard_normal()))
        fair = bool(amount < 0.9 * setting.survey.camera.max_movement_px)
        return replace(shot, moment=replace(shot.moment, turn_rad=turn), fair=fair)

    return change


# --- what stands around -----------------------------------------------------------------------------------------------


def treeline(world: World, _span: Span, view: View, rng: Generator) -> World:
    """A forest so high that the wires are seen before it, from the tower wholly."""
    return replace(world, forest_m=float(rng.uniform(*view.forest_m)), horizon_m=view.forest_away_m)


def new_wires(world: World, _span: Span, _view: View, rng: Generator) -> World:
    """Wires from weathered to new, which are as bright as clouds."""
    return replace(world, wire_tone=float(rng.uniform(1.0, 2.5)))


def crossed(world: World, span: Span, _view: View, rng: Generator) -> World:
    """A world with :func:`crossing_line`."""
    return crossing_line(world, span, rng)


def crossing_line(world: World, span: Span, rng: Generator) -> World:
    """Another line of two or three wires that crosses the span, above or below it; the survey does not know it."""
    frame = SpanFrame.of(span)
    heights = [z for c in span.conductors if c.measured for z in (c.near[2], c.far[2])]
    place = float(rng.uniform(0.2, 0.8)) * frame.length
    angle = math.radians(float(rng.uniform(50.0, 130.0)))
    level = max(heights) + float(rng.uniform(2.0, 8.0)) if rng.random() < 0.6 else 0.45 * min(heights)
    direction = np.array([math.cos(angle), math.sin(angle)])
    sag = float(rng.uniform(0.5, 3.0))
    wires = []
    for _ in range(int(rng.integers(2, 4))):
        ends = [np.array([place, 0.0]) + side * float(rng.uniform(70.0, 110.0)) * direction for side in (-1, 1)]
        near, far = (frame.to_site(np.array([*end, level])) for end in ends)
        wires.append(OtherWire(tuple(near.tolist()), tuple(far.tolist()), sag, float(rng.uniform(0.010, 0.022))))
        level += float(rng.uniform(0.8, 2.0))
        place += float(rng.uniform(0.0, 1.5))
    return replace(world, other_wires=(*world.other_wires, *wires))


def occluded(setting: Setting, shot: Shot) -> Shot:
    """Crowns and branches that hide 20 to 40 % of what is in the picture of one conductor, grown since the survey."""
    rng, scene = setting.rng, shot.scene
    measured = [c for c in scene.true.conductors if c.measured]
    conductor = measured[int(rng.integers(len(measured)))]
    s = np.linspace(0.0, 1.0, 2001)
    points = wire_points(np.array(conductor.near), np.array(conductor.far), shot.moment.wires[conductor.id], s)
    pixels, depth = project(scene.intrinsics, scene.pose_at(shot.moment), points)
    seen = inside(scene.intrinsics, pixels)
    points, pixels, depth = points[seen], pixels[seen], depth[seen]
    # seen along the line a crown may hide a second stretch behind the one that it is meant for
    for _ in range(100):
        length = int(rng.uniform(0.05, 0.4) * len(points))
        first = int(rng.integers(0, len(points) - length))
        middles, radius = _row(pixels[first : first + length])
        apart = np.hypot(*(pixels[:, None] - pixels[first + middles][None]).transpose(2, 0, 1))
        if 0.2 <= np.mean(apart.min(axis=1) < radius) <= 0.4:
            break
    trees = [_crown(setting, points[k], float(depth[k]), 2 * radius) for k in first + middles]
    return replace(shot, scene=replace(scene, world=replace(scene.world, trees=(*scene.world.trees, *trees))))


def _row(pixels: FloatArray) -> tuple[NDArray[np.intp], float]:
    """Where along a stretch of a curve (N, 2) crowns stand so close that they hide it, and their radius in px."""
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    radius = max(3.0, float(arc[-1]) / 16)
    places = np.linspace(0.0, arc[-1], max(2, int(np.ceil(arc[-1] / radius)) + 1))
    return np.searchsorted(arc, places).clip(0, len(pixels) - 1), radius


def _crown(setting: Setting, point: FloatArray, depth: float, across_px: float) -> Tree:
    """A crown between the camera and a point of a wire."""
    scene, rng = setting.scene, setting.rng
    frame, focal = SpanFrame.of(scene.true), scene.intrinsics.fx
    camera = scene.pose.position
    away = min(float(rng.uniform(0.3, 0.7)) * depth, 2.4 * focal / across_px)
    size = across_px * away / focal * float(rng.uniform(1.0, 1.15))
    place = frame.to_span(camera + (point - camera) * away / depth)
    ground = float(np.interp(place[0], *np.array(scene.true.ground.profile).T))
    return Tree(
        along_m=float(place[0]),
        across_m=float(place[1]),
        height_m=size,
        width_m=size,
        tone=float(rng.uniform(44.0, 74.0)),
        base_m=float(place[2]) - size / 2 - ground,
    )


# --- what must not be told --------------------------------------------------------------------------------------------

NEGATIVES = {
    "no wires": "the conductors are not there",
    "neighbours only": "none of the measured conductors is there; earth wire and a crossing line are",
    "one missing": "the first measured conductor is not there, its neighbours are",
    "covered": "a hand over the lens",
    "fogged": "the lens is fogged",
    "dense fog": "one sees 26 m far, and no more than a tenth of the span",
    "night": "sun 30° below the horizon",
    "turned away": "the camera looks 25° elsewhere",
}
_OUTDOORS_ONLY = {"dense fog", "night", "neighbours only"}


def negatives(setting: Setting) -> Iterable[Shot]:
    """One frame of every kind in which conductors cannot be seen."""
    for kind in NEGATIVES:
        if setting.view.outdoors or kind not in _OUTDOORS_ONLY:
            yield _negative(kind, setting, Shot(setting.scene, any_moment(setting), kind))


def _negative(kind: str, setting: Setting, shot: Shot) -> Shot:
    measured = [c.id for c in setting.survey.conductors if c.measured]
    moment, scene = shot.moment, shot.scene
    unseen = frozenset(measured[:1] if kind == "one missing" else measured)
    if kind == "no wires":
        moment = replace(moment, draw_wires=False)
    elif kind in ("one missing", "neighbours only"):
        moment = replace(moment, wires={k: v for k, v in moment.wires.items() if k not in unseen})
        if kind == "neighbours only":
            scene = replace(scene, world=crossing_line(scene.world, setting.survey, setting.rng))
    elif kind in ("covered", "fogged"):
        moment = replace(moment, lens="covered" if kind == "covered" else "fogged")
    elif kind == "dense fog":
        # a sight of 3.9 over the extinction
        moment = replace(moment, fog_per_m=max(0.15, 39.0 / SpanFrame.of(setting.survey).length))
    elif kind == "night":
        moment = replace(moment, sun_elevation_deg=-30.0)
    else:
        x, y, z = moment.turn_rad
        moment = replace(moment, turn_rad=(x, y + math.radians(25.0), z))
    return replace(shot, scene=scene, moment=moment, unseen=unseen)
