"""Worlds: one survey, and truths drawn anew from the standard uncertainties that it states.

A world is made as a technician would come to it: the true span differs from the survey by one draw of every stated
uncertainty, the true lens from the calibration likewise; a reference picture of the *true* world is taken, and the
landmarks are clicked in it with the stated click error. Everything after that is the public pipeline.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from sagnode.calibrate.files import load_intrinsics
from sagnode.config.span import Span
from sagnode.geometry.camera import inside, project
from sagnode.scene.catenary import WireState
from sagnode.scene.perturb import perturbed, perturbed_intrinsics
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene, World
from views import View


@dataclass(frozen=True)
class Setting:
    """A world ready for frames: the survey as the node gets it, and the scene that is true."""

    view: View
    survey: Span
    scene: Scene
    rng: np.random.Generator


@dataclass(frozen=True)
class Shot:
    """One frame to be taken in a world."""

    scene: Scene
    moment: Moment
    kind: str = ""
    """Of a negative: what is wrong with it."""
    unseen: frozenset[str] | None = None
    """Conductors that this frame must not tell; None where it is an ordinary frame."""
    fair: bool = True
    """Whether a reading is due wherever enough of the conductor can be seen."""


@dataclass(frozen=True)
class Group:
    """Worlds of one kind: a view, and what is different about it."""

    name: str
    what: str
    view: View
    worlds: int
    """How many are drawn for the report."""
    shots: Callable[[Setting], Iterable[Shot]]
    survey: Callable[[Span, np.random.Generator], Span] = lambda span, _rng: span
    world: Callable[[World, Span, View, np.random.Generator], World] = lambda world, _span, _view, _rng: world
    paper: int = 0
    """In how many of the worlds the paper's methods measure too."""
    sequence: bool = False
    """Frames of one world differ in little, and are compared with each other."""


def settle(group: Group, seed: int, index: int, folder: Path) -> Setting:
    """Draw a world, take its reference picture into ``folder`` and click the landmarks."""
    rng = np.random.default_rng([seed, zlib.crc32(group.name.encode()), index])
    surveyed = group.survey(group.view.survey(folder), rng)
    stated = load_intrinsics(surveyed.camera.intrinsics)
    true = perturbed(surveyed, rng)
    lens = perturbed_intrinsics(stated, surveyed, rng)
    world = group.world(group.view.world, surveyed, group.view, rng)
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
    clicked = tuple(
        mark.model_copy(update={"pixel": (round(float(p[0]), 1), round(float(p[1]), 1))})
        for mark, p in zip(surveyed.landmarks, pixels, strict=True)
        if inside(lens, p, 2.0)
    )
    camera = surveyed.camera.model_copy(update={"reference_image": file})
    survey = surveyed.model_copy(update={"landmarks": clicked, "camera": camera})
    return Setting(group.view, survey, replace(scene, surveyed=survey), rng)


def any_moment(setting: Setting) -> Moment:
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
    turn = setting.view.sway_px / setting.scene.intrinsics.fx * rng.standard_normal(3)
    moment = Moment(wires, turn_rad=(float(turn[0]), float(turn[1]), float(turn[2])), seed=int(rng.integers(2**31)))
    if not setting.view.outdoors:
        return replace(moment, fog_per_m=0.0)
    return replace(
        moment,
        sun_azimuth_deg=float(rng.uniform(60, 300)),
        sun_elevation_deg=float(rng.uniform(8, 60)),
        cloud=float(rng.uniform(0, 1)),
        cloud_drift_m=(float(rng.uniform(-9e3, 9e3)), float(rng.uniform(-9e3, 9e3))),
        fog_per_m=float(np.exp(rng.uniform(math.log(8e-5), math.log(6e-4)))),
        psf_px=float(rng.uniform(0.65, 1.1)),
        rounded=1.0,
    )
