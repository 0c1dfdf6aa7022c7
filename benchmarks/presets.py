"""Ready scenes: small ones for tests, and the views that tests and benchmarks are grouped by."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from sagnode.config.base import Pixel, Point
from sagnode.config.span import CameraSurvey, Conductor, Ground, Landmark, Span
from sagnode.geometry.camera import FloatArray, Intrinsics, project
from sagnode.scene.catenary import WireState
from sagnode.scene.noise import generator
from sagnode.scene.perturb import perturbed, perturbed_intrinsics
from sagnode.scene.spec import LandmarkKind, Moment, Scene, World, survey_pose

View = Literal["lab", "lab45", "field", "tower", "side200"]
VIEWS: tuple[View, ...] = ("lab", "lab45", "field", "tower", "side200")

LAB_CAMERA = Intrinsics(960, 540, 691.634, 686.796, 468.717, 270.928, (0.0089, 0.0156, 0.0002, 0.0001, 0.0023))
"""The laboratory camera of Abed, Trabelsi and Derbel (Energies 18(21) 5767, §3.3.3 and §3.3.4)."""


def preset(view: View) -> tuple[Span, Intrinsics]:
    """Span (as surveyed, landmarks clicked without error) and intrinsics of a benchmark view.

    ``lab``: a 2.7 m span, frontal from 2.5 m; ``lab45``: the same from 45 degrees; ``field``: the paper's 110 kV span
    through a long lens, 2 m before tower 1; ``tower``: that span from tower 1 with a short lens, 5 m below the
    attachments; ``side200``: that span from 200 m to its side.
    """
    if view in ("lab", "lab45"):
        return _lab(turned=view == "lab45")
    if view == "field":
        lens = Intrinsics(4056, 3040, 15300.0, 15300.0, 2027.5, 1519.5, (-0.02, 0.0, 0.0, 0.0, 0.0))
        return _span_110kv("field", (0.9, 2.0, 9.6), (0.15, 0.55), lens)
    if view == "tower":
        lens = Intrinsics(1456, 1088, 1739.0, 1739.0, 727.5, 543.5, (-0.09, 0.05, 0.0, 0.0, 0.0))
        return _span_110kv("tower", (0.6, 0.85, 9.8), (0.5, 1.5), lens)
    lens = Intrinsics(1456, 1088, 1100.0, 1100.0, 727.5, 543.5, (-0.05, 0.01, 0.0, 0.0, 0.0))
    return _span_110kv("side200", (200.0, 134.85, 2.5), (-90.0, 3.0), lens)


def preset_world(view: View) -> World:
    """What stands around a preset's span."""
    if view in ("lab", "lab45"):
        return World("textured", target_side_m=0.09, towers=False, plain_grey=190.0)
    return World()


def preset_scene(view: View, seed: int = 1, error_scale: float = 0.0) -> Scene:
    """The scene of a preset.

    Args:
        view: which.
        seed: of the world and of the survey's errors.
        error_scale: 0 for a perfect survey, 1 for errors of the stated uncertainties.
    """
    span, intrinsics = preset(view)
    rng = generator(seed, "errors")
    true = perturbed(span, rng, error_scale)
    lens = perturbed_intrinsics(intrinsics, span, rng, error_scale)
    scene = Scene(span, true, lens, preset_world(view), seed)
    return with_clicks(scene, rng, error_scale) if error_scale else scene


def with_clicks(scene: Scene, rng: np.random.Generator, scale: float = 1.0) -> Scene:
    """The scene whose survey has its landmarks clicked in a picture of the true world, with errors of a click."""
    points = np.array([m.position for m in scene.true.landmarks]).reshape(-1, 3)
    pixels, _ = project(scene.intrinsics, scene.pose, points)
    noise = scale * rng.standard_normal(pixels.shape)
    clicks = pixels + noise * np.array([[m.pixel_u_px] for m in scene.surveyed.landmarks])
    surveyed = scene.surveyed.model_copy(update={"landmarks": _moved_pixels(scene.surveyed.landmarks, clicks)})
    return Scene(surveyed, scene.true, scene.intrinsics, scene.world, scene.seed)


def typical_states(span: Span, swing_deg: float = 0.0) -> dict[str, WireState]:
    """Every conductor of a span in the middle of its possible sags."""
    return {c.id: WireState((c.sag_min_m + c.sag_max_m) / 2, swing_deg) for c in span.conductors}


