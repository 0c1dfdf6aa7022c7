"""Which arcs between two points look like a wire at all: thousands of Béziers scored on a map of oriented lines.

Each Bézier adds up what the map (``line_map``) says at its points for the direction that it has there: first a wide
grid of bows, skews and weights on a map that tolerates half a step of the grid, then a fine one around the best of
them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.fit.curve import GREATEST_WEIGHT, LEAST_WEIGHT, Curve, apart, shares
from sagnode.fit.map import BOW, FAN_DEG, Level, level, line_map
from sagnode.geometry.camera import FloatArray

STEP = 4.0
"""Distance of neighbouring arcs of the wide grid, cells."""
FINE_STEPS = (1.6, 0.8)
"""Of the successive fine grids, two steps either way."""
WORTH = 0.7
"""Arcs that score less than this share of the best are not followed."""
END_TOLL = 0.008
"""What missing a given point by its standard uncertainty costs, in mean strength."""
GRID_ARCS = 8
"""Arcs of the wide grid that are looked at finely."""
WEIGHTS = (0.8, 1.0, 1.4, 2.0, 3.0)


@dataclass(frozen=True)
class Candidate:
    """An arc and its score on the map (0..1), best first."""

    curve: Curve
    score: float


@dataclass(frozen=True)
class Arcs:
    """Arcs in cells of the map from its origin, chord along +x.

    Attributes:
        ends: heights of start and end (G, 2).
        handles: middle control points (G, 2).
        weights: middle weights (G,).
    """

    ends: FloatArray
    handles: FloatArray
    weights: FloatArray

    def __getitem__(self, which: NDArray[np.intp]) -> Arcs:
        return Arcs(self.ends[which], self.handles[which], self.weights[which])


def search(image: GreyImage, start: FloatArray, end: FloatArray, slack: float, count: int) -> list[Candidate]:
    """Up to ``count`` of the best arcs between two pixels that differ from each other, best first."""
    corridor = level(image, start, end)
    layers, angles = line_map(corridor)
    widen = np.ones((5, 5), np.uint8)
    wide = np.stack([np.asarray(cv2.dilate(layer, widen), dtype=np.uint8) for layer in layers])
    arcs = _grid(corridor.cells)
    score, stations = _score(corridor, wide, angles, arcs)
    found: list[Candidate] = []
    for index in _distinct(score, stations, GRID_ARCS):
        best = arcs[np.array([index])]
        for step in FINE_STEPS:
            nearby = _around(best, corridor.cells, step)
            fine, _ = _score(corridor, layers, angles, nearby)
            fine -= END_TOLL * (corridor.shrink / slack) ** 2 * (nearby.ends**2).sum(axis=1)
            best = nearby[np.array([int(np.argmax(fine))])]
        found.append(Candidate(_curve(corridor, best), float(fine.max())))
    found.sort(key=lambda one: -one.score)
    kept: list[Candidate] = []
    for one in found:
        new = all(apart(one.curve, other.curve) > corridor.shrink for other in kept)
        if new and one.score > WORTH * found[0].score:
            kept.append(one)
    return kept[:count]


def _distinct(score: FloatArray, stations: FloatArray, count: int) -> list[int]:
    """Numbers of the best arcs that keep a step apart from each other."""
    chosen: list[int] = []
    for index in np.argsort(score)[::-1][: 60 * count]:
        if len(chosen) == count:
            break
        apart = [float(np.sqrt(np.mean((stations[index] - stations[i]) ** 2))) for i in chosen]
        if not apart or min(apart) > STEP:
            chosen.append(int(index))
    return chosen


def _curve(corridor: Level, arc: Arcs) -> Curve:
    """The single arc in pixels of the frame."""
    cells = np.array([[0.0, arc.ends[0, 0]], arc.handles[0], [corridor.cells, arc.ends[0, 1]]]) + corridor.origin
    return Curve(cells @ corridor.matrix[:, :2].T + corridor.matrix[:, 2], float(arc.weights[0]))


def _around(arc: Arcs, cells: float, step: float) -> Arcs:
    """A fine grid about one arc: its bow, skew, weight and ends are moved by a few steps (in cells of the arc)."""
    weight = float(arc.weights[0])
    share = weight / (1 + weight)
    bow = float(arc.handles[0, 1] * share)
    # as far as the arc's weight and skew move it across by one step
    slide = step * cells / max(0.77 * abs(bow), 0.05 * cells)
    fuller = np.exp(np.array([-1.0, 0.0, 1.0]) * min(0.25, 12 * step / max(abs(bow), 1.0)))
    moves = np.arange(-2, 3) * step
    grid = np.meshgrid(moves, np.arange(-2, 3) * slide, fuller, moves[1:4], moves[1:4], indexing="ij")
    higher, along, factor, first, last = (axis.ravel() for axis in grid)
    weights = np.clip(weight * factor, LEAST_WEIGHT, GREATEST_WEIGHT)
    ends = arc.ends + np.stack([first, last], axis=1)
    middle = bow + higher - 0.5 * (first + last) * (1 - share)
    handles = np.stack([arc.handles[0, 0] + along, middle * (1 + weights) / weights], axis=1)
    return Arcs(ends, handles, weights)


def _grid(cells: float) -> Arcs:
    """Arcs between the points themselves over all bows, skews and weights."""
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
    everything = np.concatenate(weights)
    return Arcs(np.zeros((len(everything), 2)), np.concatenate(handles), everything)


def _score(corridor: Level, layers: NDArray[np.uint8], angles: FloatArray, arcs: Arcs) -> tuple[FloatArray, FloatArray]:
    """Mean strength (G,) along each arc, 0..1, and the arcs' heights at 8 stations (G, 8) for telling them apart."""
    samples = int(np.clip(corridor.cells / 8, 24, 72))
    _, height, width = layers.shape
    flat = layers.reshape(-1)
    score = np.empty(len(arcs.weights))
    stations = np.empty((len(arcs.weights), 8))
    single = arcs.ends.astype(np.float32)
    handles = arcs.handles.astype(np.float32)
    for weight in np.unique(arcs.weights):
        which = np.flatnonzero(arcs.weights == weight)
        # a little inside the ends, where towers and insulators are
        t = _spread(samples, float(weight))
        share = shares(t, float(weight)).astype(np.float32)
        for part in np.array_split(which, max(1, len(which) // 4000)):
            x = share[:, 1] * handles[part, :1] + share[:, 2] * np.float32(corridor.cells)
            y = single[part, :1] * share[:, 0] + handles[part, 1:] * share[:, 1] + single[part, 1:] * share[:, 2]
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


def _at(x: NDArray[np.float32], y: NDArray[np.float32], station: float) -> FloatArray:
    """Heights (G,) of arcs x, y (G, S) at one station, by the nearest sample."""
    nearest = np.argmin(np.abs(x - station), axis=1)
    return np.asarray(y[np.arange(len(y)), nearest], dtype=np.float64)
