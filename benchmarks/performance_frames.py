"""The frames that are timed: the paper's laboratory, the demonstration's tower view, the paper's field at 12 MP.

The same pictures are given to every method. Laboratory and field are drawn by the scene generator with errors of the
stated uncertainties; the tower's is a daylight frame of the demonstration's day.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.images import read_grey
from sagnode.capture.port import GreyImage
from sagnode.config.load import load_span
from sagnode.config.span import Span
from sagnode.geometry.camera import Intrinsics
from sagnode.pipeline import load_site
from sagnode.scene.presets import preset
from sagnode.scene.render import render
from sagnode.scene.site import site_directory
from sagnode.scene.spec import Moment, Scene, World
from sagnode.scene.truth import read_truth, true_quantities
from sagnode.site import Site
from worlds import GROUPS, Group, Setting, any_moment, settle

NAMES = ("lab", "tower", "field")
DAYLIGHT = "20260621T103000Z.jpg"
SEED = 1
JPEG_QUALITY = 90


@dataclass(frozen=True)
class Shot:
    """One picture with its survey and its truth."""

    name: str
    what: str
    span: Span
    site: Site
    image: GreyImage
    jpeg: Path
    """The same picture as the camera's file, for the cost of decoding."""
    truth: dict[str, dict[str, float]]
    """By conductor, quantity stem to true value."""

    @property
    def size(self) -> str:
        """Width and height in words."""
        return f"{self.image.shape[1]}x{self.image.shape[0]}"

    def alone(self, count: int = 1) -> Site:
        """The site with its first ``count`` measured conductors only."""
        measured = [c for c in self.site.conductors if c.measured]
        return replace(self.site, conductors=tuple(measured[:count]))


@cache
def shot(name: str, folder: Path) -> Shot:
    """The picture of a view, made anew in ``folder``."""
    if name == "tower":
        file = next(site_directory().rglob(DAYLIGHT))
        span = load_span(site_directory() / "span.toml").span
        truth = {k: dict(v) for k, v in read_truth(file).conductors.items()}
        what = "the demonstration's span from tower 1, three conductors and a known earth wire"
        return Shot(name, what, span, load_site(span), read_grey(file), file, truth)
    folder = folder / name
    folder.mkdir(parents=True, exist_ok=True)
    group = next(group for group in GROUPS if group.name == name)
    setting = settle(group, SEED, 0, folder)
    moment = any_moment(group, setting)
    true = setting.scene.true
    truth = {c.id: true_quantities(true, c, moment.wires[c.id]) for c in true.conductors}
    image = render(setting.scene, moment).image
    return Shot(
        name, group.what, setting.survey, load_site(setting.survey), image, _as_jpeg(image, folder / "frame"), truth
    )


@cache
def scaled_tower(width: int, folder: Path) -> Shot:
    """The tower view of the scene generator with the same field of view on a sensor of another number of pixels."""
    span, lens = preset("tower")
    factor = width / lens.width
    height = round(lens.height * factor)
    # pixel centres keep their direction: (u + ½) scales, not u
    scaled = Intrinsics(
        width,
        height,
        lens.fx * factor,
        lens.fy * factor,
        (lens.cx + 0.5) * factor - 0.5,
        (lens.cy + 0.5) * factor - 0.5,
        lens.distortion,
    )
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"camera-{width}.yaml"
    save_intrinsics(file, scaled)
    marks = tuple(
        m.model_copy(update={"pixel": tuple(round((p + 0.5) * factor - 0.5, 2) for p in m.pixel)})
        for m in span.landmarks
    )
    camera = span.camera.model_copy(update={"intrinsics": file})
    span = span.model_copy(update={"landmarks": marks, "camera": camera})
    scene = Scene(span, span, scaled, World(), SEED)
    group = next(group for group in GROUPS if group.name == "tower")
    reference = folder / f"reference-{width}.png"
    calm = _moment(group, span, scene, 1)
    cv2.imwrite(str(reference), render(scene, calm).image)
    span = span.model_copy(update={"camera": camera.model_copy(update={"reference_image": reference})})
    moment = _moment(group, span, scene, 2)
    image = render(scene, moment).image
    truth = {c.id: true_quantities(span, c, moment.wires[c.id]) for c in span.conductors}
    name = f"tower-{width}"
    return Shot(name, "the tower view, scaled", span, load_site(span), image, _as_jpeg(image, folder / name), truth)


def _moment(group: Group, span: Span, scene: Scene, seed: int) -> Moment:
    """Weather and sags of a seed, the camera at rest."""
    return replace(any_moment(group, Setting(span, scene, np.random.default_rng(seed))), turn_rad=(0.0, 0.0, 0.0))


def _as_jpeg(image: GreyImage, stem: Path) -> Path:
    file = stem.with_suffix(".jpg")
    cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return file
