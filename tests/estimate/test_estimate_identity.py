"""Conductors that run beside each other: told apart where they were found on one wire, and measured where clear."""

from dataclasses import replace
from pathlib import Path

import pytest
from demo_wire import along_the_line

from presets import simple_scene
from sagnode.estimate import identity
from sagnode.estimate.even import find_even
from sagnode.estimate.identity import tell_apart
from sagnode.estimate.locate import _with_its_neighbours
from sagnode.estimate.matched import Matched
from sagnode.estimate.refinement import survey_of
from sagnode.estimate.register import Registered
from sagnode.pipeline import measure_frame
from sagnode.scene.render import Rendered, render
from sagnode.site import Site
from sites import registered_site

SAGS = {"L1": 1.9, "L2": 2.3}


def beside(apart_m: float, folder: Path, drawn: tuple[str, ...] = ("L1", "L2")) -> tuple[Site, Rendered, Registered]:
    """Two conductors whose attachments are so far apart, seen along the line; those ``drawn`` are in the picture."""
    scene, moment = simple_scene(SAGS, seed=4, width=960, height=720)
    first, second = scene.surveyed.conductors
    near, far = ((first_end[0] + apart_m, *first_end[1:]) for first_end in (first.near, first.far))
    pair = (first, second.model_copy(update={"near": near, "far": far}))
    span = scene.surveyed.model_copy(update={"conductors": pair})
    shown = replace(moment, wires={name: moment.wires[name] for name in drawn})
    picture = render(replace(scene, true=span, surveyed=span), shown)
    site, registered = registered_site(span, scene.intrinsics, picture, folder)
    return site, picture, registered


def found_alone(site: Site, picture: Rendered, registered: Registered) -> dict[str, Matched | None]:
    return {c.id: find_even(picture.image, c, survey_of(c, registered), registered) for c in site.conductors}


def test_wires_a_hand_apart_are_told_apart_and_measured(tmp_path: Path) -> None:
    site, picture, _ = beside(0.2, tmp_path)
    for m in measure_frame(site, picture.image):
        assert abs(m.estimates["sag"].value - SAGS[m.conductor]) < 3 * m.estimates["sag"].u
        assert m.estimates["sag"].u < 0.03


@pytest.mark.parametrize("thief", ["L1", "L2"])
def test_the_one_that_fits_better_keeps_the_wire(thief: str, tmp_path: Path) -> None:
    site, picture, registered = beside(0.25, tmp_path)
    alone = found_alone(site, picture, registered)
    owner = "L2" if thief == "L1" else "L1"
    told = tell_apart(picture.image, site.conductors, registered, {**alone, thief: alone[owner]})
    for name, match in told.items():
        assert match is not None
        assert match.sag[0] == pytest.approx(SAGS[name], abs=0.02)


@pytest.mark.parametrize("there", [True, False])
def test_a_curve_beside_a_wire_must_lie_on_another_to_be_taken(
    there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site, picture, registered = beside(0.6, tmp_path)
    alone = found_alone(site, picture, registered)
    if not there:
        site, picture, registered = beside(0.6, tmp_path, drawn=("L2",))
    # whatever is looked for beside L2's wire, L1 is found where it hangs, and L2 nowhere else
    monkeypatch.setattr(identity, "find_apart", lambda _, conductor, *__: alone["L1"] if conductor.id == "L1" else None)
    both = {"L1": alone["L2"], "L2": alone["L2"]}
    told = tell_apart(picture.image, site.conductors, registered, both)
    assert told == (alone if there else both)


def test_wires_that_lie_apart_and_wires_that_are_not_there_stay_as_they_are(tmp_path: Path) -> None:
    site, picture, registered = beside(0.6, tmp_path)
    alone = found_alone(site, picture, registered)
    assert tell_apart(picture.image, site.conductors, registered, alone) == alone
    lost = {**alone, "L2": None}
    assert tell_apart(picture.image, site.conductors, registered, lost) == lost


@pytest.mark.parametrize(("aside_px", "refused"), [(0.5, True), (1.5, True), (4.0, False)])
def test_what_rests_on_the_places_of_one_that_cannot_be_measured_is_refused_with_it(
    aside_px: float, refused: bool
) -> None:
    own = along_the_line().match
    beside = replace(own.track, pixels=own.track.pixels + aside_px * own.track.normal)
    crowded = replace(own, track=beside, crowded=True)
    located = _with_its_neighbours({"own": own, "crowded": crowded, "own again": own})
    assert [each.crowded for each in located.values()] == [refused, True, refused]
    assert not _with_its_neighbours({"own": own, "beside": replace(crowded, crowded=False)})["own"].crowded


def test_a_few_places_beside_it_refuse_nothing() -> None:
    own = along_the_line().match
    far = own.track.t > 0.5
    beside = replace(own.track, pixels=own.track.pixels[far] + 0.5 * own.track.normal[far])
    located = _with_its_neighbours({"own": own, "crowded": replace(own, track=beside, crowded=True)})
    assert not located["own"].crowded
