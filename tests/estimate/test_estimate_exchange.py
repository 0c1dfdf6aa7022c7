"""Conductors beside each other, seen from the side: which wire is whose is told where the picture shows it alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from demo_wire import of_blocks_alone
from numpy.typing import NDArray

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.config.node import Measure
from sagnode.estimate.even import find_even
from sagnode.estimate.exchange import exchangeable
from sagnode.estimate.matched import looked_at
from sagnode.estimate.refinement import survey_of
from sagnode.estimate.register import register
from sagnode.geometry.camera import Intrinsics
from sagnode.pipeline import load_site, measure_frame
from sagnode.quality import Cause, Validity
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene
from sagnode.site import Site

SAGS = {"L1": 1.9, "L2": 2.0}
SURE, UNSURE = 0.005, 0.2
"""How well attachments may be known, m: the wires' pictures tell which is whose, or they do not."""
ANY_SAG, FEW_SAGS = (1.0, 3.2), (1.75, 2.15)
"""Possible sags, m: those that the conductors would have in each other's places among them, or not."""


def pictured(
    folder: Path,
    attachment_u: float,
    sags: dict[str, float],
    possible: tuple[float, float] = ANY_SAG,
    focal: float = 1500.0,
) -> tuple[Site, NDArray[np.uint8]]:
    """The middle of a span of 60 m, seen from 36 m to its side, two conductors 5 m behind each other.

    L2 is thinner, so that its wire is no rival of L1's by what it shows.
    """
    scene, _ = simple_scene(seed=3)
    lens = Intrinsics(960, 540, focal, focal, 479.5, 269.5)
    file = folder / "camera.yaml"
    save_intrinsics(file, lens)
    view = {"position": (-36.0, 30.0, 2.0), "azimuth_deg": 90.0, "elevation_deg": 6.5, "intrinsics": file}
    camera = scene.surveyed.camera.model_copy(update={**view, "orientation_u_deg": 0.02})
    known = {"attachment_u_m": attachment_u, "sag_min_m": possible[0], "sag_max_m": possible[1]}
    pair = tuple(
        c.model_copy(update={**known, "diameter_m": diameter})
        for c, diameter in zip(scene.surveyed.conductors, (0.02, 0.012), strict=True)
    )
    span = scene.surveyed.model_copy(update={"camera": camera, "landmarks": (), "conductors": pair})
    seen = Scene(span, span, lens, replace(scene.world, backdrop="textured"), seed=3)
    moment = Moment({name: WireState(sag) for name, sag in sags.items()}, seed=2)
    return load_site(span, Measure()), render(seen, moment).image


def test_both_are_refused_where_each_may_be_the_other(tmp_path: Path) -> None:
    for m in measure_frame(*pictured(tmp_path, UNSURE, SAGS)):
        other = {"L1": "L2", "L2": "L1"}[m.conductor]
        assert m.validity is Validity.INVALID
        assert not m.estimates
        assert any(r.cause is Cause.AMBIGUOUS and other in r.text for r in m.reasons)


@pytest.mark.parametrize("left", ["L1", "L2"])
def test_one_alone_is_refused_where_it_may_be_the_other(left: str, tmp_path: Path) -> None:
    measured = measure_frame(*pictured(tmp_path, UNSURE, {left: SAGS[left]}))
    assert all(m.validity is Validity.INVALID for m in measured)
    assert any(r.cause is Cause.AMBIGUOUS for m in measured for r in m.reasons)


@pytest.mark.parametrize(
    ("share", "possible", "doubtful"), [(1, ANY_SAG, False), (3, ANY_SAG, True), (3, FEW_SAGS, False)]
)
def test_what_hardly_shows_proves_nothing_against_one_that_was_not_found(
    share: int, possible: tuple[float, float], doubtful: bool, tmp_path: Path
) -> None:
    site, image = pictured(tmp_path, SURE, {"L1": SAGS["L1"]}, possible)
    registered, _ = register(site, image)
    own = next(c for c in site.conductors if c.id == "L1")
    found = find_even(image, own, survey_of(own, registered), registered)
    assert found is not None
    found = looked_at(image, found)
    # one block in three shows the wire, or each of them
    hardly = of_blocks_alone(found, np.arange(len(found.observed.usable)) % share == 0)
    assert exchangeable(site.conductors, registered, {"L1": hardly, "L2": None}) == ({"L1": "L2"} if doubtful else {})


@pytest.mark.parametrize(("attachment_u", "possible"), [(SURE, ANY_SAG), (UNSURE, FEW_SAGS)])
def test_both_are_told_where_the_survey_leaves_one_way(
    attachment_u: float, possible: tuple[float, float], tmp_path: Path
) -> None:
    for m in measure_frame(*pictured(tmp_path, attachment_u, SAGS, possible)):
        assert m.validity is not Validity.INVALID, m.reasons
        assert abs(m.estimates["sag"].value - SAGS[m.conductor]) < 3 * m.estimates["sag"].u


def test_wires_too_near_to_be_measured_apart_say_so(tmp_path: Path) -> None:
    causes = set()
    for m in measure_frame(*pictured(tmp_path, SURE, SAGS, focal=700.0)):
        assert m.validity is Validity.INVALID
        causes |= {r.cause for r in m.reasons if "all along" in r.text}
    assert causes == {Cause.AMBIGUOUS}


@pytest.mark.parametrize("focal", [850.0, 1000.0])
def test_wires_a_few_pixels_apart_are_both_told(focal: float, tmp_path: Path) -> None:
    for m in measure_frame(*pictured(tmp_path, UNSURE, SAGS, FEW_SAGS, focal)):
        assert m.validity is not Validity.INVALID, m.reasons
        assert abs(m.estimates["sag"].value - SAGS[m.conductor]) < 3 * m.estimates["sag"].u
