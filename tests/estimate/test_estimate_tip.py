"""A wire that hangs in a plane through the camera: only where it turns back shows how far it sags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.port import GreyImage
from sagnode.config.node import Measure
from sagnode.config.span import Span
from sagnode.estimate import refinement
from sagnode.estimate.locate import locate
from sagnode.estimate.matched import Matched, tip_of
from sagnode.estimate.register import register
from sagnode.match.masks import Neighbour
from sagnode.match.refine import Observed
from sagnode.pipeline import load_site
from sagnode.scene.render import render
from sagnode.site import Site

SAG = 1.8


def above(span: Span, x: float) -> Span:
    """The same span with L1 hanging at ``x`` m to the right, above a camera at 0.3."""
    moved = []
    for c in span.conductors:
        if c.id == "L1":
            # 2.6 m to the left is where it hangs, but for errors of the survey
            near, far = ((x + place[0] + 2.6, *place[1:]) for place in (c.near, c.far))
            c = c.model_copy(update={"near": near, "far": far})
        moved.append(c)
    return span.model_copy(update={"conductors": tuple(moved)})


def seen_from_below(x: float, seed: int, directory: Path) -> tuple[Site, GreyImage]:
    sags, size = {"L1": SAG, "L2": 2.3}, {"width": 1280, "height": 960}
    scene, moment = simple_scene(sags, backdrop="plain", error_scale=1.0, seed=seed, **size)
    scene = replace(scene, surveyed=above(scene.surveyed, x), true=above(scene.true, x))
    reference, lens = directory / "reference.png", directory / "camera.yaml"
    image = render(scene, moment).image
    cv2.imwrite(str(reference), image)
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"reference_image": reference, "intrinsics": lens})
    return load_site(scene.surveyed.model_copy(update={"camera": camera}), Measure()), image


def located(site: Site, image: GreyImage) -> Matched:
    registered, _ = register(site, image)
    assert registered is not None
    return locate(site, image, registered)["L1"]


def no_tip(image: GreyImage, observed: Observed, turn: int, others: Sequence[Neighbour], half_range: int) -> None:
    """What a picture in which no tip is clear gives."""


@pytest.mark.parametrize(("x", "seed"), [(0.25, 4), (0.25, 5), (0.4, 4), (0.4, 5)])
def test_the_tip_tells_the_sag_of_a_wire_above_the_camera(
    x: float, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site, image = seen_from_below(x, seed, tmp_path)
    found = located(site, image)
    sag, u = found.sag
    assert abs(sag - SAG) < 3 * u
    assert u < 0.03
    monkeypatch.setattr(refinement, "with_tip", no_tip)
    assert located(site, image).sag[1] > 5 * u, "strands in a plane through the camera say hardly anything"


def test_the_offset_that_is_a_tip_is_known_as_one(tmp_path: Path) -> None:
    found = located(*seen_from_below(0.4, 4, tmp_path))
    tip = tip_of(found)
    assert tip is not None
    assert found.offsets.t[tip] == found.observed.t[found.observed.tip]
    lowest = int(np.argmax(found.track.pixels[:, 1]))
    assert found.offsets.measured[tip] == pytest.approx(found.track.pixels[lowest], abs=1.5)
