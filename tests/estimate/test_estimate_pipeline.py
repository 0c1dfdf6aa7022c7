"""The whole way of a frame on rendered scenes: numbers near the truth, honest intervals, and refusals with reasons."""

import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.config.node import Measure
from sagnode.config.span import Stringing
from sagnode.errors import ConfigError
from sagnode.geometry.camera import project
from sagnode.match.library import Shelf
from sagnode.measurement import ConductorMeasurement
from sagnode.pipeline import load_site, measure_burst, measure_frame
from sagnode.quality import Cause, Validity
from sagnode.scene.render import Rendered, render
from sagnode.scene.spec import Moment, Scene
from sagnode.site import Site


@pytest.fixture(scope="module")
def scene_and_moment() -> tuple[Scene, Moment]:
    return simple_scene({"L1": 1.8, "L2": 2.3}, error_scale=1.0, seed=4)


@pytest.fixture(scope="module")
def site(scene_and_moment: tuple[Scene, Moment], tmp_path_factory: pytest.TempPathFactory) -> Site:
    return site_of(*scene_and_moment, tmp_path_factory.mktemp("site"))


def site_of(scene: Scene, moment: Moment, directory: Path) -> Site:
    """The surveyed site of a scene, with the picture of a moment as its reference."""
    reference, lens = directory / "reference.png", directory / "camera.yaml"
    cv2.imwrite(str(reference), render(scene, moment).image)
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"reference_image": reference, "intrinsics": lens})
    return load_site(scene.surveyed.model_copy(update={"camera": camera}), Measure())


def truth(rendered: Rendered, conductor: str, field: str) -> float:
    return float(rendered.truth["conductors"][conductor][field])


def invalid_for(measurements: list[ConductorMeasurement], cause: Cause) -> bool:
    return all(
        m.validity is Validity.INVALID and not m.estimates and cause in [r.cause for r in m.reasons]
        for m in measurements
    )


def test_sag_and_clearance_are_near_the_truth_within_their_uncertainty(
    scene_and_moment: tuple[Scene, Moment], site: Site
) -> None:
    scene, still = scene_and_moment
    moved = replace(still, turn_rad=(0.004, 0.006, -0.002), seed=11)
    rendered = render(scene, moved)
    for m in measure_burst(site, [rendered.image]):
        assert m.validity is not Validity.INVALID, m.reasons
        for stem in ("sag", "clearance", "lowest_height"):
            estimate = m.estimates[stem]
            error = estimate.value - truth(rendered, m.conductor, f"{stem}_m")
            assert abs(error) < 4 * estimate.u
            assert 0.001 < estimate.u < 0.1
            assert estimate.lo < estimate.value < estimate.hi
        # the parts of the budget are the whole of the uncertainty
        parts = np.array(list(m.budget["sag"].values()))
        assert np.sqrt(np.sum(parts**2)) == pytest.approx(m.estimates["sag"].u, rel=1e-6)
        assert m.visible_share is not None
        assert m.visible_share > 0.3
        assert m.landmarks_used >= 5


def test_the_drawing_lies_on_the_true_curve(scene_and_moment: tuple[Scene, Moment], site: Site) -> None:
    scene, still = scene_and_moment
    rendered = render(scene, still)
    for m in measure_burst(site, [rendered.image]):
        true_curve = np.array(rendered.truth["conductors"][m.conductor]["pixels"])
        assert m.drawing is not None
        curve = m.drawing.curve[np.isfinite(m.drawing.curve).all(axis=1)]
        distance = np.hypot(*(true_curve[:, None] - curve[None]).transpose(2, 0, 1)).min(axis=1)
        assert np.median(distance) < 0.5


def test_a_burst_is_combined_and_one_bad_frame_is_left_out(scene_and_moment: tuple[Scene, Moment], site: Site) -> None:
    scene, still = scene_and_moment
    frames = [render(scene, replace(still, seed=20 + k)).image for k in range(3)]
    frames.append(np.full_like(frames[0], 3))
    for m in measure_burst(site, frames):
        assert m.validity is not Validity.INVALID
        assert (m.frames_used, m.frames_rejected) == (3, 1)


