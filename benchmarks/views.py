"""Views: a surveyed span with its camera, and what stands around it; every group of the suite has one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from presets import View as Preset
from presets import preset, preset_world
from sagnode.calibrate.files import load_intrinsics, save_intrinsics
from sagnode.config.base import Point
from sagnode.config.load import load_span
from sagnode.config.span import CameraSurvey, Landmark, Span
from sagnode.geometry.camera import Intrinsics
from sagnode.scene.site import LANDMARK_KINDS, site_directory
from sagnode.scene.spec import World

SITES = Path(__file__).parent / "sites"


@dataclass(frozen=True)
class View:
    """A span as surveyed and its camera."""

    name: str
    survey: Callable[[Path], Span]
    """The survey; its calibration is written into the folder where it has no file of its own."""
    world: World = field(default_factory=World)
    outdoors: bool = True
    sway_px: float = 2.0
    """Standard deviation of the camera's movement on an ordinary day."""
    forest_m: tuple[float, float] = (28.0, 40.0)
    """Height of a forest before which the wires are seen, or a part of them."""
    forest_away_m: float = 335.0


def _from_file(file: Path) -> Callable[[Path], Span]:
    return lambda _folder: load_span(file).span


def _from_preset(name: Preset) -> Callable[[Path], Span]:
    def survey(folder: Path) -> Span:
        span, intrinsics = preset(name)
        return _calibrated(span, intrinsics, folder)

    return survey


def _calibrated(span: Span, intrinsics: Intrinsics, folder: Path) -> Span:
    file = folder / "camera.yaml"
    save_intrinsics(file, intrinsics)
    return span.model_copy(update={"camera": span.camera.model_copy(update={"intrinsics": file})})


def _seen_from(
    span: Span, folder: Path, lens: Intrinsics, camera: dict[str, object], landmarks: dict[str, tuple[Point, float]]
) -> Span:
    """A span seen by another camera; landmarks by name are places and their standard uncertainty."""
    kept = {k: v for k, v in span.camera.model_dump().items() if k not in ("reference_image", *camera)}
    marks = tuple(
        Landmark(id=name, position=place, position_u_m=u, pixel=(0.0, 0.0), pixel_u_px=0.2, size_px=41)
        for name, (place, u) in landmarks.items()
    )
    moved = span.model_copy(update={"camera": CameraSurvey.model_validate(kept | camera), "landmarks": marks})
    return _calibrated(moved, lens, folder)


def _from_the_ground(folder: Path) -> Span:
    """The demonstration's span from beside tower 1, at a person's height, looking along the line."""
    span = load_span(site_directory() / "span.toml").span
    lens = load_intrinsics(span.camera.intrinsics)
    marks: dict[str, tuple[Point, float]] = {
        mark.id: (mark.position, mark.position_u_m) for mark in span.landmarks if not mark.id.startswith("target")
    }
    marks |= {
        "post-left": ((-6.4, 33.0, 2.4), 0.02),
        "post-right": ((13.6, 31.0, 2.3), 0.02),
        "mast-left": ((-12.5, 48.0, 16.5), 0.03),
        "mast-right": ((24.0, 52.0, 14.0), 0.03),
    }
    camera = {"position": (8.5, -17.0, 1.6), "azimuth_deg": -2.6, "elevation_deg": 4.5}
    return _seen_from(span, folder, lens, camera, marks)


def _from_the_side(distance: float, lens: Intrinsics, elevation_deg: float) -> Callable[[Path], Span]:
    """The span of ``sites/side`` from another distance, its targets moved to stand as they did in the picture."""

    def survey(folder: Path) -> Span:
        span = load_span(SITES / "side/span.toml").span
        nearer = distance / 100.0
        marks = {
            mark.id: ((mark.position[0] * nearer, *mark.position[1:]), mark.position_u_m) for mark in span.landmarks
        }
        camera = {"position": (-distance, 134.0, 1.8), "elevation_deg": elevation_deg}
        return _seen_from(span, folder, lens, camera, marks)

    return survey


def _phases_beside(folder: Path) -> Span:
    """The paper's 110 kV span from 80 m to its side and 2.5 m up, two of its phases beside each other."""
    span, _ = preset("side200")
    lens = Intrinsics(1456, 1088, 800.0, 800.0, 727.5, 543.5, (-0.04, 0.008, 0.0, 0.0, 0.0))
    marks: dict[str, tuple[Point, float]] = {
        mark.id: ((0.4 * mark.position[0], 134.85 + 0.55 * (mark.position[1] - 134.85), mark.position[2]), 0.03)
        for mark in span.landmarks
    }
    return _seen_from(span, folder, lens, {"position": (80.0, 134.85, 2.5), "elevation_deg": 5.0}, marks)


_WIDE = Intrinsics(1456, 1088, 540.0, 540.0, 727.5, 543.5, (-0.02, 0.002, 0.0, 0.0, 0.0))
_DEMO_WORLD = World(landmark_kinds=LANDMARK_KINDS)
_INDOORS = {"outdoors": False, "sway_px": 0.2}

VIEWS = {
    view.name: view
    for view in (
        View("lab", _from_preset("lab"), preset_world("lab"), **_INDOORS),
        View("lab45", _from_preset("lab45"), preset_world("lab45"), **_INDOORS),
        View("tower", _from_file(site_directory() / "span.toml"), _DEMO_WORLD),
        View("field", _from_preset("field"), sway_px=6.0),
        View("field-tower", _from_preset("tower")),
        View("ground", _from_the_ground, replace(_DEMO_WORLD, opening=0.085)),
        View("side50", _from_the_side(50.0, _WIDE, 12.0), forest_m=(7.0, 20.0), forest_away_m=75.0),
        View("side", _from_file(SITES / "side/span.toml"), forest_m=(8.0, 22.0), forest_away_m=150.0),
        View("side-beside", _phases_beside, forest_m=(8.0, 18.0), forest_away_m=130.0),
        View("side200", _from_preset("side200"), forest_m=(10.0, 20.0), forest_away_m=250.0),
    )
}


def raised(span: Span, rise_m: float) -> Span:
    """The span with its far end higher by ``rise_m``: everything is lifted in proportion to its distance along.

    The camera is tilted by half of the slope, so that both ends stay in the picture.
    """
    near, far = (np.mean([getattr(c, end) for c in span.conductors], axis=0) for end in ("near", "far"))
    chord = (far - near)[:2]
    length = float(np.hypot(*chord))

    def lift(point: Point) -> Point:
        x, y, z = point
        along = float((np.array([x, y]) - near[:2]) @ chord) / length
        return x, y, z + rise_m * along / length

    ground = span.ground.model_copy(
        update={
            "profile": tuple((along, z + rise_m * along / length) for along, z in span.ground.profile),
            "obstacles": tuple(
                o.model_copy(update={"height_m": o.height_m + rise_m * o.along_m[1] / length})
                for o in span.ground.obstacles
            ),
        }
    )
    tilt = float(np.degrees(np.arctan2(rise_m, length))) / 2
    return span.model_copy(
        update={
            "conductors": tuple(c.model_copy(update={"far": lift(c.far)}) for c in span.conductors),
            "ground": ground,
            "landmarks": tuple(m.model_copy(update={"position": lift(m.position)}) for m in span.landmarks),
            "camera": span.camera.model_copy(update={"elevation_deg": span.camera.elevation_deg + tilt}),
        }
    )
