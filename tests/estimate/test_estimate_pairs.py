"""Conductors that run a few pixels beside each other: plain to see, and found as the pair that they are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.config.node import Measure
from sagnode.estimate.even import find_even
from sagnode.estimate.matched import Matched
from sagnode.estimate.pairs import pair_up
from sagnode.estimate.refinement import survey_of
from sagnode.estimate.register import Registered, register
from sagnode.geometry.camera import Intrinsics
from sagnode.pipeline import load_site, measure_frame
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene
from sagnode.site import Site

FOUR_PX, FAR = {"L1": 1.9, "L2": 1.36}, {"L1": 1.9, "L2": 1.7}
"""Sags, m, at which the one wire is seen so far beside the other."""
Alone = dict[str, Matched | None]


def from_the_side(folder: Path, sags: dict[str, float], backdrop: str) -> tuple[Site, np.ndarray, Registered, Alone]:
    """The middle of a span of 60 m, seen from 36 m to its side, and its two conductors as each is found by itself."""
    scene, _ = simple_scene(seed=3)
    lens = Intrinsics(960, 540, 1500.0, 1500.0, 479.5, 269.5)
    file = folder / "camera.yaml"
    save_intrinsics(file, lens)
    view = {"position": (-36.0, 30.0, 2.0), "azimuth_deg": 90.0, "elevation_deg": 6.5, "intrinsics": file}
    camera = scene.surveyed.camera.model_copy(update={**view, "orientation_u_deg": 0.02})
    known = {"attachment_u_m": 0.02, "sag_min_m": 1.0, "sag_max_m": 3.2, "diameter_m": 0.02}
    pair = tuple(c.model_copy(update=known) for c in scene.surveyed.conductors)
    span = scene.surveyed.model_copy(update={"camera": camera, "landmarks": (), "conductors": pair})
    seen = Scene(span, span, lens, replace(scene.world, backdrop=backdrop), seed=3)
    image = render(seen, Moment({name: WireState(sag) for name, sag in sags.items()}, seed=2)).image
    site = load_site(span, Measure())
    registered, _ = register(site, image)
    alone = {c.id: find_even(image, c, survey_of(c, registered), registered) for c in site.conductors}
    return site, image, registered, alone


@pytest.mark.parametrize("backdrop", ["textured", "sky"])
def test_two_wires_four_pixels_apart_are_found_together_and_told(backdrop: str, tmp_path: Path) -> None:
    site, image, registered, alone = from_the_side(tmp_path, FOUR_PX, backdrop)
    # by itself the one finds nothing, or the other's wire
    assert alone["L2"] is None or abs(alone["L2"].sag[0] - FOUR_PX["L2"]) > 0.1
    for name, own in pair_up(image, site.conductors, registered, alone).items():
        assert own is not None
        assert own.sag[0] == pytest.approx(FOUR_PX[name], abs=0.03)
    for m in measure_frame(site, image):
        assert abs(m.estimates["sag"].value - FOUR_PX[m.conductor]) < 3 * m.estimates["sag"].u


@pytest.mark.parametrize("left", ["L1", "L2"])
def test_one_wire_is_no_pair(left: str, tmp_path: Path) -> None:
    site, image, registered, alone = from_the_side(tmp_path, {left: FOUR_PX[left]}, "textured")
    assert pair_up(image, site.conductors, registered, alone) == alone
    for m in measure_frame(site, image):
        assert m.conductor == left or not m.estimates


def test_wires_that_were_found_clearly_stay_as_they_are(tmp_path: Path) -> None:
    site, image, registered, alone = from_the_side(tmp_path, FAR, "sky")
    told = pair_up(image, site.conductors, registered, alone)
    assert all(told[name] is own for name, own in alone.items())