def test_pictures_of_a_burst_are_asked_for_one_by_one_and_let_go(
    scene_and_moment: tuple[Scene, Moment], site: Site
) -> None:
    scene, moment = scene_and_moment
    images = [render(scene, replace(moment, seed=seed)).image for seed in (1, 2)]
    handed_on: list[weakref.ref[np.ndarray]] = []

    def pictures() -> Iterator[np.ndarray]:
        for image in images:
            assert all(picture() is None for picture in handed_on), "a picture that is measured is still held"
            read = image.copy()
            handed_on.append(weakref.ref(read))
            yield read
            del read

    one_by_one = measure_burst(site, pictures())
    assert len(handed_on) == 2
    assert [m.estimates for m in one_by_one] == [m.estimates for m in measure_burst(site, images)]


def test_a_frame_of_a_burst_is_not_persuaded_by_the_frame_before_it(
    scene_and_moment: tuple[Scene, Moment], site: Site
) -> None:
    scene, still = scene_and_moment
    # the first frame of the burst shows the wires elsewhere
    lower = {name: replace(wire, sag_m=wire.sag_m + 0.3) for name, wire in still.wires.items()}
    wrong = render(scene, replace(still, wires=lower))
    image = render(scene, replace(still, seed=31)).image
    shelf = Shelf()
    before = measure_frame(site, wrong.image, shelf=shelf)
    after = measure_frame(site, image, shelf=shelf)
    for first, m, alone in zip(before, after, measure_frame(site, image), strict=True):
        assert first.estimates["sag"].value == pytest.approx(truth(wrong, m.conductor, "sag_m"), abs=0.1)
        assert m.validity is alone.validity
        # not pulled to what the first frame said, which is eight uncertainties away
        sag, by_itself = m.estimates["sag"], alone.estimates["sag"]
        assert sag.value == pytest.approx(by_itself.value, abs=by_itself.u)


def test_no_wire_no_number(scene_and_moment: tuple[Scene, Moment], site: Site) -> None:
    scene, still = scene_and_moment
    image = render(scene, replace(still, draw_wires=False)).image
    for m in measure_burst(site, [image]):
        assert m.validity is Validity.INVALID
        assert not m.estimates
        assert m.reasons


@pytest.mark.parametrize(
    ("image", "cause"),
    [
        (np.full((480, 640), 4, np.uint8), Cause.DARK),
        (np.full((480, 640), 255, np.uint8), Cause.OVEREXPOSED),
        (np.full((480, 640), 128, np.uint8), Cause.LOW_CONTRAST),
        (np.zeros((240, 320), np.uint8), Cause.BAD_CALIBRATION),
        (np.random.default_rng(1).integers(0, 255, (480, 640)).astype(np.uint8), Cause.LANDMARKS_LOST),
    ],
)
def test_pictures_that_show_nothing_are_refused_with_their_reason(site: Site, image: np.ndarray, cause: Cause) -> None:
    assert invalid_for(measure_burst(site, [image]), cause)


def test_a_knocked_camera_is_refused(scene_and_moment: tuple[Scene, Moment], site: Site) -> None:
    scene, still = scene_and_moment
    far = 1.2 * site.max_movement_px / scene.intrinsics.fx
    image = render(scene, replace(still, turn_rad=(0.0, far, 0.0))).image
    measurements = measure_burst(site, [image])
    causes = {r.cause for m in measurements for r in m.reasons}
    assert all(m.validity is Validity.INVALID for m in measurements)
    assert causes & {Cause.CAMERA_MOVED, Cause.LANDMARKS_LOST}


def test_landmarks_that_moved_apart_are_told_from_landmarks_not_seen(
    scene_and_moment: tuple[Scene, Moment], site: Site
) -> None:
    image = render(*scene_and_moment).image
    moved, half = image.copy(), 24
    for number, (u, v) in enumerate(np.rint(site.landmark_clicks).astype(int)):
        du, dv = ((0, 3), (0, -3), (3, 0), (-3, 0), (3, 3), (-3, -3))[number % 6]
        there = image[v + dv - half : v + dv + half, u + du - half : u + du + half]
        moved[v - half : v + half, u - half : u + half] = there
    mirrored = np.ascontiguousarray(image[:, ::-1])
    for picture, said in ((moved, "look like themselves"), (mirrored, "landmarks recognised")):
        measurements = measure_burst(site, [picture])
        assert invalid_for(measurements, Cause.LANDMARKS_LOST)
        assert all(said in m.reasons[0].text for m in measurements)


