"""Somebody shows the camera what is not there: what is refused, and what is only found out later, or not at all.

Real frames of the demonstration, altered, through the whole of ``sagnode measure``.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from sagnode.cli.main import main

SITE = Path(__file__).parents[2] / "src" / "sagnode" / "demo" / "site"
FRAME = SITE / "frames" / "20260621T120000Z.jpg"

pytestmark = pytest.mark.skipif(not FRAME.exists(), reason="the demonstration's frames are not there")


def mirrored(image):
    return np.ascontiguousarray(image[:, ::-1])


def photograph_too_near(image):
    """A print held before the lens so that it covers the view and a margin of it is lost."""
    height, width = image.shape
    dy, dx = height // 8, width // 8
    return cv2.resize(image[dy : height - dy, dx : width - dx], (width, height))


def photograph_too_far(image):
    """A print that does not fill the view."""
    height, width = image.shape
    small = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    around = np.full_like(image, 120)
    around[height // 4 : height // 4 + height // 2, width // 4 : width // 4 + width // 2] = small
    return around


def wires_on_a_blank_sheet(image):
    """The conductors painted well, and nothing of the landscape."""
    height, width = image.shape
    sheet = np.full_like(image, 190)
    along = np.linspace(0, 1, 400)
    for offset in (0.35, 0.45, 0.55):
        points = np.stack([along * width, height * (offset + 0.15 * 4 * along * (1 - along))], axis=1)
        cv2.polylines(sheet, [np.round(points * 16).astype(np.int32)], False, 60, 2, cv2.LINE_AA, 4)
    return sheet


def turned_away(image):
    return np.roll(image, image.shape[1] // 3, axis=1)


@pytest.fixture
def measured(tmp_path, capsys):
    def run(image):
        picture = tmp_path / "it.png"
        cv2.imwrite(str(picture), image)
        main(["measure", str(picture), "--config", str(SITE), "--json"])
        return json.loads(capsys.readouterr().out)

    return run


def readings(document):
    found = []

    def walk(part):
        if isinstance(part, dict):
            if "quality" in part and "sag_m" in part:
                found.append(part)
            for inner in part.values():
                walk(inner)
        elif isinstance(part, list):
            for inner in part:
                walk(inner)

    walk(document)
    return found


def test_the_true_scene_gives_numbers(measured):
    assert all(
        reading["sag_m"] is not None for reading in readings(measured(cv2.imread(str(FRAME), cv2.IMREAD_GRAYSCALE)))
    )


@pytest.mark.parametrize(
    "spoofed",
    [mirrored, photograph_too_near, photograph_too_far, wires_on_a_blank_sheet, turned_away],
    ids=lambda f: f.__name__,
)
def test_a_scene_that_is_not_the_surveyed_one_gives_no_number(measured, spoofed):
    made = readings(measured(spoofed(cv2.imread(str(FRAME), cv2.IMREAD_GRAYSCALE))))
    assert made
    for reading in made:
        assert reading["quality"]["validity"] == "invalid"
        assert reading["sag_m"] is None and reading["clearance_lo"] is None
        assert reading["quality"]["reasons"]
