"""Worlds: one survey, and truths drawn anew from the standard uncertainties that it states.

A world is made as a technician would come to it: the true span differs from the survey by one draw of every stated
uncertainty, the true lens from the calibration likewise; a reference picture of the *true* world is taken, and the
landmarks are clicked in it with the stated click error. Everything after that is the public pipeline.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from sagnode.calibrate.files import load_intrinsics, save_intrinsics
from sagnode.config.load import load_span
from sagnode.config.span import Span
from sagnode.geometry.camera import inside, project
from sagnode.scene.catenary import WireState
from sagnode.scene.perturb import perturbed, perturbed_intrinsics
from sagnode.scene.presets import View, preset, preset_world
from sagnode.scene.render import render
from sagnode.scene.site import LANDMARK_KINDS, site_directory
from sagnode.scene.spec import Moment, Scene, World


@dataclass(frozen=True)
class Group:
    """A kind of view: a preset of the scene generator, or a span file with the world around it."""

    name: str
    what: str
    source: View | Path
    share: float
    """Worlds of this group for each one asked for: large frames are dear."""
    world: World = field(default_factory=World)
    outdoors: bool = True
    sway_px: float = 2.0
    paper: bool = False
    """Whether the paper's methods measure its frames too."""

    def survey(self, folder: Path) -> tuple[Span, World]:
        """The survey, its calibration file in place (in ``folder`` where a preset has none), and the world."""
        if isinstance(self.source, Path):
            return load_span(self.source).span, self.world
        span, intrinsics = preset(self.source)
        file = folder / "camera.yaml"
        save_intrinsics(file, intrinsics)
        camera = span.camera.model_copy(update={"intrinsics": file})
        return span.model_copy(update={"camera": camera}), preset_world(self.source)


GROUPS = (
    Group(
        "tower",
        "the demonstration's span: camera at tower 1, 5 m below the attachments, 1456x1088, f = 2050 px",
        site_directory() / "span.toml",
        1.0,
        World(landmark_kinds=LANDMARK_KINDS),
    ),
    Group("field", "the paper's 110 kV span through a long lens, 4056x3040, f = 15 300 px", "field", 0.1, sway_px=6.0),
    Group(
        "side",
        "from the side, 100 m off, 1456x1088, f = 1100 px, phases above each other",
        Path(__file__).parent / "sites/side/span.toml",
        0.4,
    ),
    Group("side200", "from the side, 200 m off, where the wires are 0.12 px wide", "side200", 0.05),
    Group("lab", "the paper's laboratory, frontal", "lab", 0.15, outdoors=False, sway_px=0.2, paper=True),
    Group("lab45", "the paper's laboratory at 45°", "lab45", 0.15, outdoors=False, sway_px=0.2, paper=True),
)


@dataclass(frozen=True)
class Setting:
    """A world ready for frames: the survey as the node gets it, and the scene that is true."""

    survey: Span
    scene: Scene
    rng: np.random.Generator


def settle(group: Group, seed: int, index: int, folder: Path) -> Setting:
    """Draw a world, take its reference picture into ``folder`` and click the landmarks."""
    surveyed, world = group.survey(folder)
    stated = load_intrinsics(surveyed.camera.intrinsics)
    rng = np.random.default_rng([seed, zlib.crc32(group.name.encode()), index])
    true = perturbed(surveyed, rng)
    lens = perturbed_intrinsics(stated, surveyed, rng)
    scene = Scene(surveyed, true, lens, world, seed=int(rng.integers(1, 2**31)))
    calm = Moment(
        wires={c.id: WireState(0.5 * (c.sag_min_m + c.sag_max_m)) for c in true.conductors},
        sun_azimuth_deg=120.0,
        cloud=0.2,
        seed=1,
    )
    file = folder / f"{group.name}-{index}.png"
    cv2.imwrite(str(file), render(scene, calm).image)
    pixels, _ = project(lens, scene.pose, np.array([m.position for m in true.landmarks]))
    pixels = pixels + rng.standard_normal(pixels.shape) * np.array([[m.pixel_u_px] for m in surveyed.landmarks])
    seen = inside(lens, pixels, 2.0)
    clicked = tuple(
        mark.model_copy(update={"pixel": (round(float(p[0]), 1), round(float(p[1]), 1))})
        for mark, p, ok in zip(surveyed.landmarks, pixels, seen, strict=True)
        if ok
    )
    camera = surveyed.camera.model_copy(update={"reference_image": file})
    survey = surveyed.model_copy(update={"landmarks": clicked, "camera": camera})
    return Setting(survey, replace(scene, surveyed=survey), rng)


def any_moment(group: Group, setting: Setting) -> Moment:
    """A moment in which the conductors can be seen, everything about it drawn at random.

    Sags are anywhere in the middle four fifths of the surveyed range, swings follow the stated prior, since an interval
    that leans on that prior can only be judged where the prior is true.
    """
    rng, span = setting.rng, setting.scene.true
    wind = rng.normal(0.0, span.swing.prior_u_deg)
    level = rng.uniform(0.1, 0.9)
    wires = {}
    for conductor in span.conductors:
        share = float(np.clip(level + rng.normal(0, 0.03), 0.02, 0.98))
        swing = float(
            np.clip(wind + 0.1 * abs(wind) * rng.normal(), -0.95 * span.swing.max_deg, 0.95 * span.swing.max_deg)
        )
        wires[conductor.id] = WireState(
            conductor.sag_min_m + share * (conductor.sag_max_m - conductor.sag_min_m), swing
        )
    turn = group.sway_px / setting.scene.intrinsics.fx * rng.standard_normal(3)
    moment = Moment(wires, turn_rad=(float(turn[0]), float(turn[1]), float(turn[2])), seed=int(rng.integers(2**31)))
    if not group.outdoors:
        return replace(moment, fog_per_m=0.0)
    return replace(
        moment,
        sun_azimuth_deg=float(rng.uniform(60, 300)),
        sun_elevation_deg=float(rng.uniform(8, 60)),
        cloud=float(rng.uniform(0, 1)),
        cloud_drift_m=(float(rng.uniform(-9e3, 9e3)), float(rng.uniform(-9e3, 9e3))),
        fog_per_m=float(np.exp(rng.uniform(math.log(8e-5), math.log(6e-4)))),
        psf_px=float(rng.uniform(0.65, 1.1)),
    )


NEGATIVES = {
    "no wires": "the conductors are not there",
    "one missing": "the first measured conductor is not there, its neighbours are",
    "covered": "a hand over the lens",
    "fogged": "the lens is fogged",
    "dense fog": "one sees 20 m far",
    "night": "sun 30° below the horizon",
    "turned away": "the camera looks 25° elsewhere",
}


def negative(kind: str, setting: Setting, moment: Moment) -> tuple[Moment, frozenset[str]]:
    """A moment in which a conductor cannot be seen, and which conductors that concerns."""
    measured = [c.id for c in setting.survey.conductors if c.measured]
    everything = frozenset(measured)
    if kind == "no wires":
        return replace(moment, draw_wires=False), everything
    if kind == "one missing":
        return replace(moment, wires={k: v for k, v in moment.wires.items() if k != measured[0]}), frozenset(
            measured[:1]
        )
    if kind == "covered":
        return replace(moment, lens="covered"), everything
    if kind == "fogged":
        return replace(moment, lens="fogged"), everything
    if kind == "dense fog":
        return replace(moment, fog_per_m=0.15), everything
    if kind == "night":
        return replace(moment, sun_elevation_deg=-30.0), everything
    x, y, z = moment.turn_rad
    return replace(moment, turn_rad=(x, y + math.radians(25.0), z)), everything
