"""Appearances: learnt where the reference's landmarks fix the camera, used where they fail, never a wrong number."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.port import GreyImage
from sagnode.estimate.register import register
from sagnode.estimate.remember import NEW_BELOW, remember
from sagnode.geometry.camera import FloatArray, project
from sagnode.match.appearances import KEPT_MAX, Appearance, Appearances, none_kept
from sagnode.pipeline import load_site, measure_burst
from sagnode.quality import Cause
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene
from sagnode.site import Site

NOON = datetime(2026, 6, 21, 12, 0, tzinfo=UTC)


@dataclass(frozen=True)
class View:
    """A site with its scene, and frames of it in other looks."""

    site: Site
    scene: Scene
    still: Moment

    def frame(self, *, changed: tuple[int, ...] = (), seed: int = 5, turn: float = 0.002) -> GreyImage:
        """A frame of the swaying camera in which the ``changed`` landmarks wear a coat of their own."""
        moment = replace(self.still, turn_rad=(turn, -turn, 0.0), seed=seed)
        image = render(self.scene, moment).image.copy()
        for i in changed:
            u, v = np.round(self.places(turn)[i]).astype(int)
            coat = np.random.default_rng(1000 + i).integers(0, 256, (41, 41)).astype(np.uint8)
            # it stays where the thing is
            image[v - 20 : v + 21, u - 20 : u + 21] = cv2.GaussianBlur(coat, (0, 0), 0.9)
        return image

    def places(self, turn: float = 0.002) -> FloatArray:
        """Where the landmarks are in it."""
        moment = replace(self.still, turn_rad=(turn, -turn, 0.0))
        positions = np.array([m.position for m in self.scene.true.landmarks])
        return project(self.scene.intrinsics, self.scene.pose_at(moment), positions)[0]


@pytest.fixture(scope="module")
def view(tmp_path_factory: pytest.TempPathFactory) -> View:
    folder: Path = tmp_path_factory.mktemp("view")
    scene, still = simple_scene()
    cv2.imwrite(str(folder / "reference.png"), render(scene, still).image)
    save_intrinsics(folder / "camera.yaml", scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(
        update={"intrinsics": folder / "camera.yaml", "reference_image": folder / "reference.png"}
    )
    pixels = project(scene.intrinsics, scene.pose, np.array([m.position for m in scene.true.landmarks]))[0]
    marks = tuple(
        mark.model_copy(update={"pixel": (float(u), float(v))})
        for mark, (u, v) in zip(scene.surveyed.landmarks, pixels, strict=True)
    )
    return View(load_site(scene.surveyed.model_copy(update={"camera": camera, "landmarks": marks})), scene, still)


def learnt(view: View, kept: Appearances, *frames: tuple[GreyImage, float]) -> Appearances:
    """What is kept after frames, each some hours after noon."""
    for image, hours in frames:
        kept = remember(view.site, image, kept, NOON + timedelta(hours=hours))
    return kept


@pytest.fixture(scope="module")
def wise(view: View) -> Appearances:
    """Every landmark has been seen changed, one at a time, and proven two hours later."""
    n = len(view.site.landmark_ids)
    kept = none_kept(n)
    for i in range(n):
        kept = learnt(view, kept, (view.frame(changed=(i,)), i), (view.frame(changed=(i,), seed=9), i + 2))
    assert all(any(a.proven for a in own) for own in kept)
    return kept


def test_frames_that_the_reference_serves_are_measured_to_the_last_bit_as_without(
    view: View, wise: Appearances
) -> None:
    image = view.frame()
    plain, with_kept = measure_burst(view.site, [image]), measure_burst(view.site, [image], wise)
    for before, after in zip(plain, with_kept, strict=True):
        assert after.estimates == before.estimates
        assert after.budget == before.budget
        assert after.landmarks_by_appearance == 0
        assert after.oldest_appearance_at is None


def test_a_new_look_is_on_trial_until_it_is_seen_again(view: View) -> None:
    once = learnt(view, none_kept(len(view.site.landmark_ids)), (view.frame(changed=(0,)), 0))
    assert [len(own) for own in once[:1]] == [1]
    assert not once[0][0].proven
    assert np.allclose(once[0][0].offset, (view.places()[0] + 0.5) % 1 - 0.5, atol=0.3)
    soon = learnt(view, once, (view.frame(changed=(0,), seed=6), 0.2))
    assert not soon[0][0].proven
    later = learnt(view, soon, (view.frame(changed=(0,), seed=7), 2))
    assert later[0][0].proven
    assert later[0][0].useful_at == NOON + timedelta(hours=2)


def test_nothing_is_learnt_of_what_looks_as_ever(view: View) -> None:
    n = len(view.site.landmark_ids)
    assert learnt(view, none_kept(n), (view.frame(), 0), (view.frame(seed=3), 3)) == none_kept(n)


def test_landmarks_that_the_reference_does_not_find_are_found_where_they_are(view: View, wise: Appearances) -> None:
    changed = (0, 1)
    image = view.frame(changed=changed, seed=21, turn=-0.004)
    without, _ = register(view.site, image)
    registered, reasons = register(view.site, image, wise)
    assert not reasons
    assert without.tracked is not None
    assert registered.tracked is not None
    assert not without.tracked.found[list(changed)].any()
    assert set(registered.tracked.cut_at) == set(changed)
    error = np.hypot(*(registered.tracked.pixels - view.places(-0.004))[registered.tracked.found].T)
    assert error.max() < 1.0  # half a pixel of it is the coat's, which is laid on whole pixels
    assert registered.tracked.sigma[0] > 0.25


def test_a_reading_lost_without_them_is_told_with_them(view: View, wise: Appearances) -> None:
    image = view.frame(changed=tuple(range(len(view.site.landmark_ids))), seed=22)
    plain = measure_burst(view.site, [image])
    assert all(m.reasons[0].cause is Cause.LANDMARKS_LOST for m in plain)
    told = measure_burst(view.site, [image], wise)
    assert any(m.estimates for m in told)
    truth = {name: state.sag_m for name, state in view.still.wires.items()}
    for m in told:
        assert m.landmarks_by_appearance >= 4
        assert m.oldest_appearance_at is not None
        if m.estimates:
            sag = m.estimates["inplane_sag"]
            assert abs(sag.value - truth[m.conductor]) < 3 * sag.u


def test_what_an_appearance_found_teaches_nothing(view: View, wise: Appearances) -> None:
    image = view.frame(changed=tuple(range(len(view.site.landmark_ids))), seed=23)
    assert remember(view.site, image, wise, NOON + timedelta(days=3)) is wise


def test_an_appearance_seen_elsewhere_is_dropped(view: View, wise: Appearances) -> None:
    image = view.frame(seed=24)
    own = wise[0][0]
    side = own.image.shape[0]
    u, v = np.round(view.places()[0] + np.array([26, 9])).astype(int)
    image[v - side // 2 : v + side // 2 + 1, u - side // 2 : u + side // 2 + 1] = own.image
    after = remember(view.site, image, wise, NOON + timedelta(days=4))
    assert all(a.cut_at != own.cut_at for a in after[0])


def test_a_passing_thing_is_never_used(view: View) -> None:
    kept = none_kept(len(view.site.landmark_ids))
    rng = np.random.default_rng(4)
    for k in range(12):
        image = view.frame(seed=30 + k)
        u, v = np.round(view.places()[2]).astype(int)
        image[v - 14 : v + 15, u - 14 : u + 15] = cv2.GaussianBlur(
            rng.integers(0, 255, (29, 29)).astype(np.uint8), (5, 5), 2
        )
        kept = learnt(view, kept, (image, k))
    assert len(kept[2]) <= KEPT_MAX
    assert not any(a.proven for a in kept[2])


@pytest.mark.parametrize("seed", range(8))
def test_appearances_recognise_nothing_in_other_pictures(view: View, wise: Appearances, seed: int) -> None:
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.integers(0, 255, (480, 640)).astype(np.uint8), (0, 0), 1.0 + seed % 4)
    registered, _ = register(view.site, texture, wise)
    assert registered.by_appearance == ()


def test_appearances_that_agree_on_no_movement_are_not_believed(view: View, wise: Appearances) -> None:
    rng = np.random.default_rng(1)
    image = np.asarray(90 + rng.integers(0, 3, (480, 640)), np.uint8)
    for (own, *_), (u, v) in zip(wise, np.round(view.places()).astype(int), strict=True):
        half = own.image.shape[0] // 2
        du, dv = rng.integers(-6, 7, 2)
        image[v + dv - half : v + dv + half + 1, u + du - half : u + du + half + 1] = own.image
    _, reasons = register(view.site, image, wise)
    assert [r.cause for r in reasons] == [Cause.LANDMARKS_LOST]


def test_the_least_useful_make_room(view: View) -> None:
    from sagnode.match.appearances import with_added

    def look(day: int, proofs: int) -> Appearance:
        at = NOON + timedelta(days=day)
        return Appearance(np.zeros((9, 9), np.uint8), np.zeros(2), at, at, proofs)

    kept = [look(day, proofs=1) for day in range(1, KEPT_MAX)]
    full = with_added(kept, look(9, 0))
    assert len(full) == KEPT_MAX
    fuller = with_added(full, look(10, 0))
    assert [a.cut_at.day - NOON.day for a in fuller if a.proven] == [1, 2, 3, 4, 5]
    assert not any(a.cut_at == NOON + timedelta(days=9) for a in fuller)
    proven = with_added([look(day, 1) for day in range(1, KEPT_MAX + 1)], look(12, 0))
    assert all(a.cut_at != NOON + timedelta(days=1) for a in proven)
    assert 0 < NEW_BELOW < 1


def test_landmarks_that_one_movement_does_not_put_there_do_not_turn_the_camera(view: View) -> None:
    before, _ = register(view.site, view.frame())
    image = view.frame()
    # two of them some pixels aside, as near as a similarity lets them be
    for i in (0, 1):
        u, v = np.round(view.places()[i]).astype(int)
        aside = image[v - 24 : v + 25, u - 24 : u + 25].copy()
        image[v - 22 : v + 27, u - 24 : u + 25] = aside
    registered, reasons = register(view.site, image)
    assert not reasons
    assert registered.tracked is not None
    assert not registered.tracked.found[[0, 1]].any()
    assert registered.tracked.count >= 4
    assert np.abs(registered.theta[:3] - before.theta[:3]).max() * view.site.intrinsics.fx < 0.5
