"""The state of the lens on the demonstration's frames, and on one of them with drops, dirt and fog put before it."""

from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest

from sagnode.match.lens import cells, lens_state
from sagnode.quality import LensLook

SITE = Path(str(files("sagnode.demo") / "site"))


def grey(file):
    return cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)


@pytest.fixture(scope="module")
def reference():
    return cells(grey(SITE / "reference.jpg"))


@pytest.fixture(scope="module")
def noon():
    return grey(next((SITE / "frames").glob("*T120000Z.jpg")))


def spots(image, seed, paint):
    """The image with six soft round spots of ``paint``."""
    rng, out = np.random.default_rng(seed), image.astype(np.float32)
    height, width = image.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    for _ in range(6):
        u, v, radius = rng.uniform(0.1, 0.9) * width, rng.uniform(0.5, 0.95) * height, rng.uniform(0.03, 0.05) * width
        cover = np.clip((1 - np.hypot(x - u, y - v) / radius) * 4, 0, 1)
        out = out * (1 - cover) + cover * paint(image, radius)
    return np.clip(out, 0, 255).astype(np.uint8)


def drop(image, radius):
    return cv2.GaussianBlur(image, (0, 0), radius / 3).astype(np.float32)


def mud(image, radius):
    del radius
    return np.full(image.shape, 30.0, np.float32)


@pytest.mark.parametrize("hour", ["06", "08", "10", "12", "15", "18"])
def test_an_ordinary_frame_is_clear(reference, hour):
    state = lens_state(reference, grey(next((SITE / "frames").glob(f"*T{hour}0000Z.jpg"))))
    assert (state.look, state.share) == (LensLook.CLEAR, 0.0)


def test_night_is_dark(reference):
    state = lens_state(reference, grey(next((SITE / "frames").glob("*T230000Z.jpg"))))
    assert state.look is LensLook.DARK
    assert "night" in state.text


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_drops_and_dirt_are_told_apart(reference, noon, seed):
    assert lens_state(reference, spots(noon, seed, drop)).look is LensLook.WET
    assert lens_state(reference, spots(noon, seed, mud)).look is LensLook.DIRTY


def test_fog_takes_the_contrast_of_most_of_the_view(reference, noon):
    foggy = (180 + 0.12 * (noon.astype(float) - 180)).astype(np.uint8)
    state = lens_state(reference, foggy)
    assert state.look is LensLook.FOGGED
    assert state.share > 0.9
    assert "% of the view has lost its contrast" in state.text


def test_a_blurred_lens_is_fogged_and_a_darker_exposure_is_not(reference, noon):
    assert lens_state(reference, cv2.GaussianBlur(noon, (0, 0), 25)).look is LensLook.FOGGED
    assert lens_state(reference, (0.5 * noon).astype(np.uint8)).look is LensLook.CLEAR


@pytest.mark.parametrize("shift", [(12, 0), (0, -12), (-20, 20)])
def test_a_camera_that_has_moved_is_not_a_dirty_lens(reference, noon, shift):
    moved = cv2.warpAffine(noon, np.float32([[1, 0, shift[0]], [0, 1, shift[1]]]), noon.shape[::-1], borderMode=1)
    assert lens_state(reference, moved).look is LensLook.CLEAR


def test_without_a_reference_or_in_an_empty_view_nothing_is_claimed(noon):
    assert lens_state(None, noon).look is LensLook.UNKNOWN
    assert lens_state(cells(np.ascontiguousarray(noon[:800])), noon).look is LensLook.UNKNOWN
    assert lens_state(cells(np.full(noon.shape, 170, np.uint8)), noon).look is LensLook.UNKNOWN
    assert lens_state(None, np.zeros((60, 80), np.uint8)).look is LensLook.DARK
