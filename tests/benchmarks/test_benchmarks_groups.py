"""The groups of the suite: their views show what they need, their draws are what their names say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import draws
import groups
import views
import worlds
from sagnode.calibrate.files import load_intrinsics
from sagnode.geometry.camera import inside, project
from sagnode.scene.render import render
from sagnode.scene.spec import Scene, survey_pose


@pytest.mark.parametrize("name", list(views.VIEWS))
def test_a_view_has_its_landmarks_in_the_picture(name: str, tmp_path: Path) -> None:
    span = views.VIEWS[name].survey(tmp_path)
    lens = load_intrinsics(span.camera.intrinsics)
    pixels, _ = project(lens, survey_pose(span), np.array([m.position for m in span.landmarks]))
    assert inside(lens, pixels, 12.0).sum() >= 6


def test_names_are_used_once_and_strange_ones_are_told() -> None:
    names = [group.name for group in groups.GROUPS]
    assert len(set(names)) == len(names)
    assert [g.name for g in groups.groups_by_name("fog, tower")] == ["fog", "tower"]
    with pytest.raises(ValueError, match="no group fogg"):
        groups.groups_by_name("fogg")


def setting_of(name: str, folder: Path, seed: int = 3):
    """A setting without its reference picture."""
    group = groups.groups_by_name(name)[0]
    rng = np.random.default_rng(seed)
    span = group.survey(group.view.survey(folder), rng)
    world = group.world(group.view.world, span, group.view, rng)
    scene = Scene(span, span, load_intrinsics(span.camera.intrinsics), world, seed)
    return group, worlds.Setting(group.view, span, scene, rng)


def test_occlusion_hides_a_fifth_to_two_fifths_of_what_is_in_the_picture(tmp_path: Path) -> None:
    group, setting = setting_of("occlusion", tmp_path)
    (shot,) = group.shots(setting)
    bare = replace(shot.scene, world=replace(shot.scene.world, trees=()))
    free, hidden = (render(s, shot.moment).truth["conductors"] for s in (bare, shot.scene))
    lost = [1 - hidden[c.id]["visible_share"] / free[c.id]["visible_share"] for c in setting.survey.conductors]
    assert 0.15 < max(lost) < 0.5


def test_another_seed_draws_another_world(tmp_path: Path) -> None:
    group, first = setting_of("wind", tmp_path, 3)
    _, again = setting_of("wind", tmp_path, 3)
    _, other = setting_of("wind", tmp_path, 4)
    (one,), (same,), (another,) = (list(group.shots(s)) for s in (first, again, other))
    assert one.moment == same.moment
    assert one.moment.wires != another.moment.wires


def test_themes_are_drawn_as_they_say(tmp_path: Path) -> None:
    def shot_of(name: str, seed: int):
        group, setting = setting_of(name, tmp_path, seed)
        return setting, next(iter(group.shots(setting)))

    for seed in range(5):
        setting, shot = shot_of("wind", seed)
        assert all(abs(s.swing_deg) <= 32.2 for s in shot.moment.wires.values())
        assert setting.survey.swing.max_deg > 32.2
        setting, shot = shot_of("heights", seed)
        rise = setting.survey.conductors[0].far[2] - setting.survey.conductors[0].near[2]
        assert -25.0 <= rise - 0.83 <= 25.0
        setting, shot = shot_of("ice", seed)
        for conductor in setting.survey.conductors:
            loads = shot.moment.wires[conductor.id].loads
            assert bool(loads) == conductor.measured
            assert all(0 <= load.start < load.end <= 1 for load in loads)
        setting, shot = shot_of("bundle4", seed)
        assert {c.sub_conductors for c in setting.survey.conductors if c.measured} == {4}
        setting, shot = shot_of("knocked", seed)
        pixels = np.hypot(*shot.moment.turn_rad[:2]) * setting.scene.intrinsics.fx
        assert 30.0 <= pixels <= 150.0
        assert shot.fair == (pixels < 0.9 * setting.survey.camera.max_movement_px)
        setting, shot = shot_of("crossing", seed)
        assert len(setting.scene.world.other_wires) in (2, 3)


def test_negatives_ask_for_conductors_that_are_not_there(tmp_path: Path) -> None:
    group, setting = setting_of("none-tower", tmp_path)
    shots = {shot.kind: shot for shot in group.shots(setting)}
    assert shots.keys() == draws.NEGATIVES.keys()
    assert shots["one missing"].unseen == {"L1"}
    assert "L1" not in shots["one missing"].moment.wires
    assert shots["neighbours only"].moment.wires.keys() == {"earth"}
    assert shots["neighbours only"].scene.world.other_wires
    assert not shots["no wires"].moment.draw_wires