def simple_scene(
    sags_m: Mapping[str, float] | None = None,
    swing_deg: float = 0.0,
    *,
    backdrop: Literal["plain", "textured", "country"] = "textured",
    width: int = 640,
    height: int = 480,
    seed: int = 1,
    error_scale: float = 0.0,
    landmark_kinds: Mapping[str, LandmarkKind] | None = None,
) -> tuple[Scene, Moment]:
    """A small scene that renders in some hundredths of a second: two conductors, 60 m, six survey targets.

    Args:
        sags_m: by conductor id (``L1`` left, ``L2`` right); default 1.9 m and 2.1 m.
        swing_deg: of both.
        backdrop: what is behind them.
        width: of the frame, px; the lens scales with it.
        height: of the frame, px.
        seed: of world, errors and noise.
        error_scale: 0 for a perfect survey, 1 for errors of the stated uncertainties.
        landmark_kinds: as in :class:`World`.
    """
    lens = Intrinsics(width, height, 1.15 * width, 1.15 * width, width / 2 - 0.7, height / 2 + 0.4, (-0.06, 0.02))
    marks: dict[str, Point] = {
        "m1": (-7.5, 30.0, 1.5),
        "m2": (8.0, 33.0, 1.8),
        "m3": (-3.0, 24.0, 1.2),
        "m4": (3.4, 26.0, 9.0),
        "m5": (-9.0, 38.0, 9.5),
        "m6": (11.0, 45.0, 7.0),
    }
    conductors = tuple(
        Conductor(
            id=name,
            near=(x, 0.0, 8.0),
            far=(x, 60.0, 8.4),
            attachment_u_m=0.02,
            diameter_m=0.02,
            unit_weight_n_m=9.6,
            sag_min_m=1.0,
            sag_max_m=3.2,
        )
        for name, x in (("L1", -2.6), ("L2", 2.4))
    )
    span = Span(
        name="simple",
        conductors=conductors,
        ground=Ground(profile=((0.0, 0.0), (25.0, 0.4), (60.0, 0.2)), height_u_m=0.03),
        camera=_survey((0.3, 0.6, 5.2), (0.0, 1.0), position_u=0.02, angle_u=0.3),
        landmarks=_landmarks(marks, lens, (0.3, 0.6, 5.2), (0.0, 1.0), u=0.02, size=25),
    )
    rng = generator(seed, "errors")
    true = perturbed(span, rng, error_scale)
    camera = perturbed_intrinsics(lens, span, rng, error_scale)
    world = World(backdrop, landmark_kinds=dict(landmark_kinds or {}), towers=False)
    scene = with_clicks(Scene(span, true, camera, world, seed), rng, error_scale)
    sags = {"L1": 1.9, "L2": 2.1} if sags_m is None else sags_m
    return scene, Moment({name: WireState(sag, swing_deg) for name, sag in sags.items()}, cloud=0.2, seed=seed)


def _survey(
    position: Point, angles: tuple[float, float], *, position_u: float, angle_u: float, focal_u: float = 0.001
) -> CameraSurvey:
    return CameraSurvey(
        position=position,
        position_u_m=position_u,
        azimuth_deg=angles[0],
        elevation_deg=angles[1],
        orientation_u_deg=angle_u,
        intrinsics=Path("camera.yaml"),
        focal_u_rel=focal_u,
    )


def _landmarks(
    places: Mapping[str, Point], lens: Intrinsics, position: Point, angles: tuple[float, float], *, u: float, size: int
) -> tuple[Landmark, ...]:
    """Landmarks with the pixels of a perfect click."""
    names = list(places)
    blank = tuple(Landmark(id=n, position=places[n], position_u_m=u, pixel=(0.0, 0.0), size_px=size) for n in names)
    dummy = Span(
        name="clicks",
        conductors=(
            Conductor(id="c", near=(0, 0, 1e3), far=(0, 9, 1e3), diameter_m=0.01, sag_min_m=0.1, sag_max_m=0.2),
        ),
        ground=Ground(profile=((0.0, 0.0), (1.0, 0.0))),
        camera=_survey(position, angles, position_u=0.0, angle_u=1.0),
    )
    pixels, _ = project(lens, survey_pose(dummy), np.array([places[n] for n in names]))
    return _moved_pixels(blank, pixels)


