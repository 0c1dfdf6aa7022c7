"""One conductor between two points of any picture: followed to a pixel where it can be seen, refused where not."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.fit.between import FitResult, draw_fit, fit_between
from sagnode.fit.curve import Curve
from sagnode.fit.follow import KERNELS
from sagnode.fit.judge import judge
from sagnode.quality import Cause

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]
WIDTH, HEIGHT = 900, 640


def sky(rng: np.random.Generator, noise: float = 2.0) -> Floats:
    slope = np.linspace(190, 150, HEIGHT)[:, None] + np.linspace(0, 12, WIDTH)
    return np.asarray(slope + noise * rng.standard_normal((HEIGHT, WIDTH)))


def trees(rng: np.random.Generator) -> Floats:
    """Leaves: thousands of small bright and dark flecks, blurred."""
    image = np.full((HEIGHT, WIDTH), 70.0, dtype=np.float32)
    for _ in range(6000):
        at = rng.uniform((0, 0), (WIDTH, HEIGHT)).astype(int).tolist()
        size = (int(rng.uniform(2, 9)), int(rng.uniform(1, 4)))
        cv2.ellipse(image, at, size, float(rng.uniform(0, 180)), 0, 360, float(rng.uniform(35, 115)), -1)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0) + 2 * rng.standard_normal(image.shape), dtype=np.float64)


def space_wire(near: Sequence[float], far: Sequence[float], sag: float, focal: float, roll_deg: float = 0.0) -> Floats:
    """Pixels (N, 2) of a catenary-like parabola in space (x right, y down, z ahead, m) seen by a pinhole camera."""
    t = np.linspace(0, 1, 1500)[:, None]
    points = (1 - t) * np.array(near) + t * np.array(far) + 4 * sag * t * (1 - t) * np.array([0.0, 1.0, 0.0])
    pixels = focal * points[:, :2] / points[:, 2:]
    c, s = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    return np.asarray(pixels @ np.array([[c, s], [-s, c]]) + (WIDTH / 2, HEIGHT / 2))


def draw(image: Floats, pixels: Floats, width: float, grey: float, blur: float = 0.8) -> Floats:
    """The image with a wire of this width (px) along pixels (N, 2), anti-aliased and blurred as a lens does."""
    fine = np.zeros((HEIGHT * 4, WIDTH * 4), np.uint8)
    track = np.round(((pixels + 0.5) * 4 - 0.5) * 16).astype(np.int32)
    cv2.polylines(fine, [track], False, 255, max(1, round(4 * width)), cv2.LINE_8, 4)
    cover = cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float64) / 255
    cover = np.asarray(cv2.GaussianBlur(cover, (0, 0), blur))
    return image * (1 - cover) + grey * cover


def picture(image: Floats) -> Grey:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def inside(pixels: Floats, margin: float = 4.0) -> Floats:
    kept = (pixels >= margin) & (pixels <= np.array([WIDTH, HEIGHT]) - 1 - margin)
    return pixels[kept.all(axis=1)]


def clicks(pixels: Floats, rng: np.random.Generator, spread: float = 1.5) -> tuple[tuple[float, float], ...]:
    ends = pixels[[0, -1]] + rng.normal(0, spread, (2, 2))
    return tuple((float(u), float(v)) for u, v in ends)


def distances(result: FitResult, truth: Floats) -> Floats:
    """Distance (N,) of every fitted point from the polyline of the truth."""
    return np.array([np.min(np.hypot(*(truth - point).T)) for point in result.points])


VIEWS = {
    "side": space_wire((-60, -8, 120), (60, -10, 118), 9, 800),
    "bowed": space_wire((-30, -22, 70), (28, -25, 75), 18, 800),
    "along": space_wire((-9, -6, 16), (-14, 9, 230), 9, 900),
    "rolled": space_wire((-50, -12, 100), (60, -6, 160), 10, 900, 17.0),
    "steep": space_wire((-20, 25, 80), (10, -28, 95), 6, 800),
}


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("behind", ["sky", "trees"])
def test_a_wire_is_followed_to_a_pixel(view: str, behind: str) -> None:
    rng = np.random.default_rng(len(view))
    truth = inside(VIEWS[view])
    backdrop, width, grey = (sky(rng), 1.3, 70) if behind == "sky" else (trees(rng), 2.0, 165)
    image = picture(draw(backdrop, truth, width, grey))
    result = fit_between(image, *clicks(truth, rng))
    assert result.found, result.reasons
    away = distances(result, truth)
    assert np.median(away) < 0.35
    # the ends are only as good as the clicks, and before trees a few blocks show nothing
    assert np.percentile(away, 95) < 2.5
    assert len(result.points) == len(result.confidence) >= 50
    steps = np.hypot(*np.diff(result.points, axis=0).T)
    assert steps.std() < 0.02 * steps.mean()
    assert result.control_points.shape == (3, 2)
    assert result.weights.tolist() == [1.0, pytest.approx(result.weights[1]), 1.0]
    assert result.visible_share > 0.7


def test_dark_before_the_sky_and_bright_before_trees_is_one_wire() -> None:
    rng = np.random.default_rng(3)
    truth = inside(VIEWS["side"])
    image = sky(rng)
    image[:, WIDTH // 2 :] = trees(rng)[:, WIDTH // 2 :]
    left = draw(image, truth, 1.6, 80)
    right = draw(image, truth, 1.6, 165)
    image = np.concatenate([left[:, : WIDTH // 2], right[:, WIDTH // 2 :]], axis=1)
    result = fit_between(picture(image), *clicks(truth, rng))
    assert result.found, result.reasons
    assert np.median(distances(result, truth)) < 0.35


def test_the_points_choose_among_parallel_wires() -> None:
    rng = np.random.default_rng(4)
    truth = inside(VIEWS["side"])
    image = sky(rng)
    for offset in (-9.0, 0.0, 9.0):
        image = draw(image, truth + np.array([0, offset]), 1.3, 70)
    for offset in (-9.0, 0.0, 9.0):
        wanted = truth + np.array([0, offset])
        result = fit_between(picture(image), *clicks(wanted, rng, 1.0))
        assert result.found, result.reasons
        assert np.median(distances(result, wanted)) < 0.35


def test_a_tight_bundle_is_followed_along_its_middle() -> None:
    rng = np.random.default_rng(5)
    truth = inside(VIEWS["rolled"])
    image = sky(rng)
    for offset in (-2.2, 2.2):
        image = draw(image, truth + np.array([0, offset]), 1.0, 60)
    result = fit_between(picture(image), *clicks(truth, rng, 1.0))
    assert result.found, result.reasons
    assert np.median(distances(result, truth)) < 0.8


@pytest.mark.parametrize("width", [8.0, 10.0, 14.0, 18.0, 24.0])
@pytest.mark.parametrize("behind", ["sky", "trees"])
def test_a_thick_wire_is_followed_along_its_middle_and_not_along_an_edge(width: float, behind: str) -> None:
    rng = np.random.default_rng(7)
    truth = inside(VIEWS["rolled"], width)
    backdrop, grey = (sky(rng), 70) if behind == "sky" else (trees(rng), 165)
    result = fit_between(picture(draw(backdrop, truth, width, grey)), *clicks(truth, rng, 1.0))
    assert result.found, result.reasons
    assert np.median(distances(result, truth)) < 0.35


@pytest.mark.parametrize("width", [8.0, 14.0, 18.0, 24.0])
def test_a_thick_wire_with_a_shaded_side_is_followed_along_its_middle(width: float) -> None:
    rng = np.random.default_rng(7)
    truth = inside(VIEWS["rolled"], width)
    lit = draw(sky(rng), truth, width, 70)
    shaded = draw(lit, truth + np.array([0.0, width / 4]), width / 3, 40)
    result = fit_between(picture(shaded), *clicks(truth, rng, 1.0))
    assert result.found, result.reasons
    assert np.median(distances(result, truth)) < 0.5


@pytest.mark.parametrize("width", [3.0, 6.0, 11.0, 18.0])
def test_the_width_of_a_clear_wire_is_told(width: float) -> None:
    ends = np.array([[60.0, 200.0], [840.0, 420.0]])
    image = draw(sky(np.random.default_rng(5)), np.linspace(ends[0], ends[1], 900), width, 70)
    verdict = judge(image.astype(np.float32), Curve(np.stack([ends[0], ends.mean(axis=0), ends[1]]), 1.0))
    assert [KERNELS[number][0] for number in verdict.kernels] == [width, width]


def test_the_flank_of_a_wire_is_no_wire() -> None:
    rng = np.random.default_rng(7)
    truth = inside(VIEWS["side"], 40)
    first, last = truth[[0, -1]] + np.array([0.0, 15.0])
    result = fit_between(picture(draw(sky(rng, 1.0), truth, 4.0, 60)), (first[0], first[1]), (last[0], last[1]))
    assert not result.found or np.median(distances(result, truth)) < 0.35


def test_a_wire_that_departs_from_every_bezier_is_followed() -> None:
    rng = np.random.default_rng(6)
    truth = inside(VIEWS["side"])
    u = np.linspace(0, 1, len(truth))
    truth = truth + np.stack([np.zeros_like(u), 5 * np.sin(3 * np.pi * u)], axis=1)
    result = fit_between(picture(draw(sky(rng), truth, 1.5, 70)), *clicks(truth, rng))
    assert result.found, result.reasons
    assert result.kind.endswith("+departure")
    assert np.median(distances(result, truth)) < 0.5


@pytest.mark.parametrize("seed", [300, 302, 304])
def test_a_wire_that_departs_far_is_found_between_rough_clicks_and_not_its_neighbour(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = inside(VIEWS["side"])
    u = np.linspace(0, 1, len(truth))
    # over a pole's crossarm and past a clamp: off any Bézier all along, and most of all at one end
    truth = truth + np.stack([np.zeros_like(u), 7 * np.sin(3 * np.pi * u) + 7 * np.exp(-(1 - u) / 0.06)], axis=1)
    image = draw(sky(rng, 6.0), truth, 1.0, 140)
    image = draw(image, truth + np.array([0.0, 6.0]), 1.0, 140)
    result = fit_between(picture(image), *clicks(truth, rng, 2.0))
    assert result.found, result.reasons
    assert np.median(distances(result, truth)) < 1.0


def test_confidence_is_low_where_the_wire_is_hidden() -> None:
    rng = np.random.default_rng(7)
    truth = inside(VIEWS["side"])
    image = draw(sky(rng), truth, 1.5, 70)
    hidden = slice(350, 520)
    image[:, hidden] = trees(rng)[:, hidden]
    result = fit_between(picture(image), *clicks(truth, rng))
    assert result.found, result.reasons
    u = result.points[:, 0]
    assert result.confidence[(u > 370) & (u < 500)].mean() < 0.4
    assert result.confidence[(u < 330) | (u > 540)].mean() > 0.85
    assert np.median(distances(result, truth)) < 0.5


@pytest.mark.parametrize("behind", ["sky", "trees"])
def test_no_wire_no_curve(behind: str) -> None:
    rng = np.random.default_rng(8)
    image = picture(sky(rng) if behind == "sky" else trees(rng))
    for _ in range(6):
        start = rng.uniform((20, 20), (WIDTH - 20, HEIGHT - 20))
        end = rng.uniform((20, 20), (WIDTH - 20, HEIGHT - 20))
        result = fit_between(image, (float(start[0]), float(start[1])), (float(end[0]), float(end[1])))
        assert not result.found
        assert result.reasons[0].cause in {Cause.NO_CONDUCTOR, Cause.TOO_LITTLE_VISIBLE}
        assert len(result.points) == len(result.confidence) == len(result.control_points) == 0


def test_a_wire_elsewhere_is_not_taken() -> None:
    rng = np.random.default_rng(9)
    truth = inside(VIEWS["side"])
    image = picture(draw(sky(rng), truth, 1.5, 70))
    for shift in (-60.0, 60.0):
        ends = truth[[0, -1]] + (0, shift)
        assert not fit_between(image, tuple(ends[0]), tuple(ends[1])).found


def test_refusals_name_what_is_wrong() -> None:
    dark = np.zeros((300, 400), np.uint8)
    flat = np.full((300, 400), 128, np.uint8)
    for image, cause in ((dark, Cause.DARK), (flat, Cause.LOW_CONTRAST)):
        result = fit_between(image, (20.0, 100.0), (380.0, 120.0))
        assert not result.found
        assert result.reasons[0].cause is cause
    near = fit_between(flat, (20.0, 100.0), (40.0, 100.0))
    assert near.reasons[0].cause is Cause.TOO_LITTLE_VISIBLE
    assert "20 px apart" in near.reasons[0].text


def test_points_outside_the_picture_do_no_harm() -> None:
    flat = np.full((300, 400), 128, np.uint8)
    for start, end in (((-300.0, -200.0), (-100.0, -250.0)), ((-50.0, 100.0), (450.0, 120.0))):
        assert not fit_between(flat, start, end).found


def test_left_and_right_are_the_same_to_it() -> None:
    rng = np.random.default_rng(10)
    truth = inside(VIEWS["along"])
    image = picture(draw(sky(rng), truth, 1.4, 70))
    first, last = clicks(truth, rng, 1.0)
    there, back = fit_between(image, first, last), fit_between(image, last, first)
    assert there.found
    assert back.found
    assert np.abs(there.points - back.points[::-1]).max() < 0.3


def test_the_drawing_has_the_pictures_size_and_shows_the_curve() -> None:
    rng = np.random.default_rng(11)
    truth = inside(VIEWS["side"])
    image = picture(draw(sky(rng), truth, 1.5, 70))
    result = fit_between(image, *clicks(truth, rng))
    drawing = draw_fit(image, result)
    assert drawing.shape == (*image.shape, 3)
    changed = (drawing != image[:, :, None]).any(axis=2)
    assert 0.001 < changed.mean() < 0.1
    refused = draw_fit(image, fit_between(image, (100.0, 20.0), (500.0, 25.0)))
    assert refused.shape == (*image.shape, 3)
