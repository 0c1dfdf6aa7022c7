"""Rendered frames: wires and landmarks where the geometry says, of the right weight, and every kind of trouble."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from presets import VIEWS, preset_scene, simple_scene, typical_states
from sagnode.config.span import Conductor
from sagnode.geometry.camera import project
from sagnode.scene.catenary import PartialLoad, PointLoad, WireState, wire_points
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, OtherWire, Scene, SpanFrame, Tree, World
from sagnode.scene.truth import pixel_curve

Floats = NDArray[np.float64]


def bilinear(image: NDArray[np.uint8], pixels: Floats) -> Floats:
    u, v = pixels[..., 0], pixels[..., 1]
    u0 = np.clip(np.floor(u).astype(int), 0, image.shape[1] - 2)
    v0 = np.clip(np.floor(v).astype(int), 0, image.shape[0] - 2)
    fu, fv = u - u0, v - v0
    grey = image.astype(np.float64)
    top = grey[v0, u0] * (1 - fu) + grey[v0, u0 + 1] * fu
    bottom = grey[v0 + 1, u0] * (1 - fu) + grey[v0 + 1, u0 + 1] * fu
    return np.asarray(top * (1 - fv) + bottom * fv)


def across(scene: Scene, moment: Moment, conductor: Conductor, reach: float = 9.0) -> tuple[Floats, Floats, Floats]:
    """Pixels (N, 2) one apart along the true curve, offsets (M,) and the darkening (N, M) across it."""
    image = render(scene, moment).image
    curve = pixel_curve(scene, moment, conductor, 20001)
    curve = curve[np.isfinite(curve[:, 0])]
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    steps = np.arange(0.0, length[-1], 1.0)
    curve = np.stack([np.interp(steps, length, curve[:, k]) for k in (0, 1)], axis=1)
    tangent = np.gradient(curve, axis=0)
    tangent /= np.hypot(*tangent.T)[:, None]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    offsets = np.arange(-reach, reach + 0.01, 0.25)
    pixels = curve[:, None] + offsets[:, None] * normal[:, None]
    height, width = image.shape
    inside = (pixels > 1).all(axis=(1, 2)) & (pixels[..., 0] < width - 2).all(1) & (pixels[..., 1] < height - 2).all(1)
    darkness = scene.world.plain_grey + 4.0 - bilinear(image, pixels[inside])
    return curve[inside], offsets, darkness


def silent(moment: Moment) -> Moment:
    """Without noise, air or cloud, so that only geometry and rounding to 8 bits are left."""
    return replace(moment, read_noise=0.0, shot_noise=0.0, fog_per_m=0.0, cloud=0.0)


def one_wire(diameter: float) -> tuple[Scene, Moment, Conductor]:
    scene, moment = simple_scene({"L1": 1.9}, 6.0, backdrop="plain", landmark_kinds={f"m{k}": "none" for k in range(9)})
    conductor = scene.true.conductors[0].model_copy(update={"diameter_m": diameter})
    true = scene.true.model_copy(update={"conductors": (conductor,)})
    return replace(scene, true=true), silent(moment), conductor


@pytest.mark.parametrize("diameter", [0.004, 0.02, 0.06])
def test_a_wire_lies_on_its_projected_catenary_to_a_hundredth_of_a_pixel(diameter: float) -> None:
    scene, moment, conductor = one_wire(diameter)
    _, offsets, darkness = across(scene, moment, conductor)
    strong = darkness.max(axis=1) > 12
    assert strong.sum() > 60
    weight = darkness[strong].sum(axis=0)
    assert abs((weight * offsets).sum() / weight.sum()) < 0.01


@pytest.mark.parametrize("diameter", [0.004, 0.02, 0.06])
def test_a_wire_weighs_as_much_as_its_physical_width(diameter: float) -> None:
    """The darkening integrated across a wire is its projected width times its contrast, however thin it is."""
    scene, moment, conductor = one_wire(diameter)
    curve, _, darkness = across(scene, moment, conductor)
    points = wire_points(
        np.array(conductor.near), np.array(conductor.far), moment.wires["L1"], np.linspace(0, 1, 20001)
    )
    pixels, _ = project(scene.intrinsics, scene.pose, points)
    distance = np.linalg.norm(points - scene.pose.position, axis=1)
    nearest = np.array([np.nanargmin(np.hypot(*(pixels - p).T)) for p in curve[::20]])
    width = scene.intrinsics.fx * diameter / distance[nearest]
    # above the horizon, where the wire shows its shade: 46 + 12 of sunlight to 112 + 78 of it, here nearly all shade
    high = (points[nearest, 2] - scene.pose.position[2]) / distance[nearest] > 0.12
    weight = darkness[::20].sum(axis=1) * 0.25
    contrast = weight[high] / width[high]
    assert np.median(contrast) == pytest.approx(scene.world.plain_grey - 58.0, rel=0.06)
    assert np.ptp(contrast) / np.median(contrast) < 0.15


def test_the_same_seed_gives_the_same_pixels_and_another_other_noise() -> None:
    scene, moment = simple_scene(backdrop="country")
    first = render(scene, moment)
    again = render(*simple_scene(backdrop="country"))
    other = render(scene, replace(moment, seed=99))
    assert np.array_equal(first.image, again.image)
    assert first.truth == again.truth
    assert not np.array_equal(first.image, other.image)
    assert first.image.dtype == np.uint8
    assert first.image.shape == (480, 640)


def test_survey_targets_stand_where_the_true_camera_sees_them() -> None:
    scene, moment = simple_scene(error_scale=1.0)
    moment = replace(silent(moment), turn_rad=(0.004, -0.003, 0.006), shift_m=(0.02, 0.0, -0.01))
    image = render(scene, moment).image
    points = np.array([m.position for m in scene.true.landmarks])
    pixels, _ = project(scene.intrinsics, scene.pose_at(moment), points)
    start = np.rint(pixels).astype(np.float32).reshape(-1, 1, 2)
    found = cv2.cornerSubPix(image, start, (4, 4), (-1, -1), (3, 60, 1e-4)).reshape(-1, 2)
    assert np.abs(found - pixels).max() < 0.08


@settings(max_examples=8, deadline=None)
@given(x=st.floats(-0.01, 0.01), y=st.floats(-0.01, 0.01), z=st.floats(-0.01, 0.01))
def test_a_turn_of_the_camera_moves_landmarks_and_wires_alike(x: float, y: float, z: float) -> None:
    scene, moment = simple_scene({"L1": 1.9}, backdrop="plain")
    moved = replace(silent(moment), turn_rad=(x, y, z))
    _, offsets, darkness = across(scene, moved, scene.true.conductors[0], reach=4.0)
    weight = np.median(darkness[darkness.max(axis=1) > 20], axis=0)
    assert abs((weight * offsets).sum() / weight.sum()) < 0.05


def wire_contrast(scene: Scene, moment: Moment, name: str = "L1") -> float:
    """Difference between the picture with and without its wires on a true curve, grey levels."""
    conductor = next(c for c in scene.true.conductors if c.id == name)
    curve = pixel_curve(scene, moment, conductor, 3000)
    curve = curve[np.isfinite(curve[:, 0])]
    curve = curve[(curve > 3).all(1) & (curve < np.array([636, 476])).all(1)]
    quiet = replace(moment, read_noise=0.0, shot_noise=0.0)
    with_wires = bilinear(render(scene, quiet).image, curve)
    without = bilinear(render(scene, replace(quiet, draw_wires=False)).image, curve)
    return float(np.median(np.abs(with_wires - without)))


def test_a_wire_is_dark_on_the_sky_and_bright_before_trees() -> None:
    scene, moment = simple_scene(backdrop="country")
    moment = replace(silent(moment), cloud=0.0)
    conductor = scene.true.conductors[0]
    curve = pixel_curve(scene, moment, conductor, 4000)
    ahead = wire_points(np.array(conductor.near), np.array(conductor.far), moment.wires["L1"], np.linspace(0, 1, 4000))
    seen = np.isfinite(curve[:, 0])
    difference = np.full(4000, np.nan)
    without = render(scene, replace(moment, draw_wires=False)).image
    difference[seen] = bilinear(render(scene, moment).image, curve[seen]) - bilinear(without, curve[seen])
    sky = seen & (ahead[:, 2] > scene.pose.position[2] + 1.0)
    assert np.nanmedian(difference[sky]) < -15
    low = replace(
        scene,
        true=scene.true.model_copy(
            update={
                "camera": scene.true.camera.model_copy(update={"position": (0.3, 0.6, 12.0), "elevation_deg": -8.0})
            }
        ),
    )
    curve = pixel_curve(low, moment, conductor, 4000)
    seen = np.isfinite(curve[:, 0])
    change = bilinear(render(low, moment).image, curve[seen]) - bilinear(
        render(low, replace(moment, draw_wires=False)).image, curve[seen]
    )
    assert np.median(change) > 10


def test_fog_night_and_a_covered_lens_take_the_wire_away() -> None:
    scene, moment = simple_scene(backdrop="country")
    clear = wire_contrast(scene, moment)
    assert clear > 10
    assert wire_contrast(scene, replace(moment, fog_per_m=0.02)) < 0.85 * clear
    assert wire_contrast(scene, replace(moment, fog_per_m=0.2)) < 1.5
    assert wire_contrast(scene, replace(moment, sun_elevation_deg=-20.0)) == 0
    assert wire_contrast(scene, replace(moment, lens="covered")) == 0
    assert wire_contrast(scene, replace(moment, lens="fogged")) < 2


def test_night_is_dark_and_dusk_is_noisy() -> None:
    scene, moment = simple_scene(backdrop="plain")
    noon, dusk, night = (render(scene, replace(moment, sun_elevation_deg=e)).image for e in (50.0, -5.0, -16.0))
    assert night.mean() < 12
    assert abs(float(dusk.mean()) - float(noon.mean())) < 15
    corner = (slice(380, 470), slice(10, 120))
    assert dusk[corner].std() > 1.7 * noon[corner].std()


def test_a_tree_before_the_wire_hides_it_and_the_truth_says_so() -> None:
    scene, moment = simple_scene({"L2": 2.1}, backdrop="plain")
    free = render(scene, moment).truth["conductors"]["L2"]["visible_share"]  # type: ignore[index]
    frame = SpanFrame.of(scene.true)
    place = frame.to_span(np.array([2.0, 9.0, 0.0]))
    hidden = replace(scene, world=replace(scene.world, trees=(Tree(place[0], place[1], 9.0, 2.0),)))
    covered = render(hidden, moment).truth["conductors"]["L2"]["visible_share"]  # type: ignore[index]
    assert free > 0.85
    assert covered < free - 0.1


def test_a_bundle_is_drawn_as_so_many_wires() -> None:
    scene, moment = simple_scene({"L1": 1.9}, backdrop="plain", width=1280, height=960)
    conductor = scene.true.conductors[0].model_copy(
        update={"sub_conductors": 2, "bundle_spacing_m": 0.4, "diameter_m": 0.02}
    )
    scene = replace(scene, true=scene.true.model_copy(update={"conductors": (conductor,)}))
    _, offsets, darkness = across(scene, silent(moment), conductor, reach=40.0)
    near = darkness[5:30].mean(axis=0)
    middle = np.abs(offsets) < 1.5
    left, right = offsets < -3, offsets > 3
    assert near[left].max() > 4 * max(near[middle].max(), 1.0)
    assert near[right].max() > 4 * max(near[middle].max(), 1.0)


def test_unknown_wires_and_loads_are_drawn() -> None:
    scene, moment = simple_scene(backdrop="plain")
    crossing = OtherWire((-30.0, 40.0, 9.0), (30.0, 42.0, 9.0), 0.8)
    with_other = replace(scene, world=replace(scene.world, other_wires=(crossing,)))
    quiet = silent(moment)
    assert np.abs(render(with_other, quiet).image.astype(int) - render(scene, quiet).image).max() > 10
    loaded = replace(quiet, wires={"L1": WireState(1.9, loads=(PointLoad(0.4, 0.3),))})
    truth = render(scene, loaded).truth["conductors"]["L1"]  # type: ignore[index]
    assert truth["loads"] == ["PointLoad(at=0.4, share=0.3, size_m=0.0)"]
    assert truth["lowest_along_m"] < 27
    hanging = replace(quiet, wires={"L1": WireState(1.9, loads=(PointLoad(0.4, 0.3, 0.6),))})
    changed = render(scene, hanging).image.astype(int) - render(scene, loaded).image
    place = pixel_curve(scene, hanging, scene.true.conductors[0], 1001)[400]
    v, u = np.argwhere(np.abs(changed) > 10).mean(axis=0)
    assert abs(u - place[0]) < 2
    assert 0 < v - place[1] < 15


def test_ice_makes_its_part_of_the_wire_thicker() -> None:
    scene, moment = simple_scene(backdrop="plain")
    quiet = silent(moment)
    iced = replace(quiet, wires={"L1": WireState(1.9, loads=(PartialLoad(0.5, 0.8, 0.0, 0.03),))})
    bare = replace(quiet, wires={"L1": WireState(1.9)})
    changed = np.argwhere(np.abs(render(scene, iced).image.astype(int) - render(scene, bare).image) > 3)[:, ::-1]
    curve = pixel_curve(scene, bare, scene.true.conductors[0], 1001)
    nearest = np.nanargmin(np.hypot(*(changed[:, None] - curve[None, ::5]).transpose(2, 0, 1)), axis=1) * 5 / 1000
    assert 0.48 < nearest.min() < 0.55
    assert 0.75 < nearest.max() < 0.82


def test_what_is_seen_of_a_wire_is_told_point_by_point() -> None:
    scene, moment = simple_scene(backdrop="plain")
    rendered = render(scene, silent(moment))
    (seen,) = rendered.seen["L2"]
    truth = rendered.truth["conductors"]["L2"]  # type: ignore[index]
    assert float(seen.share.sum()) == pytest.approx(truth["visible_share"], abs=1e-3)
    assert np.all(np.diff(seen.place) > 0)
    curve = pixel_curve(scene, silent(moment), scene.true.conductors[1], 20001)
    steps = np.hypot(*np.diff(curve[np.round(seen.place * 20000).astype(int)], axis=0).T)
    assert np.nanmedian(steps) == pytest.approx(1.0, abs=0.1)
    depth = np.linalg.norm(
        wire_points(
            np.array(scene.true.conductors[1].near), np.array(scene.true.conductors[1].far), WireState(2.1), seen.place
        )
        - scene.pose.position,
        axis=1,
    )
    np.testing.assert_allclose(seen.width, 0.02 * scene.intrinsics.fx / depth, rtol=1e-4)
    # dark wires on an even grey: what the picture has in the middle of the wire
    _, offsets, darkness = across(scene, silent(moment), scene.true.conductors[1])
    middle = np.median(darkness[:, np.argmin(np.abs(offsets))])
    assert float(np.median(seen.contrast(moment.psf_px))) == pytest.approx(middle, rel=0.15)


def test_haze_takes_the_clear_part_before_the_visible_one() -> None:
    scene, moment = simple_scene(backdrop="plain")
    clear, hazy = (render(scene, replace(moment, fog_per_m=f)).truth["conductors"]["L1"] for f in (0.0, 0.05))  # type: ignore[index]
    assert hazy["visible_share"] == clear["visible_share"]
    assert hazy["snr"] < clear["snr"]
    assert hazy["clear_share"] < min(hazy["resolved_share"], clear["clear_share"])


def test_strong_clouds_stand_out_more() -> None:
    scene, moment = simple_scene(backdrop="country")
    cloudy = replace(silent(moment), cloud=0.5)
    fair, strong = (render(scene, replace(cloudy, cloud_contrast=c)).image[:120] for c in (1.0, 3.0))
    assert strong.std() > 1.3 * fair.std()


@pytest.mark.parametrize("turn", [-0.64, 0.32, 0.34])
def test_a_wire_that_passes_just_beside_the_frame_is_not_seen(turn: float) -> None:
    scene, moment = simple_scene({"L1": 1.9}, backdrop="plain")
    beside = replace(moment, turn_rad=(turn, 0.0, 0.0))
    rendered = render(scene, beside)
    assert rendered.truth["conductors"]["L1"]["visible_share"] == 0.0  # type: ignore[index]


def test_conductors_that_do_not_hang_there_are_not_true() -> None:
    scene, moment = simple_scene({"L2": 2.0})
    assert list(render(scene, moment).truth["conductors"]) == ["L2"]  # type: ignore[call-overload]


@pytest.mark.parametrize("view", [v for v in VIEWS if v != "field"])
def test_presets_show_most_of_their_span_and_all_landmarks(view: str) -> None:
    scene = preset_scene(view, seed=2, error_scale=1.0)  # type: ignore[arg-type]
    rendered = render(scene, Moment(typical_states(scene.surveyed)))
    for name, seen in rendered.truth["conductors"].items():  # type: ignore[attr-defined]
        assert seen["visible_share"] > 0.85, name
    for mark in scene.surveyed.landmarks:
        assert 10 < mark.pixel[0] < scene.intrinsics.width - 10, mark.id
        assert 10 < mark.pixel[1] < scene.intrinsics.height - 10, mark.id


def test_a_knock_that_turns_the_camera_away_leaves_no_wire() -> None:
    scene, moment = simple_scene(backdrop="country")
    seen = render(scene, replace(moment, turn_rad=(0.0, 1.6, 0.0))).truth["conductors"]
    assert all(s["visible_share"] < 0.02 for s in seen.values())  # type: ignore[attr-defined]


def test_glare_rain_and_drops_change_the_picture_only_where_they_should() -> None:
    scene, moment = simple_scene(backdrop="country")
    plain = render(scene, moment).image.astype(float)
    sunny = replace(moment, glare=1.0, sun_azimuth_deg=0.0, sun_elevation_deg=8.0)
    assert render(scene, sunny).image.mean() > plain.mean() + 30
    assert (render(scene, replace(moment, rain=1.0)).image != plain).mean() > 0.3
    wet = render(scene, replace(moment, lens="drops", read_noise=0.0, shot_noise=0.0)).image.astype(float)
    dry = render(scene, replace(moment, read_noise=0.0, shot_noise=0.0)).image
    assert 0.005 < (np.abs(wet - dry) > 2).mean() < 0.5


def test_worlds_can_be_bare() -> None:
    scene, moment = simple_scene(backdrop="country")
    bare = replace(scene, world=World(forest_m=0.0, towers=True))
    assert render(bare, moment).image.std() > 5


def test_a_landmark_that_the_survey_leaves_out_stands_there_all_the_same() -> None:
    scene = preset_scene("tower", seed=2)
    moment = Moment(typical_states(scene.surveyed))
    fewer = scene.surveyed.model_copy(update={"landmarks": scene.surveyed.landmarks[1:]})
    np.testing.assert_array_equal(render(replace(scene, surveyed=fewer), moment).image, render(scene, moment).image)
