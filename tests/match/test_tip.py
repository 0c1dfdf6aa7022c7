"""The tip of a fold: where a wire seen along the line turns back, on pictures of finer points."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.geometry.camera import Intrinsics, Pose, rotation_from_angles
from sagnode.match.fold import FINE, Fold, drawn, fold_at, turn_of
from sagnode.match.masks import Neighbour
from sagnode.match.refine import observe, with_tip
from sagnode.match.templates import View
from sagnode.match.tip import BEHIND_PX, Tip, find_tip
from sagnode.match.track import Track, trace

Grey = NDArray[np.uint8]
WIDTH, HEIGHT = 640, 480
LENS = Intrinsics(WIDTH, HEIGHT, 1100.0, 1100.0, 319.5, 239.5)
SAG = 6.0
FOLDED = [0.3, 0.8]
"""Metres of the camera beside the plane of the wire: strands that are one line, and strands a few pixels apart."""


def view(beside: float) -> View:
    """A camera below a wire's near end that looks along it, ``beside`` m from the plane it hangs in."""
    pose = Pose(rotation_from_angles(0.0, -2.0, 0.0), np.array([beside, 0.5, 16.0]))
    return View(LENS, pose, np.array([0.0, 0.0, 20.0]), np.array([0.0, 200.0, 20.0]), 0.05)


def track(beside: float, sag: float = SAG) -> Track:
    found = trace(view(beside), sag, 0.0)
    assert found is not None
    return found


@cache
def covered(beside: float) -> NDArray[np.float64]:
    """Share of each pixel that the wire covers, from 7 x 7 points of it, blurred by a lens."""
    t = np.linspace(0.02, 0.999, 60_000)
    seen = view(beside)
    pixels, depth = seen.pixels(SAG, 0.0, t)
    width = seen.width_px(depth)
    fine = 7
    share = np.zeros((HEIGHT * fine, WIDTH * fine), dtype=np.uint8)
    for place, size in zip(pixels[::2], width[::2], strict=True):
        centre = (place + 0.5) * fine - 0.5
        if np.isfinite(centre).all() and (np.abs(centre - 2000) < 4000).all():
            radius = max(1, round(8 * fine * size / 2))
            cv2.circle(share, tuple(np.rint(centre * 8).astype(int).tolist()), radius, 1, -1, cv2.LINE_8, 3)
    whole = share.reshape(HEIGHT, fine, WIDTH, fine).mean(axis=(1, 3))
    return cv2.GaussianBlur(whole, (0, 0), 0.7)


def picture(beside: float, contrast: float = -70.0, noise: float = 2.0, seed: int = 0) -> Grey:
    rng = np.random.default_rng(seed)
    grey = 150 + contrast * covered(beside) + noise * rng.standard_normal((HEIGHT, WIDTH))
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def fold(of: Track, half_range: int = 6) -> Fold:
    turn = turn_of(of)
    assert turn is not None
    found = fold_at(of, turn, BEHIND_PX + 3.0 * half_range)
    assert found is not None
    return found