def test_a_missing_reference_picture_is_a_fault_of_the_configuration(
    scene_and_moment: tuple[Scene, Moment], tmp_path: Path
) -> None:
    scene, _ = scene_and_moment
    lens = tmp_path / "camera.yaml"
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"intrinsics": lens, "reference_image": tmp_path / "none.png"})
    with pytest.raises(ConfigError, match=r"reference_image.*none\.png"):
        load_site(scene.surveyed.model_copy(update={"camera": camera}))


def test_an_unwatched_camera_gives_wider_and_questionable_readings(
    scene_and_moment: tuple[Scene, Moment], site: Site, tmp_path: Path
) -> None:
    scene, still = scene_and_moment
    image = render(scene, still).image
    lens = tmp_path / "camera.yaml"
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"intrinsics": lens})
    unwatched = load_site(scene.surveyed.model_copy(update={"camera": camera}))
    for watched, m in zip(measure_burst(site, [image]), measure_burst(unwatched, [image]), strict=True):
        assert m.validity is not Validity.GOOD
        if m.estimates:
            assert m.estimates["clearance"].u > watched.estimates["clearance"].u
            assert Cause.LANDMARKS_LOST in [r.cause for r in m.reasons]


def test_an_uncertainty_above_the_configured_limit_is_questionable(
    scene_and_moment: tuple[Scene, Moment], site: Site
) -> None:
    scene, still = scene_and_moment
    strict = replace(site, limits=site.limits.model_copy(update={"clearance_u_max_m": 1e-4}))
    for m in measure_burst(strict, [render(scene, still).image]):
        assert m.validity is Validity.QUESTIONABLE
        assert Cause.UNCERTAIN in [r.cause for r in m.reasons]
        assert m.estimates


def test_temperature_is_derived_in_calm_air_and_withheld_in_wind(tmp_path: Path) -> None:
    stringing = Stringing(
        temperature_c=15.0, tension_n=2500.0, section_mm2=282.5, modulus_gpa=77.0, expansion_per_k=18.9e-6
    )
    for swing, told in ((0.0, True), (12.0, False)):
        scene, moment = simple_scene({"L1": 1.8, "L2": 2.2}, swing, backdrop="plain")
        conductors = tuple(c.model_copy(update={"stringing": stringing}) for c in scene.surveyed.conductors)
        scene = replace(scene, surveyed=scene.surveyed.model_copy(update={"conductors": conductors}))
        directory = tmp_path / str(swing)
        directory.mkdir()
        site = site_of(scene, simple_scene(backdrop="plain")[1], directory)
        measured = [m for m in measure_burst(site, [render(scene, moment).image]) if m.estimates]
        assert measured
        assert all(("conductor_temp" in m.estimates) is told for m in measured)


@pytest.mark.parametrize("wrong", [{"tension_n": 250.0}, {"temperature_c": -270.0}, {"tension_n": 1e-6}])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_temperature_that_no_conductor_can_have_is_not_told(
    scene_and_moment: tuple[Scene, Moment], tmp_path: Path, wrong: dict[str, float]
) -> None:
    """Stringing data in decanewton, from a wrong line, or that give no number at all; the rest is told all the same."""
    data = {"temperature_c": 15.0, "tension_n": 2500.0, "section_mm2": 282.5, "modulus_gpa": 77.0}
    stringing = Stringing(**{**data, **wrong}, expansion_per_k=18.9e-6)
    scene, moment = scene_and_moment
    conductors = tuple(c.model_copy(update={"stringing": stringing}) for c in scene.surveyed.conductors)
    scene = replace(scene, surveyed=scene.surveyed.model_copy(update={"conductors": conductors}))
    for m in measure_burst(site_of(scene, moment, tmp_path), [render(scene, moment).image]):
        assert {"sag", "clearance", "tension"} <= m.estimates.keys()
        assert "conductor_temp" not in m.estimates | m.budget


def test_without_undistortion_the_lens_is_taken_for_perfect(
    scene_and_moment: tuple[Scene, Moment], tmp_path: Path
) -> None:
    scene, _ = scene_and_moment
    lens = tmp_path / "camera.yaml"
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"intrinsics": lens})
    span = scene.surveyed.model_copy(update={"camera": camera, "landmarks": ()})
    plain = load_site(span, Measure(undistort=False))
    assert plain.intrinsics.distortion == ()
    corner = np.array([3.0, 20.0, 10.0])
    bent = project(load_site(span).intrinsics, plain.pose, corner)[0]
    assert np.hypot(*(bent - project(plain.intrinsics, plain.pose, corner)[0])) > 0.05
