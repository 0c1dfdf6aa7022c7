"""Trials: a picture of the paper's laboratory or field with what the survey says and what is true.

In the laboratory of the scene generator two cords hang one above the other, 2.5 m before the camera; the lower one is
measured, as the paper's "inner line", the upper one stands for its "upper line". The ground is far below, not the
paper's 18 and 21 cm: errors of the clearance do not depend on that, and are told in centimetres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from presets import View, preset, preset_scene, preset_world, typical_states
from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.port import GreyImage
from sagnode.config.span import Span
from sagnode.geometry.camera import Intrinsics, inside, project
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene
from sagnode.scene.truth import true_quantities

LAB_VIEWS: tuple[View, ...] = ("lab", "lab45")
LAB_SAGS_M = (0.15, 0.40)
"""Within the top quadrants of the frontal view."""
FIELD_SAG_M = 8.48
"""Leaves the paper's 6.39 m of clearance at mid-span."""
FIELD_SWING_U_DEG = 2.0
"""Sway in a wind of 20 km/h."""
FIELD_WIDTH_PX = 1456
"""The field is measured on a sensor of this width too, for the number of trials: 12 megapixels take long to draw."""


@dataclass(frozen=True)
class Trial:
    """One picture, the measured conductor's truth, and the survey that all methods are given."""

    name: str
    span: Span
    image: GreyImage
    conductor: str
    truth: dict[str, float]


def lab_trials(
    view: View,
    count: int,
    folder: Path,
    *,
    errors: float = 0.0,
    lens: Intrinsics | None = None,
    same: bool = False,
    seed: int = 1,
) -> Iterator[Trial]:
    """Pictures of the laboratory.

    Args:
        view: ``lab`` (frontal) or ``lab45``.
        count: how many.
        folder: for calibration and reference pictures.
        errors: scale of the survey's errors; 0 for a perfect survey, 1 for errors of the stated uncertainties.
        lens: in place of the paper's.
        same: one world and one sag, only the noise differs.
        seed: of everything random.
    """
    rng = np.random.default_rng([seed, LAB_VIEWS.index(view)])
    scene: Scene | None = None
    states: dict[str, WireState] = {}
    for number in range(count):
        if scene is None or (errors and not same):
            scene = _scene(view, int(rng.integers(1, 2**31)), errors, lens)
            survey = _surveyed(scene, lens or preset(view)[1], folder, f"{view}-{seed}-{errors:g}-{number}")
        if not states or not same:
            sag = float(rng.uniform(*LAB_SAGS_M))
            states = {"left": WireState(sag), "upper": WireState(float(np.clip(sag + rng.normal(0, 0.03), 0.12, 0.45)))}
        moment = Moment(states, fog_per_m=0.0, seed=int(rng.integers(1, 2**31)))
        yield _trial(f"{view}-{number}", scene, survey, moment, "left")


def field_trials(count: int, folder: Path, *, errors: float = 0.0, width: int = 0, seed: int = 1) -> Iterator[Trial]:
    """Pictures of the field site, every one with 6.39 m of clearance if the survey is perfect.

    Args:
        count: how many.
        folder: for calibration and reference pictures.
        errors: scale of the survey's errors.
        width: of the sensor with the same field of view, px; 0 for the preset's 4056.
        seed: of everything random.
    """
    rng = np.random.default_rng([seed, 9])
    lens = _scaled(preset("field")[1], width) if width else preset("field")[1]
    for number in range(count):
        scene = _scene("field", int(rng.integers(1, 2**31)), errors, lens)
        survey = _surveyed(scene, lens, folder, f"field-{width}-{seed}-{number}")
        swing = float(rng.normal(0, FIELD_SWING_U_DEG))
        states = {c.id: WireState(FIELD_SAG_M, swing) for c in scene.true.conductors}
        # "overcast sky with diffuse lighting"
        moment = Moment(states, cloud=0.95, sun_elevation_deg=35.0, seed=int(rng.integers(1, 2**31)))
        yield _trial(f"field-{number}", scene, survey, moment, "L1")


def _scene(view: View, seed: int, errors: float, lens: Intrinsics | None) -> Scene:
    scene = preset_scene(view, seed, errors)
    if lens is None:
        return scene
    # another lens: the landmarks are where it shows them
    true_lens = replace(lens) if not errors else replace(lens, fx=lens.fx * scene.intrinsics.fx / preset(view)[1].fx)
    pixels, _ = project(true_lens, scene.pose, np.array([m.position for m in scene.true.landmarks]))
    noise = np.random.default_rng(seed).standard_normal(pixels.shape) * errors
    clicked = pixels + noise * np.array([[m.pixel_u_px] for m in scene.surveyed.landmarks])
    marks = tuple(
        m.model_copy(update={"pixel": (round(float(u), 2), round(float(v), 2))})
        for m, (u, v) in zip(scene.surveyed.landmarks, clicked, strict=True)
    )
    return Scene(
        scene.surveyed.model_copy(update={"landmarks": marks}), scene.true, true_lens, preset_world(view), scene.seed
    )


def _surveyed(scene: Scene, lens: Intrinsics, folder: Path, name: str) -> Span:
    """The survey with its calibration file and a reference picture of the true world."""
    folder.mkdir(parents=True, exist_ok=True)
    calibration, reference = folder / f"{name}.yaml", folder / f"{name}.png"
    save_intrinsics(calibration, lens)
    calm = Moment(typical_states(scene.true), fog_per_m=0.0, cloud=0.2, seed=1)
    cv2.imwrite(str(reference), render(scene, calm).image)
    seen = inside(lens, np.array([m.pixel for m in scene.surveyed.landmarks]), 2.0)
    marks = tuple(m for m, ok in zip(scene.surveyed.landmarks, seen, strict=True) if ok)
    camera = scene.surveyed.camera.model_copy(update={"intrinsics": calibration, "reference_image": reference})
    return scene.surveyed.model_copy(update={"landmarks": marks, "camera": camera})


def _trial(name: str, scene: Scene, survey: Span, moment: Moment, conductor: str) -> Trial:
    true = next(c for c in scene.true.conductors if c.id == conductor)
    truth = true_quantities(scene.true, true, moment.wires[conductor])
    return Trial(name, survey, render(scene, moment).image, conductor, truth)


def _scaled(lens: Intrinsics, width: int) -> Intrinsics:
    factor = width / lens.width
    return replace(
        lens,
        width=width,
        height=round(lens.height * factor),
        fx=lens.fx * factor,
        fy=lens.fy * factor,
        cx=(lens.cx + 0.5) * factor - 0.5,
        cy=(lens.cy + 0.5) * factor - 0.5,
    )
