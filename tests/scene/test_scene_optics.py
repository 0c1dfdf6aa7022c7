"""Light and noise of a rendered frame against what is measured outdoors and what a sensor's photon transfer is."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from presets import preset_scene
from sagnode.geometry.camera import project
from sagnode.scene.catenary import WireState, wire_points
from sagnode.scene.optics import develop, exposure_and_gain, illumination, sunlight
from sagnode.scene.render import render
from sagnode.scene.site import demo_site
from sagnode.scene.spec import Moment


# A clear sky against the 110 000 lux of a high sun: civil twilight goes from some 410 to 585 lux at sunrise to 2 to 3.5
# with the sun 6° below the horizon (American Meteorological Society, Glossary of Meteorology, "civil twilight")
@pytest.mark.parametrize(("elevation", "least", "most"), [(65.0, 1e5, 1.2e5), (0.0, 410, 585), (-6.0, 2.0, 3.5)])
def test_light_falls_at_dusk_as_it_does_outdoors(elevation: float, least: float, most: float) -> None:
    assert least < 110_000 * illumination(Moment({}, sun_elevation_deg=elevation, cloud=0.0)) < most


def test_clouds_and_fog_take_the_shadows_and_not_all_the_light() -> None:
    clear, overcast = (Moment({}, sun_elevation_deg=45.0, cloud=cloud) for cloud in (0.0, 1.0))
    assert sunlight(clear) > 0.9
    assert sunlight(overcast) == 0.0
    assert 0.2 < illumination(overcast) / illumination(clear) < 0.4
    assert sunlight(Moment({}, cloud=0.0, fog_per_m=0.02)) < 1e-3


def test_the_exposure_holds_the_brightness_until_the_night() -> None:
    assert exposure_and_gain(Moment({}, sun_elevation_deg=65.0, cloud=0.0)) == (pytest.approx(1.0), 1.0)
    brightness, gain = exposure_and_gain(Moment({}, sun_elevation_deg=-5.0, cloud=0.0))
    assert brightness == pytest.approx(1.0) and gain > 1.0
    assert exposure_and_gain(Moment({}, sun_elevation_deg=-18.0, cloud=0.0))[0] < 0.01


@pytest.mark.parametrize("elevation", [65.0, -5.0])
def test_the_noise_of_a_developed_frame_is_the_photon_transfer(elevation: float) -> None:
    """Variance = gain · (read² + shot² · signal), on even patches; rounding to whole greys adds 1/12."""
    scene = preset_scene("lab")
    moment = Moment({}, sun_elevation_deg=elevation, cloud=0.0, read_noise=1.5, shot_noise=0.2)
    gain = exposure_and_gain(moment)[1]
    for signal in (30.0, 90.0, 160.0):
        even = np.full((scene.intrinsics.height, scene.intrinsics.width), signal, np.float32)
        patch = develop(scene, moment, even)[100:400, 100:400].astype(float)
        assert patch.mean() == pytest.approx(signal + 4.0, abs=0.3)
        assert patch.std() == pytest.approx(math.sqrt(gain * (2.25 + 0.04 * signal) + 1 / 12), rel=0.02)


def test_the_same_seed_gives_the_same_pixels() -> None:
    scene = preset_scene("lab")
    even = np.full((scene.intrinsics.height, scene.intrinsics.width), 90.0, np.float32)
    first, again, other = (develop(scene, Moment({}, seed=seed), even.copy()) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(("glare", "exposure", "drowned"), [(0.0, 1.0, False), (1.0, 1.0, False), (1.0, 1.6, True)])
def test_what_is_said_of_a_wire_is_what_glare_and_the_sensor_leave_of_it(
    glare: float, exposure: float, drowned: bool
) -> None:
    """Against the frame itself: the same without wires, less the one with them."""
    scene = demo_site().scene
    wires = {c.id: WireState(0.5 * (c.sag_min_m + c.sag_max_m), 0.0) for c in scene.surveyed.conductors}
    conductor = next(c for c in scene.true.conductors if c.id == "L1")
    ends = np.array(conductor.near), np.array(conductor.far)
    azimuth = math.degrees(math.atan2(*(ends[1] - ends[0])[:2]))
    sun = {"sun_elevation_deg": 3.0, "sun_azimuth_deg": azimuth}
    moment = Moment(wires, **sun, glare=glare, exposure=exposure, read_noise=0.0, shot_noise=0.0)
    frame, bare = render(scene, moment), render(scene, replace(moment, draw_wires=False))
    gone = cv2.dilate(np.abs(bare.image.astype(np.float32) - frame.image), np.ones((3, 3)))
    (seen,) = frame.seen["L1"]
    points = wire_points(*ends, moment.wires["L1"], seen.place)
    u, v = np.rint(project(scene.intrinsics, scene.pose_at(moment), points)[0]).astype(int).T
    thick = seen.width > 1.5
    stated = seen.contrast(moment.psf_px)[thick]
    measured = gone[np.clip(v, 0, len(gone) - 1), np.clip(u, 0, gone.shape[1] - 1)][thick]
    assert np.median(np.abs(measured - stated)) < 3.0
    assert float(np.mean(stated < 1.0)) == pytest.approx(float(np.mean(measured < 1.0)), abs=0.05)
    assert bool(np.mean(measured < 1.0) > 0.1) is drowned
