"""Landmarks: tracked through movement, light and clutter on rendered frames, and refused where they are not."""

from dataclasses import replace

import numpy as np

from presets import simple_scene
from sagnode.geometry.camera import Intrinsics, project
from sagnode.match.landmarks import consensus, track
from sagnode.match.patches import Patch, cut_patch
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene


def true_pixels(scene: Scene, moment: Moment) -> np.ndarray:
    positions = np.array([m.position for m in scene.true.landmarks])
    return project(scene.intrinsics, scene.pose_at(moment), positions)[0]


def patches_of(scene: Scene, moment: Moment) -> list:
    reference = render(scene, moment).image
    pixels = true_pixels(scene, moment)
    return [cut_patch(reference, tuple(p), m.size_px) for p, m in zip(pixels, scene.true.landmarks, strict=True)]


def test_sway_turn_and_dimmer_light_are_followed_to_a_tenth_of_a_pixel() -> None:
    scene, still = simple_scene()
    patches = patches_of(scene, still)
    moved = replace(still, turn_rad=(0.012, -0.015, 0.01), exposure=0.55, seed=9)
    tracked = track(render(scene, moved).image, patches, 40.0, scene.intrinsics)
    seen = true_pixels(scene, moved)
    inside = (seen > 30).all(axis=1) & (seen < (609, 449)).all(axis=1)
    assert tracked.found[inside].all()
    error = np.hypot(*(tracked.pixels - seen)[tracked.found].T)
    assert error.max() < 0.25
    assert np.median(error) < 0.1


def test_other_pictures_have_no_landmarks() -> None:
    scene, still = simple_scene()
    patches = patches_of(scene, still)
    texture = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)
    flat = np.full((480, 640), 90, np.uint8)
    for image in (texture, flat):
        assert track(image, patches, 40.0, scene.intrinsics).count < 3


def test_one_landmark_that_moves_against_the_others_is_left_out() -> None:
    scene, still = simple_scene()
    patches = patches_of(scene, still)
    image = render(scene, still).image.copy()
    u, v = np.round(true_pixels(scene, still)[0]).astype(int)
    half = 20
    piece = image[v - half : v + half + 1, u - half : u + half + 1].copy()
    image[v - half : v + half + 1, u - half : u + half + 1] = int(image[v - half, u - half])
    image[v - half : v + half + 1, u - half + 15 : u + half + 16] = piece
    tracked = track(image, patches, 40.0, scene.intrinsics)
    assert not tracked.found[0]
    assert tracked.found[1:].sum() >= 4


def test_a_patch_over_the_edge_or_without_texture_is_no_landmark() -> None:
    picture = np.zeros((100, 100), np.uint8)
    picture[40:60, 40:60] = 255
    assert cut_patch(picture, (5.0, 50.0), 33) is None
    assert cut_patch(np.full((100, 100), 80, np.uint8), (50.0, 50.0), 33) is None
    assert cut_patch(picture, (50.0, 50.0), 33) is not None


def test_landmarks_on_one_another_outvote_no_others() -> None:
    # four tips of one far tower that look alike a few pixels aside, and five that stay where they were
    apart = [(100.0, 300.0), (120.0, 90.0), (530.0, 110.0), (560.0, 330.0), (330.0, 400.0)]
    tower = [(320.0, 200.0), (324.0, 206.0), (318.0, 212.0), (327.0, 214.0)]
    square = np.zeros((33, 33), np.uint8)
    patches = [Patch(np.array(pixel), square) for pixel in (*apart, *tower)]
    options = [
        # beside the place of a landmark is another that looks like it, as there is of many
        [(0.0, 0.0, 0.95), (0.0, 4.0, 0.7)],
        [(0.0, 0.0, 0.8)],
        [(0.0, 0.0, 0.95), (0.0, 4.0, 0.7)],
        [(0.0, 0.0, 0.95), (4.0, 4.0, 0.7)],
        [(0.0, 0.0, 0.95), (4.0, 4.0, 0.7)],
        *([(3.0, 4.0, 0.9)] for _ in tower),
    ]
    chosen = consensus(patches, options, Intrinsics(640, 480, 900.0, 900.0, 319.5, 239.5))
    assert all(chosen[i][:2] == (0.0, 0.0) for i in range(len(apart)))
