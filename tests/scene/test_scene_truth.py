"""The truth file: quantities by hand, and its way to disk and back."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from presets import preset, simple_scene, typical_states
from sagnode.config.span import Conductor, Ground, Obstacle, Span
from sagnode.errors import FrameError
from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import Shape, quantities
from sagnode.message import QUANTITIES
from sagnode.scene.catenary import PartialLoad, WireState
from sagnode.scene.render import render
from sagnode.scene.truth import pixel_curve, read_truth, true_quantities
from sagnode.scene.writer import write_frame


def level_span() -> tuple[Span, Conductor]:
    span, _ = preset("tower")
    conductor = span.conductors[0].model_copy(update={"near": (0.0, 0.0, 20.0), "far": (0.0, 200.0, 20.0)})
    ground = Ground(
        profile=((0.0, 0.0), (200.0, 4.0)), obstacles=(Obstacle(id="roof", along_m=(40.0, 50.0), height_m=9.0),)
    )
    return span.model_copy(update={"conductors": (conductor,), "ground": ground}), conductor


def test_a_level_span_by_hand() -> None:
    span, conductor = level_span()
    values = true_quantities(span, conductor, WireState(5.0))
    assert values["sag"] == pytest.approx(5.0, abs=1e-6)
    assert values["lowest_along"] == pytest.approx(100.0, abs=0.01)
    assert values["lowest_height"] == pytest.approx(15.0, abs=1e-6)
    assert values["drop"] == pytest.approx(5.0, abs=1e-6)
    assert values["midspan_clearance"] == pytest.approx(13.0, abs=1e-5)
    # At 50 m the parabola hangs 4·5·0.25·0.75 = 3.75 m; the roof's far edge is 20 - 3.75 - 9 below it.
    assert values["clearance"] == pytest.approx(7.25, abs=0.01)
    assert values["clearance_along"] == pytest.approx(50.0, abs=0.02)
    assert values["blowout"] == pytest.approx(0.0, abs=1e-9)
    # a = L²/(8D) for a parabola, to the second order a + D/6
    assert values["catenary_constant"] == pytest.approx(200**2 / 40 + 5 / 6, rel=1e-4)


def test_a_swung_level_span_by_hand() -> None:
    span, conductor = level_span()
    values = true_quantities(span, conductor, WireState(5.0, -30.0))
    assert values["sag"] == pytest.approx(5.0 * math.cos(math.radians(30)), abs=1e-6)
    assert values["inplane_sag"] == pytest.approx(5.0, abs=1e-6)
    assert values["blowout"] == pytest.approx(2.5, abs=1e-6)
    assert values["swing"] == -30.0


def test_ice_at_the_far_end_by_hand() -> None:
    """A cable hangs as the moment diagram of its load: M/H, by the statics of a beam."""
    span, conductor = level_span()
    even = true_quantities(span, conductor, WireState(5.0))
    iced = true_quantities(span, conductor, WireState(5.0, loads=(PartialLoad(0.5, 1.0, 1.0),)))
    # w on the first half, 2w on the second: reaction at A 0.625 wL, M = 0.625 s - s²/2 - (s - ½)₊²/2, in wL²
    s = np.linspace(0.0, 1.0, 100001)
    moment = 0.625 * s - s**2 / 2 - np.maximum(s - 0.5, 0.0) ** 2 / 2
    assert iced["sag"] == pytest.approx(5.0 * moment.max() / moment[50000], rel=2e-3)
    assert iced["lowest_along"] == pytest.approx(200.0 * s[np.argmax(moment)], abs=0.2)
    assert iced["lowest_height"] == pytest.approx(20.0 - iced["sag"], abs=1e-6)
    assert iced["midspan_sag"] == pytest.approx(5.0, abs=1e-6)
    # the same sag at mid-span takes 1.5 times the tension: M(½) is 3/16 instead of 1/8
    assert iced["tension"] == pytest.approx(1.5 * even["tension"], rel=2e-3)
    # 3 ∫ w(s)(2s - 1) ds / ∫ w(s) ds = 3 · ¼ / 1.5
    assert iced["load_skew"] == pytest.approx(0.5)
    assert even["load_skew"] == 0.0


@pytest.mark.parametrize("view", ["lab", "tower"])
@pytest.mark.parametrize("swing", [0.0, 14.0])
def test_the_measured_side_computes_the_same_quantities(view: str, swing: float) -> None:
    span, _ = preset(view)  # type: ignore[arg-type]
    conductor = next(c for c in span.conductors if c.measured)
    state = typical_states(span, swing)[conductor.id]
    profile = np.array(span.ground.profile)
    ground = GroundProfile(profile[:, 0], profile[:, 1], np.zeros((0, 3)), 0.0)
    shape = Shape(np.array(conductor.near), np.array(conductor.far), state.sag_m, math.radians(swing))
    measured = quantities(shape, ground, conductor.unit_weight_n_m)
    true = true_quantities(span, conductor, state)
    # an even load is not told
    assert measured.keys() == true.keys() - {"load_skew"}
    length = math.dist(conductor.near[:2], conductor.far[:2])
    for stem, value in ((stem, true[stem]) for stem in measured):
        loose = 2e-3 * length if stem.endswith("_along") else 1e-5 * length + 1e-6 * abs(value)
        assert measured[stem] == pytest.approx(value, abs=loose), stem


def test_every_quantity_of_the_messages_is_true_or_not_geometry() -> None:
    span, conductor = level_span()
    stems = {q.stem for q in QUANTITIES}
    values = true_quantities(span, conductor, WireState(5.0))
    assert stems - values.keys() == {"conductor_temp"}
    assert values.keys() <= stems


def test_the_file_gives_back_what_was_rendered(tmp_path: Path) -> None:
    scene, moment = simple_scene(swing_deg=4.0, error_scale=1.0)
    picture = write_frame(tmp_path, "20260621T110000Z", render(scene, moment), "png")
    truth = read_truth(picture)
    assert truth.time == moment.time
    for conductor in scene.true.conductors:
        expected = true_quantities(scene.true, conductor, moment.wires[conductor.id])
        assert truth.conductors[conductor.id] == pytest.approx(expected, abs=5.1e-5)
        kept = np.array(truth.document["conductors"][conductor.id]["pixels"])
        curve = pixel_curve(scene, moment, conductor, 20001)
        gaps = [np.nanmin(np.hypot(*(curve - p).T)) for p in kept]
        assert max(gaps) < 0.1
    pose = scene.pose_at(moment)
    np.testing.assert_allclose(truth.document["camera"]["position"], pose.position, atol=1e-5)
    np.testing.assert_allclose(truth.document["camera"]["rotation"], pose.rotation, atol=1e-8)


@pytest.mark.parametrize("content", [None, "", "{", "[]", json.dumps({"schema": "other/1"})])
def test_what_is_no_truth_file_is_said(tmp_path: Path, content: str | None) -> None:
    file = tmp_path / "frame.json"
    if content is not None:
        file.write_text(content)
    with pytest.raises(FrameError, match=r"frame\.json"):
        read_truth(tmp_path / "frame.jpg")
