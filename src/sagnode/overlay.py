"""Overlays: what was measured, drawn on the frame it was measured in. For eyes; nothing is computed here."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.measurement import Drawing, FrameMeasurement
from sagnode.message import Estimate
from sagnode.quality import Validity

ColourImage = NDArray[np.uint8]

_CURVES = ((80, 220, 60), (60, 180, 255), (255, 150, 60), (220, 90, 220), (230, 230, 70), (120, 120, 255))
_CHORD = (200, 200, 200)
_LOWEST = (0, 255, 255)
_CLEARANCE = (60, 60, 255)
_LANDMARK = (255, 210, 0)
_SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates: a sixteenth of a pixel."""


_NUDGE_PX = 2


class Words:
    """Keeps words on a drawing apart from each other and from marks."""

    def __init__(self) -> None:
        self._boxes: list[tuple[int, int, int, int]] = []

    def take(self, left: int, top: int, right: int, bottom: int) -> None:
        """Keep words away from a box, pixels."""
        self._boxes.append((left, top, right, bottom))

    def place(self, text: str, at: tuple[int, int], scale: float, lowest: int | None = None) -> tuple[int, int]:
        """Where to write a text so that it covers none before it: the wanted place, or the next free one.

        Args:
            text: one line.
            at: wanted left end of its base line, pixels.
            scale: of the font.
            lowest: base line below which there is no room; then places above the wanted one are tried.
        """
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
        u, v = at
        gap = max(3, height // 2)
        while self._covers(u, v - height, u + width, v + gap):
            v += _NUDGE_PX
        if lowest is not None and v > lowest:
            v = min(at[1], lowest)
            while v > height and self._covers(u, v - height, u + width, v + gap):
                v -= _NUDGE_PX
        self.take(u, v - height, u + width, v + gap)
        return u, v

    def _covers(self, left: int, top: int, right: int, bottom: int) -> bool:
        return any(left < box[2] and box[0] < right and top < box[3] and box[1] < bottom for box in self._boxes)


def draw_overlay(image: GreyImage, measurements: Sequence[FrameMeasurement]) -> ColourImage:
    """The frame in colour with curves, lowest points, clearances with their places, landmarks and a legend."""
    canvas: ColourImage = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    scale = max(0.45, image.shape[1] / 2400)
    labels: list[tuple[str, tuple[int, int], tuple[int, int, int]]] = []
    words = Words()
    for colour, measurement in zip(_colours(len(measurements)), measurements, strict=True):
        drawing = measurement.drawing
        if drawing is not None and measurement.validity is not Validity.INVALID:
            label = _draw_conductor(canvas, drawing, colour, measurement, scale, words)
            labels += [] if label is None else [(*label, colour)]
    landmarks = next((m.drawing for m in measurements if m.drawing is not None), None)
    if landmarks is not None:
        _draw_landmarks(canvas, landmarks, scale, words)
    lowest = canvas.shape[0] - _legend(canvas, measurements, scale) - 4
    # from the top down, so that a word that gives way stays near its own line
    for text, at, colour in sorted(labels, key=lambda label: label[1][1]):
        _text(canvas, text, words.place(text, at, scale, lowest), colour, scale)
    return canvas


def _colours(count: int) -> list[tuple[int, int, int]]:
    return [_CURVES[i % len(_CURVES)] for i in range(count)]


def draw_runs(
    canvas: ColourImage, pixels: FloatArray, shown: NDArray[np.bool_], colour: tuple[int, int, int], thickness: int = 1
) -> None:
    """Draw an anti-aliased line through pixels (N, 2), broken where ``shown`` (N,) is false; they may be NaN there."""
    for run in np.split(np.arange(len(pixels)), np.flatnonzero(np.diff(shown.astype(int))) + 1):
        if len(run) > 1 and shown[run[0]]:
            points = np.round(pixels[run] * (1 << _SHIFT)).astype(np.int32)
            cv2.polylines(canvas, [points], False, colour, thickness, cv2.LINE_AA, _SHIFT)


def _polyline(canvas: ColourImage, pixels: FloatArray, colour: tuple[int, int, int], thickness: int = 1) -> None:
    """Anti-aliased polyline through pixels (N, 2); gaps where they are NaN or far outside."""
    height, width = canvas.shape[:2]
    near = np.isfinite(pixels).all(axis=1) & (np.abs(pixels - (width / 2, height / 2)) < 4 * (width + height)).all(
        axis=1
    )
    draw_runs(canvas, pixels, near, colour, thickness)


def _at(pixel: FloatArray) -> tuple[int, int] | None:
    if not np.isfinite(pixel).all() or np.abs(pixel).max() > 1e5:
        return None
    return round(float(pixel[0])), round(float(pixel[1]))


def _text(canvas: ColourImage, text: str, at: tuple[int, int], colour: tuple[int, int, int], scale: float) -> None:
    for shade, width in (((0, 0, 0), 3), (colour, 1)):
        cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, shade, width, cv2.LINE_AA)


