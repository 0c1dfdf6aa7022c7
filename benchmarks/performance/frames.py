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

from presets import preset, preset_scene, typical_states
from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.images import read_grey
from sagnode.capture.port import GreyImage
from sagnode.config.load import load_span
from sagnode.config.span import Span
from sagnode.geometry.camera import Intrinsics, inside
from sagnode.pipeline import load_site
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.site import site_directory
from sagnode.scene.spec import Moment, Scene, World
from sagnode.scene.truth import read_truth, true_quantities
from sagnode.site import Site

NAMES = ("lab", "tower", "field")
DAYLIGHT = "20260621T103000Z.jpg"
SEED = 1
WHAT = {
    "lab": "the paper's laboratory, frontal from 2.5 m",
    "field": "the paper's 110 kV span through a long lens, f = 15 300 px",
}
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
    scene = preset_scene(name, SEED, error_scale=1.0)
    return _taken(name, WHAT[name], scene, preset(name)[1], folder)


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
    marks = tuple(
        m.model_copy(update={"pixel": tuple(round((p + 0.5) * factor - 0.5, 2) for p in m.pixel)})
        for m in span.landmarks
    )
    span = span.model_copy(update={"landmarks": marks})
    name = f"tower-{width}"
    folder = folder / name
    folder.mkdir(parents=True, exist_ok=True)
    return _taken(name, "the tower view, scaled", Scene(span, span, scaled, World(), SEED), scaled, folder)


def _taken(name: str, what: str, scene: Scene, lens: Intrinsics, folder: Path) -> Shot:
    """The scene's survey made into files in ``folder``, and a picture of the scene on another day than the survey."""
    calm = Moment(typical_states(scene.true), cloud=0.2, seed=1)
    reference = folder / "reference.png"
    cv2.imwrite(str(reference), render(scene, calm).image)
    intrinsics = folder / "camera.yaml"
    save_intrinsics(intrinsics, lens)
    pixels = np.array([m.pixel for m in scene.surveyed.landmarks])
    seen = inside(lens, pixels, 2.0)
    span = scene.surveyed.model_copy(
        update={
            "landmarks": tuple(m for m, ok in zip(scene.surveyed.landmarks, seen, strict=True) if ok),
            "camera": scene.surveyed.camera.model_copy(update={"intrinsics": intrinsics, "reference_image": reference}),
        }
    )
    # the camera has turned by two pixels, the conductors by a degree and a half
    moment = Moment(_sagging(scene.true), turn_rad=(2 / lens.fx, -1.5 / lens.fx, 1e-4), cloud=0.5, seed=2)
    image = render(scene, moment).image
    jpeg = folder / "frame.jpg"
    cv2.imwrite(str(jpeg), image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    truth = {c.id: true_quantities(scene.true, c, moment.wires[c.id]) for c in scene.true.conductors}
    return Shot(name, what, span, load_site(span), image, jpeg, truth)


def _sagging(span: Span) -> dict[str, WireState]:
    """Every conductor at four tenths of its possible sags, a little more from one to the next."""
    states = {}
    for number, conductor in enumerate(span.conductors):
        share = 0.4 + 0.02 * number
        sag = conductor.sag_min_m + share * (conductor.sag_max_m - conductor.sag_min_m)
        states[conductor.id] = WireState(sag, 1.5 if conductor.sag_max_m > 1 else 0.0)
    return states
