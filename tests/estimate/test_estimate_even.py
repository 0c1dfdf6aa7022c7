"""An evenly loaded conductor: what was found is held against what the search had seen."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.port import GreyImage
from sagnode.config.node import Measure
from sagnode.estimate import even
from sagnode.estimate.even import find_even
from sagnode.estimate.judge import RIVAL_MAX
from sagnode.estimate.refinement import STAGES, refine, survey_of
from sagnode.estimate.register import Registered, register
from sagnode.pipeline import load_site
from sagnode.scene.presets import simple_scene
from sagnode.scene.render import render
from sagnode.site import SiteConductor
from sagnode.survey import ATTACHMENTS, SAG, SWING

Scene = tuple[SiteConductor, GreyImage, Registered]


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    scene, moment = simple_scene({"L1": 1.8, "L2": 2.3}, seed=4, backdrop="plain")
    directory = tmp_path_factory.mktemp("site")
    reference, lens = directory / "reference.png", directory / "camera.yaml"
    image = render(scene, moment).image
    cv2.imwrite(str(reference), image)
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"reference_image": reference, "intrinsics": lens})
    site = load_site(scene.surveyed.model_copy(update={"camera": camera}), Measure())
    registered, _ = register(site, image)
    assert registered is not None
    return next(c for c in site.conductors if c.id == "L1"), image, registered


def test_what_lies_where_the_search_saw_most_is_outdone_by_nothing(seen: Scene) -> None:
    conductor, image, registered = seen
    found = find_even(image, conductor, survey_of(conductor, registered), registered)
    assert found is not None
    assert found.sag[0] == pytest.approx(1.8, abs=0.02)
    assert found.rival < 0.1


def test_a_refinement_that_lost_the_wire_has_the_candidate_for_a_rival(
    seen: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    conductor, image, registered = seen
    survey = survey_of(conductor, registered)
    theta = registered.theta.copy()
    theta[ATTACHMENTS] = 0.0
    theta[SAG], theta[SWING] = 1.8, 0.0
    right = refine(image, conductor, survey, registered, theta, [], STAGES)
    assert right is not None
    aside = even.trace(right.view, 2.4, np.radians(4.0))
    assert aside is not None
    lost = replace(right, track=aside, response=0.5 * right.response)
    monkeypatch.setattr(even, "best_of", lambda *_: lost)
    found = find_even(image, conductor, survey, registered)
    assert found is not None
    assert found.rival > RIVAL_MAX