def _draw_conductor(
    canvas: ColourImage,
    drawing: Drawing,
    colour: tuple[int, int, int],
    measurement: FrameMeasurement,
    scale: float,
    words: Words,
) -> tuple[str, tuple[int, int]] | None:
    """Curve, chord, lowest point and clearance; the label of the clearance and where it is wanted, if there is one."""
    _polyline(canvas, drawing.chord, _CHORD)
    _polyline(canvas, drawing.curve, colour)
    radius = max(4, round(9 * scale))
    lowest = _at(drawing.lowest)
    if lowest is not None:
        cv2.drawMarker(canvas, lowest, _LOWEST, cv2.MARKER_DIAMOND, 2 * radius, 1, cv2.LINE_AA)
        words.take(lowest[0] - radius, lowest[1] - radius, lowest[0] + radius, lowest[1] + radius)
    top, foot = _at(drawing.clearance[0]), _at(drawing.clearance[1])
    if top is not None and foot is not None:
        cv2.line(canvas, top, foot, _CLEARANCE, 1, cv2.LINE_AA)
        for end in (top, foot):
            cv2.line(canvas, (end[0] - radius, end[1]), (end[0] + radius, end[1]), _CLEARANCE, 1, cv2.LINE_AA)
        clearance = measurement.estimates.get("clearance")
        if clearance is not None:
            middle = ((top[0] + foot[0]) // 2 + 6, (top[1] + foot[1]) // 2)
            text = f"{measurement.conductor} {clearance.value:.{clearance.decimals}f} m"
            return text, middle
    return None


def _draw_landmarks(canvas: ColourImage, drawing: Drawing, scale: float, words: Words) -> None:
    size = max(8, round(22 * scale))
    for found, predicted in zip(drawing.landmarks, drawing.predicted, strict=True):
        at = _at(found)
        if at is not None:
            cv2.drawMarker(canvas, at, _LANDMARK, cv2.MARKER_CROSS, size, 1, cv2.LINE_AA)
            words.take(at[0] - size, at[1] - size, at[0] + size, at[1] + size)
        where = _at(predicted)
        if where is not None:
            cv2.circle(canvas, where, size // 2, _LANDMARK, 1, cv2.LINE_AA)


def _interval(estimate: Estimate | None) -> str:
    if estimate is None:
        return "-"
    digits = estimate.decimals
    return f"{estimate.value:.{digits}f} [{estimate.lo:.{digits}f} {estimate.hi:.{digits}f}] m"


def _legend(canvas: ColourImage, measurements: Sequence[FrameMeasurement], scale: float) -> int:
    """One line a conductor, and the key of the marks, on a darkened band at the lower edge; its height."""
    line = round(34 * scale)
    height = line * (len(measurements) + 1) + round(14 * scale)
    band = canvas[-height:]
    band[:] = (band * 0.35).astype(np.uint8)
    y = canvas.shape[0] - height + line
    for colour, m in zip(_colours(len(measurements)), measurements, strict=True):
        if m.estimates:
            clearance, where = m.estimates.get("clearance"), m.estimates.get("clearance_along")
            place = ""
            if clearance is not None and where is not None:
                place = f" at {where.value:.{max(0, clearance.decimals - 2)}f} m"
            text = (
                f"{m.conductor}: sag {_interval(m.estimates.get('sag'))}"
                f"  clearance {_interval(clearance)}{place}  {m.validity}"
            )
        else:
            text = f"{m.conductor}: {m.validity} ({', '.join(reason.cause for reason in m.reasons)})"
        _text(canvas, text, (round(14 * scale), y), colour, scale)
        y += line
    key = "diamond: lowest point   red: least clearance   grey: chord   cross and circle: landmark seen and expected"
    _text(canvas, key, (round(14 * scale), y), (220, 220, 220), 0.8 * scale)
    return height
