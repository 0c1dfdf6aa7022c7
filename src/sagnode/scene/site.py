"""The demonstration's scene: what stands at ``sagnode/demo/site``, and the day that its frames show.

``span.toml`` is the survey and the source of every position. The true world differs from it by one draw of the stated
uncertainties (``SURVEY_SEED``); the landmarks' pixels in ``span.toml`` were clicked in the reference picture of that
true world, with click errors drawn for it (:func:`clicked`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path

import numpy as np

from sagnode.calibrate.files import load_intrinsics
from sagnode.config.base import Pixel
from sagnode.config.span import Span
from sagnode.errors import ConfigError, SagnodeError
from sagnode.geometry.camera import project
from sagnode.scene.catenary import WireState
from sagnode.scene.day import DayPlan, Spell, day_of_moments, sag_at_temperature, sun_position
from sagnode.scene.noise import generator
from sagnode.scene.perturb import perturbed, perturbed_intrinsics
from sagnode.scene.render import render
from sagnode.scene.spec import LandmarkKind, Moment, Scene, World
from sagnode.scene.writer import encoded, write_day

WORLD_SEED = 20260621
"""Of the surroundings: clouds, trees, fields."""
SURVEY_SEED = 1
"""Of the survey's errors and the clicks. They are one draw, shared by every frame of the day; how often intervals hold
the truth over many draws is measured by ``benchmarks/run.py``."""
DAY_SEED = 41
FIRST = datetime(2026, 6, 21, 0, 0, tzinfo=UTC)
FRAMES = 48
JPEG_QUALITY = 85
REFERENCE_QUALITY = 92
STEP = timedelta(minutes=30)

LANDMARK_KINDS: dict[str, LandmarkKind] = {
    "tower2-peak": "tower",
    "tower2-arm-left": "tower",
    "tower2-arm-right": "tower",
    "barn-ridge": "roof",
    "house-ridge": "roof",
    "pole-right": "pole",
}
"""What the landmarks are; the others are survey targets."""
WORLD = World(landmark_kinds=LANDMARK_KINDS, forest_m=13.0, horizon_m=335.0, opening=0.085)
"""Behind tower 2 a wood, before which the lower conductors are seen; the upper one is seen before hills and sky."""

PLAN = DayPlan(
    spells=(
        Spell((3.4, 4.1), fog_per_m=0.022),
        Spell((4.1, 4.6), fog_per_m=0.005),
        Spell((13.9, 15.1), rain=0.5, cloud=0.95, wind_m_s=9.5),
        Spell((15.1, 16.1), cloud=0.75, wind_m_s=6.5),
    )
)
"""A summer day: fog at dawn, a shower with gusts in the afternoon."""


@dataclass(frozen=True)
class Site:
    """The demonstration's scene and its moments."""

    scene: Scene
    reference: Moment
    day: tuple[Moment, ...]


def site_directory() -> Path:
    """Where the demonstration's files are installed."""
    return Path(str(files("sagnode.demo") / "site"))


def demo_site(directory: Path | None = None) -> Site:
    """The demonstration's scene and moments.

    Args:
        directory: where ``span.toml`` and ``camera.yaml`` lie; by default the installed ones.

    Raises:
        ConfigError: the survey or the calibration there cannot be used.
    """
    # Not by sagnode.config.load: it asks for the reference picture, which this scene is there to make.
    base = directory or site_directory()
    try:
        surveyed = Span.model_validate(tomllib.loads((base / "span.toml").read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{base / 'span.toml'}: cannot be used: {error}", "see: sagnode config check") from error
    stated = load_intrinsics(base / surveyed.camera.intrinsics)
    rng = generator(SURVEY_SEED, "errors")
    true = perturbed(surveyed, rng)
    lens = perturbed_intrinsics(stated, surveyed, rng)
    scene = Scene(surveyed, true, lens, WORLD, seed=WORLD_SEED)
    times = [FIRST + k * STEP for k in range(FRAMES)]
    return Site(scene, _reference(scene), tuple(day_of_moments(true, PLAN, times, DAY_SEED)))


def _reference(scene: Scene) -> Moment:
    """The picture in which the landmarks were clicked: a clear, calm morning three weeks before, camera at rest."""
    wires = {
        c.id: WireState(sag_at_temperature(c, 24.0) if c.measured else (c.sag_min_m + c.sag_max_m) / 2)
        for c in scene.true.conductors
    }
    time = datetime(2026, 5, 30, 9, 30, tzinfo=UTC)
    azimuth, elevation = sun_position(time, PLAN.latitude_deg, PLAN.longitude_deg)
    return Moment(
        wires, time, sun_azimuth_deg=azimuth, sun_elevation_deg=elevation, cloud=0.15, cloud_drift_m=(-5e3, 2e3), seed=1
    )


def clicked(scene: Scene) -> dict[str, Pixel]:
    """Pixels at which somebody clicks the landmarks in the reference picture: the true ones with a click's error."""
    rng = generator(SURVEY_SEED, "clicks")
    points = np.array([m.position for m in scene.true.landmarks])
    pixels, _ = project(scene.intrinsics, scene.pose, points)
    noise = rng.standard_normal(pixels.shape) * np.array([[m.pixel_u_px] for m in scene.surveyed.landmarks])
    rounded = np.round(pixels + noise, 1)
    return {m.id: (float(u), float(v)) for m, (u, v) in zip(scene.true.landmarks, rounded, strict=True)}


def write_site(site: Site, out: Path, progress: Callable[[int, int], None] | None = None) -> list[Path]:
    """Write ``reference.jpg`` and ``frames/*.jpg`` with their truth into ``out``; returns the frames' paths.

    Raises:
        SagnodeError: something there cannot be written.
    """
    frames = write_day(out / "frames", site.scene, site.day, "jpg", JPEG_QUALITY, progress)
    reference = out / "reference.jpg"
    try:
        reference.write_bytes(encoded(render(site.scene, site.reference).image, "jpg", REFERENCE_QUALITY))
    except OSError as error:
        raise SagnodeError(f"{reference}: cannot be written: {error.strerror}", "choose another --out") from error
    return frames
