"""What the other conductors' swings tell of one whose own picture says little of them, and when they tell nothing."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from presets import simple_scene
from sagnode.estimate.even import find_even
from sagnode.estimate.load_kinds import LOAD_U
from sagnode.estimate.matched import Matched, looked_at
from sagnode.estimate.refinement import survey_of
from sagnode.estimate.register import Registered
from sagnode.estimate.wind import in_one_wind, sought_again, unlike_others
from sagnode.scene.catenary import WireState
from sagnode.scene.render import Rendered, render
from sagnode.scene.truth import pixel_curve
from sagnode.site import Site
from sites import registered_site

ASIDE = {"L1": -2.6, "L2": 2.4, "L3": 6.0}
"""Conductors and where their attachments are, m."""
SAG, SWING = 2.1, 2.0
HIDDEN = 0.45
"""Something hides the last of them from here on, as a share of the span."""


def span_of_three(swings: Mapping[str, float], folder: Path) -> tuple[Site, Rendered, Registered]:
    scene, moment = simple_scene(seed=4, width=960, height=720)
    like = scene.surveyed.conductors[0]
    conductors = tuple(
        like.model_copy(update={"id": name, "near": (x, *like.near[1:]), "far": (x, *like.far[1:])})
        for name, x in ASIDE.items()
    )
    span = scene.surveyed.model_copy(update={"conductors": conductors})
    wires = {name: WireState(SAG, swing) for name, swing in swings.items()}
    whole, moment = replace(scene, true=span, surveyed=span), replace(moment, wires=wires)
    picture = render(whole, moment)
    curve = pixel_curve(whole, moment, conductors[-1])
    cv2.polylines(picture.image, [np.rint(curve[int(HIDDEN * len(curve)) :]).astype(np.int32)], False, 190.0, 13)
    site, registered = registered_site(span, scene.intrinsics, picture, folder)
    return site, picture, registered


def found_alone(site: Site, picture: Rendered, registered: Registered) -> dict[str, Matched]:
    found = {c.id: find_even(picture.image, c, survey_of(c, registered), registered) for c in site.conductors}
    return {name: looked_at(picture.image, each) for name, each in found.items() if each is not None}


def test_the_others_swings_make_the_sag_surer_that_hardly_shows(tmp_path: Path) -> None:
    site, picture, registered = span_of_three(dict.fromkeys(ASIDE, SWING), tmp_path)
    alone = found_alone(site, picture, registered)
    together = in_one_wind(picture.image, site.conductors, registered, alone, {})
    own, told = alone["L3"], together["L3"]
    assert told.sag[1] < 0.9 * own.sag[1]
    assert abs(told.sag[0] - SAG) < 2 * told.sag[1]
    assert told.swing[1] < own.swing[1]


def test_what_its_own_picture_contradicts_is_not_believed(tmp_path: Path) -> None:
    site, picture, registered = span_of_three({"L1": 12.0, "L2": 12.0, "L3": -6.0}, tmp_path)
    alone = found_alone(site, picture, registered)
    assert in_one_wind(picture.image, site.conductors, registered, alone, {})["L3"] is alone["L3"]


def test_a_wire_under_an_uneven_load_has_no_wind_of_its_own(tmp_path: Path) -> None:
    site, picture, registered = span_of_three({"L1": 12.0, "L2": 12.0, "L3": -6.0}, tmp_path)
    found = found_alone(site, picture, registered)
    assert unlike_others(found) == set()
    loaded = {name: replace(each, survey=replace(each.survey, load_u=LOAD_U)) for name, each in found.items()}
    assert unlike_others(loaded) == {"L3"}
    # where only two are seen, either may be wrong; a bare one is not
    assert unlike_others({name: loaded[name] for name in ("L1", "L3")}) == {"L1", "L3"}
    assert unlike_others({"L1": found["L1"], "L3": loaded["L3"]}) == {"L3"}
    assert unlike_others({"L3": loaded["L3"]}) == set()
    assert unlike_others(loaded | {"L1": replace(loaded["L1"], crowded=True)}) == {"L2", "L3"}


@pytest.mark.parametrize("doubt", [{"or_of": "L1"}, {"crowded": True}, {"rival": 0.9}, {"doubtful_load": True}])
def test_who_may_be_another_or_under_a_load_tells_nothing_and_is_told_nothing(
    doubt: Mapping[str, object], tmp_path: Path
) -> None:
    site, picture, registered = span_of_three(dict.fromkeys(ASIDE, SWING), tmp_path)
    alone = found_alone(site, picture, registered)
    doubted = {name: replace(each, **doubt) for name, each in alone.items()}  # type: ignore[arg-type]
    only_one = {**doubted, "L3": alone["L3"]}
    for known in (doubted, only_one, {"L3": alone["L3"]}):
        assert in_one_wind(picture.image, site.conductors, registered, known, {}) == known


def test_one_that_was_not_found_is_sought_with_the_others_wind_and_says_what_its_own_picture_shows(
    tmp_path: Path,
) -> None:
    site, picture, registered = span_of_three(dict.fromkeys(ASIDE, SWING), tmp_path)
    alone = found_alone(site, picture, registered)
    lost = {**alone, "L3": None}
    found = sought_again(picture.image, site.conductors, registered, lost)
    again = found["L3"]
    assert again is not None
    assert again.survey == alone["L3"].survey
    assert again.solution.converged
    assert abs(again.sag[0] - SAG) < 2 * again.sag[1]
    assert {name: found[name] for name in ("L1", "L2")} == {name: alone[name] for name in ("L1", "L2")}