def _moved_pixels(landmarks: tuple[Landmark, ...], pixels: FloatArray) -> tuple[Landmark, ...]:
    clicks: list[Pixel] = [(round(float(u), 2), round(float(v), 2)) for u, v in pixels]
    return tuple(m.model_copy(update={"pixel": c}) for m, c in zip(landmarks, clicks, strict=True))


def _lab(*, turned: bool) -> tuple[Span, Intrinsics]:
    """The paper's laboratory: two cords between stands, the camera 2.5 m before the middle."""
    angle = np.radians(45.0 if turned else 0.0)
    position = (float(2.5 * np.cos(angle)), float(1.35 - 2.5 * np.sin(angle)), 1.25)
    azimuth = -90.0 + float(np.degrees(angle))
    places: dict[str, Point] = {
        "m1": (-0.30, 0.05, 1.80),
        "m2": (-0.30, 2.45, 1.90),
        "m3": (-0.25, 0.35, 0.75),
        "m4": (-0.25, 2.30, 0.72),
        "m5": (-0.40, 1.30, 0.62),
        "m6": (-0.35, 1.45, 2.02),
    }
    conductors = tuple(
        Conductor(
            id=name,
            near=(0.0, 0.0, z),
            far=(0.0, 2.7, z + 0.01),
            attachment_u_m=0.001,
            diameter_m=0.004,
            sag_min_m=0.10,
            sag_max_m=0.55,
            measured=name == "left",
        )
        for name, z in (("left", 1.70), ("upper", 1.92))
    )
    span = Span(
        name="lab45" if turned else "lab",
        conductors=conductors,
        ground=Ground(profile=((0.0, 0.0), (2.7, 0.0)), height_u_m=0.001),
        camera=_survey(position, (azimuth, 0.0), position_u=0.003, angle_u=0.3, focal_u=0.003),
        landmarks=_landmarks(places, LAB_CAMERA, position, (azimuth, 0.0), u=0.001, size=25),
    )
    return span, LAB_CAMERA


def _span_110kv(name: str, position: Point, angles: tuple[float, float], lens: Intrinsics) -> tuple[Span, Intrinsics]:
    """The paper's 110 kV span: 269.7 m, 0.83 m rise, three conductors; 8.42 m of sag leave some 6.4 m of clearance."""
    places: dict[str, Point] = {
        "far-left": (-4.0, 269.7, 16.93),
        "far-right": (4.0, 269.7, 16.93),
        "far-top": (3.6, 269.7, 20.93),
        "mid-left": (-3.4, 150.0, 3.0),
        "mid-right": (4.6, 158.0, 3.2),
        "low-left": (-2.1, 93.0, 3.9),
        "low-right": (3.2, 99.0, 4.0),
        "mast": (4.9, 122.0, 12.5),
    }
    if name == "tower":
        places = {k: p for k, p in places.items() if k.startswith("far")} | {
            "target-left": (-11.2, 52.4, 2.4),
            "target-right": (13.1, 58.7, 2.8),
            "target-middle": (1.8, 74.3, 2.6),
            "mast-left": (-15.6, 61.0, 15.0),
            "mast-right": (22.0, 71.0, 10.5),
        }
    if name == "side200":
        places = {
            "right": (120.0, 180.0, 3.0),
            "left": (120.0, 88.0, 3.2),
            "middle": (90.0, 134.0, 2.0),
            "mast-right": (100.0, 192.0, 16.0),
            "mast-left": (100.0, 78.0, 16.0),
            "mast-middle": (110.0, 142.0, 18.0),
            "low-right": (150.0, 162.0, 0.9),
            "low-left": (150.0, 108.0, 0.9),
        }
    heights = {"L1": (-4.0, 14.8), "L2": (4.0, 14.8), "L3": (3.6, 18.8)}
    conductors = tuple(
        Conductor(
            id=phase,
            phase=phase,
            near=(x, 0.0, z),
            far=(x, 269.7, z + 0.83),
            attachment_u_m=0.05,
            diameter_m=0.0218,
            unit_weight_n_m=9.61,
            sag_min_m=5.5,
            sag_max_m=11.5,
        )
        for phase, (x, z) in heights.items()
    )
    span = Span(
        name=name,
        conductors=conductors,
        ground=Ground(profile=((0.0, 0.0), (120.0, 0.2), (150.0, 0.5), (269.7, 0.83)), height_u_m=0.05),
        camera=_survey(position, angles, position_u=0.05, angle_u=0.3),
        landmarks=_landmarks(places, lens, position, angles, u=0.03, size=33),
    )
    return span, lens
