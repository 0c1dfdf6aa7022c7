"""The map that arcs are scored on: how much the picture looks like a line, for each of a fan of directions.

The picture is turned so that the chord between the two points is level, and shrunk if the chord is long. For each
direction it is averaged along that direction over a short stretch, which a wire survives and a texture does not, and
compared with both sides, whatever the sign, relative to how much the surroundings do the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray

Grey = NDArray[Any]
"""Single precision, as OpenCV's own type hints cannot say."""

LONGEST_CELLS = 420
"""Chord length on the map; longer chords are shrunk to this."""
BOW = 0.45
"""Greatest distance of the arc's middle from the chord, in chords, either side."""
STRETCH = 13
"""Averaging along the line, cells."""
FAN_DEG = 10.0
STEEPEST_DEG = 70.0
FINE_SIDE = 2
HALF_SIDES = (2, 4)
"""Distances to the sides compared with, cells: thin wires; on the map of half the resolution thick ones and bundles."""
FLOOR_GREY = 0.7
"""Structure below this is 8-bit rounding and compression, grey levels."""
FULL = 4.0
"""A line this many times as strong as its surroundings counts in full; more adds nothing."""


@dataclass(frozen=True)
class Level:
    """The turned and shrunk picture.

    Attributes:
        grey: (H, W), single precision.
        inside: which cells are wholly inside the frame (H, W).
        origin: cell (x, y) of the first point; the second lies ``cells`` to the right of it.
        cells: chord length in cells.
        shrink: pixels per cell.
        matrix: (2, 3) from cells to pixels of the frame.
    """

    grey: Grey
    inside: NDArray[np.bool_]
    origin: FloatArray
    cells: float
    shrink: float
    matrix: FloatArray


def level(image: GreyImage, start: FloatArray, end: FloatArray) -> Level:
    """Turn the picture so that start to end is level, with the corridor that arcs may take."""
    chord = end - start
    length = float(np.hypot(*chord))
    shrink = max(1.0, length / LONGEST_CELLS)
    cells = length / shrink
    margin = 24.0
    width, height = int(1.3 * cells + 2 * margin), int(2 * BOW * cells + 2 * margin)
    origin = np.array([0.15 * cells + margin, BOW * cells + margin])
    along = chord / length
    turn = np.array([[along[0], -along[1]], [along[1], along[0]]]) * shrink
    matrix = np.column_stack([turn, start - turn @ origin])
    # average before taking every n-th pixel, or thin wires would break up
    source = image if shrink == 1.0 else cv2.GaussianBlur(image, (0, 0), 0.4 * shrink)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    grey = cv2.warpAffine(source, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    whole = np.full(image.shape, 255, np.uint8)
    inside = cv2.warpAffine(whole, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_CONSTANT) > 254
    return Level(grey.astype(np.float32), inside, origin, cells, shrink, matrix)


def line_map(corridor: Level) -> tuple[NDArray[np.uint8], FloatArray]:
    """Strength (F, H, W) of lines in F directions, 0..255 for 0..FULL, and the directions in degrees."""
    height, width = corridor.grey.shape
    angles = np.arange(-STEEPEST_DEG, STEEPEST_DEG + 1, FAN_DEG)
    layers = np.zeros((len(angles), height, width), np.uint8)
    outside = ~corridor.inside
    for layer, angle in zip(layers, angles, strict=True):
        turn, size = _turning((width, height), float(angle))
        turned = cv2.warpAffine(corridor.grey, turn, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        strength = cv2.warpAffine(
            _level_lines(turned), turn, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        )
        scaled = cv2.convertScaleAbs(np.maximum(strength, 0.0), alpha=255 / FULL)
        scaled[outside] = 0
        layer[:] = scaled
    return layers, angles


def _turning(size: tuple[int, int], angle_deg: float) -> tuple[FloatArray, tuple[int, int]]:
    """Affine map (2, 3) that turns a line rising at ``angle_deg`` (v down) level, and the size that holds all."""
    width, height = size
    c, s = float(np.cos(np.radians(angle_deg))), float(np.sin(np.radians(angle_deg)))
    turn = np.array([[c, s], [-s, c]])
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) @ turn.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    span = np.ceil(high - low).astype(int)
    return np.column_stack([turn, -low]), (int(span[0]), int(span[1]))


def _level_lines(grey: Grey) -> Grey:
    """Strength of level lines of either sign relative to their surroundings; 0 or less where there is none."""
    height, width = grey.shape
    along = cv2.blur(grey, (STRETCH, 1))
    best = _relative(along, FINE_SIDE)
    half = cv2.resize(along, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    coarse = _relative(half, HALF_SIDES[0])
    for side in HALF_SIDES[1:]:
        cv2.max(coarse, _relative(cv2.blur(half, (1, side - 1)), side), dst=coarse)
    return np.asarray(cv2.max(best, cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)))


def _relative(centre: Grey, side: int) -> Grey:
    """How far the cells stand out from those ``side`` above and below, relative to what does so around them."""
    height, width = centre.shape
    framed = cv2.copyMakeBorder(centre, side, side, 0, 0, cv2.BORDER_REPLICATE)
    up = cv2.subtract(framed[:height], centre)
    down = cv2.subtract(framed[2 * side :], centre)
    upper = cv2.max(up, down)
    lower = cv2.min(up, down, dst=up)
    line = cv2.max(lower, np.negative(upper, out=upper), dst=down)
    # the surroundings are smooth: a quarter of the resolution holds them
    quarter = cv2.resize(np.abs(line), (max(1, width // 4), max(1, height // 4)), interpolation=cv2.INTER_AREA)
    around = 1 / (cv2.blur(quarter, (11, 11)) + np.float32(FLOOR_GREY))
    return np.asarray(cv2.multiply(line, cv2.resize(around, (width, height), interpolation=cv2.INTER_LINEAR)))
