"""Which arcs between two points look like a wire at all: thousands of Béziers scored on a map of oriented lines.

The picture is turned so that the chord between the two points is level, and shrunk if the chord is long. For each of a
fan of directions it is averaged along that direction over a short stretch, which a wire survives and a texture does
not, and compared with both sides, whatever the sign. Each Bézier then adds up what the map says at its points for the
direction that it has there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.fit_curve import Curve, shares

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
STEP = 4.0
"""Distance of neighbouring arcs, cells; the map tolerates half of it."""
FULL = 4.0
"""A line this many times as strong as its surroundings counts in full; more adds nothing."""
WEIGHTS = (0.6, 1.0, 1.5, 2.2, 3.2)


@dataclass(frozen=True)
class Level:
    """The turned and shrunk picture.

    Attributes:
        grey: (H, W), single precision.
        inside: which cells are wholly inside the frame (H, W).
        origin: cell (x, y) of the first point; the second lies ``cells`` to the right of it.
        cells: chord length in cells.
        matrix: (2, 3) from cells to pixels of the frame.
    """

    grey: Grey
    inside: NDArray[np.bool_]
    origin: FloatArray
    cells: float
    matrix: FloatArray


@dataclass(frozen=True)
class Candidate:
    """An arc and its score on the map (0..1), best first."""

    curve: Curve
    score: float


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
    return Level(grey.astype(np.float32), inside, origin, cells, matrix)


def line_map(corridor: Level) -> tuple[NDArray[np.uint8], FloatArray]:
    """Strength (F, H, W) of lines in F directions, 0..255 for 0..FULL, widened by half a step; and the directions."""
    height, width = corridor.grey.shape
    angles = np.arange(-STEEPEST_DEG, STEEPEST_DEG + 1, FAN_DEG)
    layers = np.zeros((len(angles), height, width), np.uint8)
    widen = np.ones((5, 5), np.uint8)
    outside = ~corridor.inside
    for layer, angle in zip(layers, angles, strict=True):
        turn, size = _turning((width, height), float(angle))
        turned = cv2.warpAffine(corridor.grey, turn, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        strength = cv2.warpAffine(
            _level_lines(turned), turn, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        )
        scaled = cv2.convertScaleAbs(strength, alpha=255 / FULL)
        scaled[outside] = 0
        cv2.dilate(scaled, widen, dst=layer)
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


def search(image: GreyImage, start: FloatArray, end: FloatArray, count: int) -> list[Candidate]:
    """The ``count`` best arcs between two pixels that differ from each other, best first."""
    corridor = level(image, start, end)
    layers, angles = line_map(corridor)
    handles, weights = _grid(corridor.cells)
    score, stations = _score(corridor, layers, angles, handles, weights)
    chosen: list[int] = []
    order = np.argsort(score)[::-1][: 60 * count]
    for index in order:
        if len(chosen) == count:
            break
        apart = [float(np.sqrt(np.mean((stations[index] - stations[i]) ** 2))) for i in chosen]
        if not apart or min(apart) > STEP:
            chosen.append(int(index))
    turn, shift = corridor.matrix[:, :2], corridor.matrix[:, 2]
    found = []
    for index in chosen:
        handle = turn @ (handles[index] + corridor.origin) + shift
        found.append(Candidate(Curve(np.stack([start, handle, end]), float(weights[index])), float(score[index])))
    return found


def _grid(cells: float) -> tuple[FloatArray, FloatArray]:
    """Middle control points (G, 2) in cells from the start, chord along +x, and middle weights (G,)."""
    handles, weights = [], []
    for bow in np.arange(-np.floor(BOW * cells / STEP), BOW * cells / STEP) * STEP:
        # skewing the handle by dp moves the arc by up to 0.77·bow·dp, and the weight by some 0.05·bow a step
        places = max(1, int(np.ceil(1.3 * 0.77 * abs(bow) / STEP)))
        skews = np.linspace(-0.15, 1.15, 2 * (places // 2) + 1) if places > 1 else np.array([0.5])
        chosen = WEIGHTS if abs(bow) > 100 else WEIGHTS[1::2] if abs(bow) > 20 else WEIGHTS[1:2]
        for weight in chosen:
            reach = bow * (1 + weight) / weight
            handles.append(np.column_stack([skews * cells, np.full(len(skews), reach)]))
            weights.append(np.full(len(skews), weight))
    return np.concatenate(handles), np.concatenate(weights)


def _score(
    corridor: Level, layers: NDArray[np.uint8], angles: FloatArray, handles: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean strength (G,) along each arc, 0..1, and the arcs' heights at 8 stations (G, 8) for telling them apart."""
    samples = int(np.clip(corridor.cells / 8, 24, 72))
    _, height, width = layers.shape
    flat = layers.reshape(-1)
    score = np.empty(len(handles))
    stations = np.empty((len(handles), 8))
    levels = np.array([0.0, corridor.cells])
    for weight in np.unique(weights):
        which = np.flatnonzero(weights == weight)
        # a little inside the ends, where towers and insulators are
        t = _spread(samples, float(weight))
        share = shares(t, float(weight)).astype(np.float32)
        for part in np.array_split(which, max(1, len(which) // 4000)):
            x = (share[:, 1] * handles[part, 0:1] + share[:, 2] * levels[1]).astype(np.float32)
            y = (share[:, 1] * handles[part, 1:2]).astype(np.float32)
            slope = np.degrees(np.arctan2(y[:, 4::4] - y[:, :-4:4], x[:, 4::4] - x[:, :-4:4]))
            fan = np.clip(np.rint((slope - angles[0]) / FAN_DEG), 0, len(angles) - 1).astype(np.int32)
            fan = np.repeat(fan, 4, axis=1)
            fan = np.concatenate([fan, np.repeat(fan[:, -1:], samples - fan.shape[1], axis=1)], axis=1)
            column = np.rint(x + np.float32(corridor.origin[0])).astype(np.int32)
            row = np.rint(y + np.float32(corridor.origin[1])).astype(np.int32)
            held = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            place = np.where(held, (fan * height + row) * width + column, 0)
            strength = np.where(held, flat[place], 0)
            score[part] = strength.sum(axis=1, dtype=np.int64) / (255.0 * samples)
            stations[part] = np.stack([_at(x, y, s) for s in np.linspace(0.1, 0.9, 8) * corridor.cells], axis=1)
    return score, stations


def _spread(samples: int, weight: float) -> FloatArray:
    """Parameters (samples,) that are roughly evenly spread along an arc of this weight, without its very ends."""
    x = np.linspace(0.01, 0.99, samples)
    t = np.linspace(0, 1, 400)
    along = shares(t, weight) @ np.array([0.0, 0.5, 1.0])
    return np.interp(x, along, t)


def _at(x: Grey, y: Grey, station: float) -> FloatArray:
    """Heights (G,) of arcs x, y (G, S) at one station, by the nearest sample."""
    nearest = np.argmin(np.abs(x - station), axis=1)
    return np.asarray(y[np.arange(len(y)), nearest], dtype=np.float64)
