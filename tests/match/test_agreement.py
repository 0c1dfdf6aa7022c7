"""Landmarks that agree: by chance in noise, which must not be believed, and truly, even where only a few are left."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from presets import simple_scene
from sagnode.geometry.camera import Intrinsics, project
from sagnode.match.agreement import chance_places, expected_by_chance, is_chance
from sagnode.match.landmarks import consensus, track
from sagnode.match.patches import Patch, cut_patch, peaks
from sagnode.scene.render import render

REACH = 68.0
LENS = Intrinsics(640, 480, 900.0, 900.0, 319.5, 239.5)
CLICKS = [(120.0, 110.0), (520.0, 120.0), (330.0, 240.0), (130.0, 380.0), (500.0, 370.0), (320.0, 110.0)]


def smooth_noise(seed: int) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal((480, 640)).astype(np.float32), (0, 0), 3.0)
    return np.clip(128 + 35 * noise / noise.std(), 0, 255).astype(np.uint8)


def patches_of(image: np.ndarray, clicks: Sequence[tuple[float, float]] = CLICKS) -> list[Patch | None]:
    return [cut_patch(image, click, 25) for click in clicks]


def test_landmarks_of_one_noise_are_not_recognised_in_another() -> None:
    patches = patches_of(smooth_noise(1000))
    agreed = 0
    for seed in range(30):
        image = smooth_noise(seed)
        options = [peaks(image, patch, REACH) if patch else [] for patch in patches]
        agreed += len(consensus(patches, options, LENS)) >= 3
        assert track(image, patches, REACH, LENS).count == 0
    # without a look at the odds they would have been believed now and then
    assert agreed > 0


def test_three_true_landmarks_of_six_are_believed() -> None:
    scene, still = simple_scene()
    picture = render(scene, still).image
    pixels = project(scene.intrinsics, scene.pose_at(still), np.array([m.position for m in scene.true.landmarks]))[0]
    patches = patches_of(picture, [(float(u), float(v)) for u, v in pixels])
    assert len(patches) >= 6
    image = picture.copy()
    for patch in patches[3:]:
        if patch is not None:
            u, v = np.round(patch.pixel).astype(int)
            image[max(0, v - 30) : v + 31, max(0, u - 30) : u + 31] = 90
    found = track(image, patches, 40.0, scene.intrinsics).found
    assert found[:3].all()
    assert not found[3:].any()


@pytest.mark.parametrize("level", [0.45, 0.6])
def test_as_many_places_are_alike_in_noise_as_is_expected(level: float) -> None:
    patches = [patch for patch in patches_of(smooth_noise(1000)) if patch is not None]
    counted = expected = 0.0
    for seed in range(12):
        image = smooth_noise(seed)
        for patch in patches:
            counted += min(4, len(peaks(image, patch, 40.0, level)))
            expected += min(4.0, chance_places(image, patch, (0.0, 0.0, level), 40.0))
    assert 0.4 * counted < expected < 2.5 * counted


def test_landmarks_that_share_pixels_are_one() -> None:
    image = smooth_noise(3)
    beside = [(300.0 + 8 * k, 200.0) for k in range(5)]
    patches = patches_of(image, [*beside, (500.0, 100.0)])
    chosen = dict.fromkeys(range(5), (2.0, 1.0, 0.99))
    places = {i: patch for i in chosen if (patch := patches[i]) is not None}
    offered = dict.fromkeys(chosen, 1.0)
    assert expected_by_chance(patches, places, chosen, offered, REACH, LENS) > 1e-4


def test_of_two_landmarks_nothing_is_said() -> None:
    image = smooth_noise(3)
    patches = patches_of(image, CLICKS[:2])
    assert not is_chance(image, patches, [[(0.0, 0.0, 0.6)], []], {0: (0.0, 0.0, 0.6)}, REACH, LENS)
