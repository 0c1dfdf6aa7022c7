"""Ice and weights on a part of the span, in the laboratory's frontal view where the whole wire is seen."""

from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from sagnode.calibrate.files import save_intrinsics
from sagnode.measurement import ConductorMeasurement
from sagnode.pipeline import load_site, measure_burst
from sagnode.quality import Cause, Validity
from sagnode.scene.catenary import Load, PartialLoad, PointLoad
from sagnode.scene.presets import preset_scene, typical_states
from sagnode.scene.render import render
from sagnode.scene.spec import Moment


def measured(tmp_path: Path, *loads: Load) -> tuple[ConductorMeasurement, float, float]:
    """The reading of the laboratory's wire under these loads, true sag and true clearance."""
    scene = preset_scene("lab", seed=1, error_scale=1.0)
    states = typical_states(scene.surveyed)
    reference, lens = tmp_path / "reference.png", tmp_path / "camera.yaml"
    cv2.imwrite(str(reference), render(scene, Moment(states, seed=3)).image)
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"reference_image": reference, "intrinsics": lens})
    site = load_site(scene.surveyed.model_copy(update={"camera": camera}))
    loaded = {name: replace(state, loads=loads) for name, state in states.items()}
    rendered = render(scene, Moment(loaded, seed=5))
    (reading,) = measure_burst(site, [rendered.image])
    true = rendered.truth["conductors"][reading.conductor]
    return reading, float(true["sag_m"]), float(true["clearance_m"])


@pytest.mark.parametrize(
    ("load", "skewed"),
    [
        (PartialLoad(0.5, 1.0, 0.6), +1),
        (PartialLoad(0.2, 0.5, 1.0), -1),
        (PointLoad(0.5, 0.05), 0),
    ],
)
def test_ice_or_a_weight_is_named_and_followed(tmp_path: Path, load: Load, skewed: int) -> None:
    reading, sag, clearance = measured(tmp_path, load)
    assert reading.validity is Validity.QUESTIONABLE
    assert Cause.ICE_SUSPECT in [r.cause for r in reading.reasons]
    assert abs(reading.estimates["sag"].value - sag) < 3 * reading.estimates["sag"].u
    assert abs(reading.estimates["clearance"].value - clearance) < 3 * reading.estimates["clearance"].u
    assert reading.estimates["sag"].u < 0.02 * sag
    skew = reading.estimates["load_skew"]
    # heavier towards B is positive; a weight in the middle is heavier towards neither
    if skewed:
        assert skewed * skew.value > 3 * skew.u
    else:
        assert abs(skew.value) < 3 * skew.u
    assert "conductor_temp" not in reading.estimates


def test_an_even_wire_is_not_suspected(tmp_path: Path) -> None:
    reading, sag, _ = measured(tmp_path)
    assert reading.validity is Validity.GOOD
    assert "load_skew" not in reading.estimates
    assert abs(reading.estimates["sag"].value - sag) < 3 * reading.estimates["sag"].u
