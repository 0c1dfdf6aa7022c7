"""Light from one side, snow and bare trees: what they change about a frame, and that they move nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from presets import preset_scene, typical_states
from sagnode.geometry.camera import project
from sagnode.scene.light import AMBIENT, SNOW_GREY, Light
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene


@pytest.fixture(scope="module")
def field() -> tuple[Scene, Moment]:
    scene = preset_scene("tower")
    noon = Moment(typical_states(scene.true), sun_azimuth_deg=180.0, sun_elevation_deg=45.0, cloud=0.0)
    return scene, noon


def test_an_ordinary_moment_knows_no_sides() -> None:
    light = Light.of(Moment({}, sun_azimuth_deg=90.0, sun_elevation_deg=30.0))
    for normal in np.eye(3):
        assert light.on_face(normal, 0.8) == 0.8
    assert light.on_bar(np.array([[0.0, 0, 0], [0, 0, 1]]), np.array([0.0, -9, 0]), 0.9) == 0.9
    assert light.snowed(64.0) == 64.0
    assert light.shadow(np.array([3.0, 4.0, 5.0])) == 1.0


def test_the_sun_lights_the_side_that_looks_at_it() -> None:
    light = Light.of(Moment({}, sun_azimuth_deg=90.0, sun_elevation_deg=30.0, cloud=0.0, relief=1.0))
    east = np.array([1.0, 0.0, 0.0])
    assert light.on_face(east, 1.0) > 1.0
    assert light.on_face(-east, 1.0) == AMBIENT
    overcast = replace(light, sun=0.0)
    assert overcast.on_face(east, 1.0) == AMBIENT


def test_snow_is_white_on_the_ground_and_moves_no_landmark(field: tuple[Scene, Moment]) -> None:
    scene, noon = field
    summer, winter = (render(scene, replace(noon, snow=snow)) for snow in (0.0, 1.0))
    foot = slice(-40, None)
    assert winter.image[foot].mean() > summer.image[foot].mean() + 50
    assert abs(float(winter.image[foot].mean()) - SNOW_GREY) < 25
    assert winter.truth["conductors"].keys() == summer.truth["conductors"].keys()
    # a target's centre stays the crossing of its quarters
    mark = next(m for m in scene.true.landmarks if "target" in m.id)
    (u, v), _ = project(scene.intrinsics, scene.pose_at(noon), np.array(mark.position))
    for rendered in (summer, winter):
        middle = rendered.image[round(float(v)) - 3 : round(float(v)) + 4, round(float(u)) - 3 : round(float(u)) + 4]
        assert middle[0, 0] < middle[0, -1] - 40
        assert middle[-1, 0] > middle[-1, -1] + 40


def test_shadow_lies_on_a_part_of_a_thing_and_wanders(field: tuple[Scene, Moment]) -> None:
    places = [np.array(m.position) for m in field[0].true.landmarks]
    edges = [
        [Light.of(Moment({}, sun_azimuth_deg=azimuth, cloud=0.0, relief=1.0)).shadow_edge(place) for place in places]
        for azimuth in (100.0, 165.0, 250.0)
    ]
    assert np.ptp(np.array(edges), axis=0).min() > 0.1
    assert np.abs(edges).max() <= 1.0
