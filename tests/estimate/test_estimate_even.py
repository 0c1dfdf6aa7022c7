"""An evenly loaded conductor: what was found is held against what the search had seen."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from demo_wire import SAG_M, along_the_line, demo_picture

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.port import GreyImage
from sagnode.config.node import Measure
from sagnode.estimate import even
from sagnode.estimate.afar import REACH_PX, approached
from sagnode.estimate.even import find_even
from sagnode.estimate.judge import RIVAL_MAX
from sagnode.estimate.refinement import STAGES, refine, survey_of
from sagnode.estimate.register import Registered, register
from sagnode.geometry.camera import FloatArray, project
from sagnode.match.search import Candidate
from sagnode.pipeline import load_site
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


def test_where_the_first_look_finds_nothing_as_good_a_second_goes_through_more_of_the_search(
    seen: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As along a treeline, where so much looks like a thin wire that the wire is not among the first peaks."""
    conductor, image, registered = seen
    survey = survey_of(conductor, registered)
    searched = even.candidates_of

    def decoys(*asked: Any) -> list[Candidate]:
        return [replace(each, sag=0.7 * each.sag, swing=0.2) for each in searched(*asked)]

    def decoys_first(*asked: Any) -> list[Candidate]:
        return searched(*asked) if asked[-1] == even.THOROUGH else decoys(*asked)

    monkeypatch.setattr(even, "candidates_of", decoys_first)
    found = find_even(image, conductor, survey, registered)
    assert found is not None
    assert found.sag[0] == pytest.approx(1.8, abs=0.02)
    assert found.rival < 0.1
    monkeypatch.setattr(even, "candidates_of", decoys)
    lost = find_even(image, conductor, survey, registered)
    assert lost is None or lost.sag[0] != pytest.approx(1.8, abs=0.02), "else the decoys are none"


@pytest.mark.parametrize("up_m", [-0.25, 0.25])
def test_a_look_from_afar_sees_a_wire_as_far_aside_as_its_attachment_is_uncertain(up_m: float) -> None:
    found = along_the_line()
    registered, _ = register(found.site, demo_picture())
    survey = survey_of(found.conductor, registered)
    moved = replace(survey, near=survey.near + np.array([0.0, 0.0, up_m]), attachment_u=0.15)
    start = registered.theta.copy()
    start[ATTACHMENTS] = 0.0
    start[SAG], start[SWING] = SAG_M, 0.0

    def aside(theta: FloatArray) -> FloatArray:
        """From the wire to a curve under the wrong survey, px; how far the near quarter lies off it."""
        track = found.match.track
        there = project(*moved.camera(theta), moved.shape(theta).points(track.t))[0]
        near = track.t < 0.25
        return np.abs(np.sum((there - track.pixels) * track.normal, axis=1))[near]

    assert REACH_PX > aside(start).max() > 2 * STAGES[0].half_range_px
    after = approached(demo_picture(), found.conductor, moved, registered, start)
    assert aside(after).max() < STAGES[1].half_range_px
    # without a wire to see nothing is moved
    blank = np.full_like(demo_picture(), 128)
    assert (approached(blank, found.conductor, moved, registered, start) == start).all()
