"""Sites drawn at random: surveys as a technician could have written them, each another one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import anywhere
from groups import groups_by_name
from sagnode.calibrate.files import load_intrinsics
from sagnode.config.span import Span
from sagnode.geometry.camera import inside, project
from sagnode.pipeline import load_site
from sagnode.scene.catenary import WireState, wire_points
from sagnode.scene.spec import SpanFrame, survey_pose
from worlds import settle

GROUPS = ("any-tower", "any-ground", "any-side")


def drawn(name: str, seed: int, folder: Path) -> Span:
    group = groups_by_name(name)[0]
    return group.survey(group.view.survey(folder), np.random.default_rng(seed))


@pytest.mark.parametrize("name", GROUPS)
def test_a_drawn_site_can_be_measured(name: str, tmp_path: Path) -> None:
    for seed in range(8):
        span = drawn(name, seed, tmp_path)
        lens, pose = load_intrinsics(span.camera.intrinsics), survey_pose(span)
        seen, _ = project(lens, pose, np.array([m.position for m in span.landmarks]))
        assert len(span.landmarks) >= anywhere.FEWEST
        assert inside(lens, seen).all()
        for conductor in (c for c in span.conductors if c.measured):
            state = WireState(0.5 * (conductor.sag_min_m + conductor.sag_max_m))
            points = wire_points(np.array(conductor.near), np.array(conductor.far), state, np.linspace(0, 1, 200))
            assert np.mean(inside(lens, project(lens, pose, points)[0])) > 0.3
            along, _, height = SpanFrame.of(span).to_span(points).T
            assert (height > np.interp(along, *np.array(span.ground.profile).T) + 2.0).all()


def test_no_two_are_alike_and_the_same_seed_gives_the_same(tmp_path: Path) -> None:
    one, again, other = (drawn("any-side", seed, tmp_path) for seed in (1, 1, 2))
    assert one == again
    assert one.conductors[0].near != other.conductors[0].near


def test_its_world_is_drawn_from_what_the_survey_states(tmp_path: Path) -> None:
    group = groups_by_name("any-tower")[0]
    setting = settle(replace(group, worlds=1), seed=4, index=0, folder=tmp_path)
    site = load_site(setting.survey)
    assert site.intrinsics.width == load_intrinsics(setting.survey.camera.intrinsics).width
    assert setting.scene.true != setting.survey