def true_tip(beside: float, sag: float, axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """The point of a curve that lies farthest along an axis, px."""
    pixels, _ = view(beside).pixels(sag, 0.0, np.linspace(0.1, 0.99, 40_001))
    return np.asarray(pixels[int(np.argmax(pixels @ axis))])


@pytest.mark.parametrize("beside", FOLDED)
def test_a_fold_has_its_tip_where_the_curve_turns_back(beside: float) -> None:
    found = fold(track(beside))
    assert found.axis[1] > 0.98
    apart = found.pixel - true_tip(beside, SAG, found.axis)
    assert apart @ found.axis == pytest.approx(0.0, abs=0.02)
    assert found.along.max() <= 1e-6
    pixel, _ = view(beside).pixels(SAG, 0.0, np.array([found.t]))
    np.testing.assert_allclose(pixel[0], found.pixel, atol=0.05)


def test_a_curve_that_only_hangs_has_none() -> None:
    pose = Pose(rotation_from_angles(90.0, 4.0, 0.0), np.array([-120.0, 100.0, 8.0]))
    beside = trace(replace(view(0.3), pose=pose), SAG, 0.0)
    assert beside is not None
    assert turn_of(beside) is None


@pytest.mark.parametrize("beside", FOLDED)
def test_a_drawing_shows_what_a_picture_of_finer_points_does(beside: float) -> None:
    found = fold(track(beside))
    drawing = drawn(found, 8, 16, 8)[::FINE]
    rows, columns = np.arange(-16.0, 9.0), np.arange(-8.0, 9.0)
    place = found.pixel + rows[:, None, None] * found.axis + columns[:, None] * found.side
    # the picture is blurred by 0.7 px, the drawing by 0.9, of which sampling between pixels makes some
    blurred = cv2.GaussianBlur(covered(beside), (0, 0), 0.55).astype(np.float32)
    taken = cv2.remap(blurred, place[..., 0].astype(np.float32), place[..., 1].astype(np.float32), cv2.INTER_CUBIC)
    assert np.abs(drawing - taken).max() < 0.15 * taken.max()
    assert np.corrcoef(drawing.ravel(), taken.ravel())[0, 1] > 0.99


@pytest.mark.parametrize("beside", FOLDED)
@pytest.mark.parametrize("contrast", [-70.0, 60.0])
@pytest.mark.parametrize("sag", [0.985 * SAG, SAG, 1.015 * SAG])
def test_a_tip_is_found_to_its_uncertainty_from_a_curve_that_sags_otherwise(
    beside: float, contrast: float, sag: float
) -> None:
    foreseen = fold(track(beside, sag), 8)
    true = float((true_tip(beside, SAG, foreseen.axis) - foreseen.pixel) @ foreseen.axis)
    errors = []
    for seed in range(12):
        tip = find_tip(picture(beside, contrast, seed=seed), foreseen, 8)
        assert tip is not None
        assert tip.sure
        errors.append((tip.offset - true) / tip.sigma)
    assert np.max(np.abs(errors)) < 2.5
    assert tip.sigma < 0.5


def behind(image: Grey, found: Fold, kind: str) -> Grey:
    """The same picture with something else behind the fold, all the wire's pixels kept."""
    other = image.copy().astype(float)
    u, v = found.pixel
    lines = {
        "bar": [((u - 40, v - 5), (u + 40, v - 4))],
        "leg": [((u + 6, v - 60), (u + 9, v + 60))],
        "lattice": [((u - 30, v - 30), (u + 20, v + 20)), ((u + 30, v - 34), (u - 20, v + 16))],
    }[kind]
    canvas = np.zeros(image.shape, dtype=np.uint8)
    for start, end in lines:
        points = [np.rint(np.array(p) * 16).astype(int).tolist() for p in (start, end)]
        cv2.line(canvas, points[0], points[1], 255, 2, cv2.LINE_AA, 4)
    share = cv2.GaussianBlur(canvas.astype(float) / 255, (0, 0), 0.7) * (1 - np.clip(covered(0.8) / 0.3, 0, 1))
    return np.clip(np.rint(other + share * (210 - other)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("kind", ["bar", "leg", "lattice"])
def test_members_of_a_tower_behind_a_tip_move_it_no_farther_than_stated_or_hide_it(kind: str) -> None:
    foreseen = fold(track(0.8))
    tips = [find_tip(behind(picture(0.8, seed=seed), foreseen, kind), foreseen, 6) for seed in range(12)]
    told = [tip for tip in tips if tip is not None]
    assert max((abs(tip.offset) / tip.sigma for tip in told), default=0.0) < 3
    if kind == "bar":
        assert len(told) == len(tips)


@pytest.mark.parametrize("beside", FOLDED)
def test_a_line_that_goes_on_beyond_the_range_has_no_tip(beside: float) -> None:
    foreseen = fold(track(beside, 0.83 * SAG))
    assert (true_tip(beside, SAG, foreseen.axis) - foreseen.pixel) @ foreseen.axis > 10
    assert all(find_tip(picture(beside, seed=seed), foreseen, 6) is None for seed in range(12))


def test_texture_shows_no_tip() -> None:
    foreseen = fold(track(0.8), 8)
    rng = np.random.default_rng(3)
    shown: list[Tip] = []
    for blur in (0.7, 1.5, 3.0):
        for _ in range(60):
            texture = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH)), (0, 0), blur)
            image = np.clip(120 + 25 * texture / texture.std(), 0, 255).astype(np.uint8)
            shown += filter(None, [find_tip(image, foreseen, 8)])
    assert len(shown) <= 3
    assert not any(tip.sure for tip in shown)


def test_a_fold_at_the_edge_of_the_frame_is_not_looked_at() -> None:
    foreseen = fold(track(0.8))
    image = picture(0.8)
    assert find_tip(image[: int(foreseen.pixel[1]) + 9], foreseen, 6) is None
    assert find_tip(image[: int(foreseen.pixel[1]) + 20], foreseen, 6) is not None


@pytest.mark.parametrize("beside", FOLDED)
def test_a_tip_takes_the_place_of_the_block_there(beside: float) -> None:
    curve, image = track(beside, 1.005 * SAG), picture(beside)
    blocks = observe(image, curve, 3.0, [], 8.0, 8, 1)
    turn = turn_of(curve)
    assert turn is not None
    tipped = with_tip(image, blocks, turn, [], 6)
    assert tipped is not None
    assert tipped.tip is not None
    assert not blocks.usable[tipped.tip]
    assert tipped.usable[tipped.tip]
    measured = tipped.pixel[tipped.tip] + tipped.offset[tipped.tip] * tipped.normal[tipped.tip]
    axis = tipped.normal[tipped.tip]
    aside = float((measured - true_tip(beside, SAG, axis)) @ axis)
    assert abs(aside) < 2.5 * tipped.sigma[tipped.tip]
    assert (np.diff(tipped.arc) > 0).all()
    others = np.arange(len(blocks.t)) != tipped.tip
    np.testing.assert_array_equal(tipped.offset[others], blocks.offset[others])


def test_no_tip_is_looked_for_where_another_wire_runs() -> None:
    curve, image = track(0.8), picture(0.8)
    blocks = observe(image, curve, 3.0, [], 8.0, 8, 1)
    turn = turn_of(curve)
    assert turn is not None
    place = curve.pixels[turn] + np.array([5.0, 0.0])
    other = Neighbour(place + np.arange(-30.0, 31.0)[:, None] * np.array([0.0, 1.0]))
    assert with_tip(image, blocks, turn, [other], 6) is None
    assert with_tip(image, blocks, turn, [], 6) is not None


def test_a_bundle_has_no_one_tip() -> None:
    curve, image = track(0.8), picture(0.8)
    bundle = replace(curve, members=np.array([[-0.5], [0.5]]) * np.ones(len(curve.t)))
    blocks = observe(image, curve, 3.0, [], 8.0, 8, 1)
    turn = turn_of(curve)
    assert turn is not None
    assert with_tip(image, replace(blocks, track=bundle), turn, [], 6) is None
