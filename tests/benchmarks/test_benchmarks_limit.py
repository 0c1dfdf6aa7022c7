"""The least-squares limit: a band's information by brute force, the truth as the node's unknowns, what it follows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import limit
from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.geometry.camera import project
from sagnode.geometry.ground import GroundProfile
from sagnode.pipeline import load_site
from sagnode.scene.canvas import normal_cdf
from sagnode.scene.catenary import PartialLoad, WireState
from sagnode.scene.render import render
from sagnode.scene.truth import pixel_curve
from sagnode.scene.wires import Seen
from sagnode.survey import SAG


def site_of(scene, folder: Path):
    file = folder / "camera.yaml"
    # the survey's lens is not kept in a scene; the true one without its errors is it
    save_intrinsics(file, simple_scene()[0].intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"intrinsics": file})
    return load_site(scene.surveyed.model_copy(update={"camera": camera}))


@pytest.mark.parametrize(("width", "psf"), [(0.12, 0.9), (0.8, 0.75), (4.0, 1.1)])
def test_the_information_of_a_band_is_what_its_pixels_add_up_to(width: float, psf: float) -> None:
    _, moment = simple_scene()
    moment = replace(moment, read_noise=2.0, shot_noise=0.0, psf_px=psf, exposure=1.0)
    seen = Seen(np.zeros(1), np.zeros(1), *(np.array([x], np.float32) for x in (-60.0, width, 170.0)))
    found = float(limit.information_per_pixel(seen, moment)[0])

    def row(offset: float) -> np.ndarray:
        x = np.arange(-15, 16) - offset
        return -60.0 * (normal_cdf((x + width / 2) / psf) - normal_cdf((x - width / 2) / psf)).astype(float)

    places = np.linspace(0.0, 1.0, 20, endpoint=False)
    energy = np.mean([np.sum(((row(p + 0.05) - row(p - 0.05)) / 0.1) ** 2) for p in places])
    assert found == pytest.approx(energy / (4.0 + 1 / 12), rel=0.02)


def test_at_the_true_unknowns_the_model_is_the_truth(tmp_path: Path) -> None:
    scene, moment = simple_scene(swing_deg=6.0, error_scale=1.0, seed=5)
    moment = replace(moment, turn_rad=(0.01, -0.02, 0.005), shift_m=(0.01, 0.0, -0.02))
    site = site_of(scene, tmp_path)
    for conductor, true in zip(site.conductors, scene.true.conductors, strict=True):
        theta = limit.true_theta(conductor.survey, scene, moment, true)
        camera, shape = conductor.survey.camera(theta), conductor.survey.shape(theta)
        modelled, _ = project(*camera, shape.points(np.linspace(0.0, 1.0, 301)))
        expected = pixel_curve(scene, moment, true, 301)
        seen = np.isfinite(expected[:, 0])
        np.testing.assert_allclose(modelled[seen], expected[seen], atol=1e-3)


def test_an_uneven_load_is_met_as_near_as_its_terms_come(tmp_path: Path) -> None:
    scene, _ = simple_scene(error_scale=1.0)
    state = WireState(2.0, 3.0, (PartialLoad(0.4, 0.9, 0.8),))
    _, moment = simple_scene({"L1": 2.0, "L2": 2.1})
    moment = replace(moment, wires={**moment.wires, "L1": state})
    conductor = site_of(scene, tmp_path).conductors[0]
    survey = replace(conductor.survey, load_u=limit.LOAD_U)
    theta = limit.true_theta(survey, scene, moment, scene.true.conductors[0])
    modelled, _ = project(*survey.camera(theta), survey.shape(theta).points(np.linspace(0.0, 1.0, 301)))
    expected = pixel_curve(scene, moment, scene.true.conductors[0], 301)
    seen = np.isfinite(expected[:, 0])
    assert np.abs(modelled[seen] - expected[seen]).max() < 0.25


def test_the_limit_follows_contrast_survey_and_what_is_seen(tmp_path: Path) -> None:
    scene, moment = simple_scene(backdrop="plain")
    site = site_of(scene, tmp_path)
    seen = render(scene, moment).seen
    clear = limit.limits(site, scene, moment, seen)["L1"]
    assert 1e-4 < clear["sag"] < 0.05
    assert clear["clearance"] > 0.7 * site.ground.height_u
    noisy = replace(moment, read_noise=20.0)
    assert limit.limits(site, scene, noisy, seen)["L1"]["sag"] > clear["sag"]
    sure = replace(site.conductors[0], survey=replace(site.conductors[0].survey, attachment_u=1e-4, position_u=1e-4))
    better = limit.limits(replace(site, conductors=(sure,)), scene, moment, seen)["L1"]
    assert better["sag"] < 0.8 * clear["sag"]
    # what is not seen at all is known by its prior alone
    blind = limit.limits(site, scene, moment, {})["L1"]
    assert blind["sag"] == pytest.approx(site.conductors[0].survey.prior_sigma()[SAG], rel=0.05)


def test_four_wires_of_a_bundle_say_more_than_one(tmp_path: Path) -> None:
    scene, moment = simple_scene(backdrop="plain")
    site = site_of(scene, tmp_path)
    moment = replace(moment, read_noise=30.0)
    one = render(scene, moment).seen
    single = limit.limits(site, scene, moment, one)["L1"]["sag"]
    fourfold = limit.limits(site, scene, moment, {"L1": one["L1"] * 4})["L1"]["sag"]
    assert fourfold < single


def test_between_two_points_of_the_ground_their_errors_average_out() -> None:
    ground = GroundProfile(np.array([0.0, 10.0, 40.0]), np.array([0.0, 1.0, 1.0]), np.array([[20.0, 22.0, 3.0]]), 0.1)
    rng = np.random.default_rng(0)
    for place in (0.0, 4.0, 10.0, 25.0, 40.0):
        drawn = [np.interp(place, ground.along, 0.1 * rng.standard_normal(3)) for _ in range(4000)]
        assert limit.ground_variance(ground, place) == pytest.approx(np.var(drawn), rel=0.1)
    assert limit.ground_variance(ground, 21.0) == pytest.approx(0.01)
