"""The expected view, drawn: frame, wires, attachments, landmarks, ground. For eyes; nothing is computed here."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import cv2
import numpy as np

from sagnode.config.span import Span
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, inside, project
from sagnode.geometry.conductor import conductor_points
from sagnode.overlay import ColourImage, Words, draw_runs
from sagnode.plan.foresee import LEVELS, states_at
from sagnode.plan.report import VERDICTS, camera_text, metres, millimetres, turned_text
from sagnode.plan.study import Study
from sagnode.scene.spec import SpanFrame

_MARGIN = 0.16
"""What is shown beyond the frame on either side, as a share of it: attachments often lie just outside."""
_WIDEST_PX = 1500
_OUTSIDE, _SKY, _FRAME = (196, 192, 188), (232, 222, 212), (60, 60, 60)
_GROUND, _OBSTACLE, _MARK, _UNSEEN = (70, 120, 90), (40, 90, 200), (170, 90, 0), (150, 150, 150)
_WIRES = ((60, 130, 20), (20, 110, 200), (190, 80, 30), (150, 40, 150), (130, 120, 0), (40, 40, 180))
_T = np.linspace(0.0, 1.0, 1201)


def expected_view(span: Span, study: Study) -> ColourImage:
    """What the planned camera would see, with a margin around its frame; a legend below.

    Every conductor is drawn at its middle sag (thick) and at the small and the large one (thin).
    """
    sheet = _Sheet.of(study.camera.intrinsics, study.site.pose)
    _draw_ground(sheet, span)
    for number, conductor in enumerate(span.conductors):
        near, far = np.array(conductor.near, dtype=float), np.array(conductor.far, dtype=float)
        colour = _WIRES[number % len(_WIRES)] if conductor.measured else _UNSEEN
        for name in ("small", "middle", "large"):
            sag = states_at(span, LEVELS[name])[conductor.id].sag_m
            sheet.polyline(conductor_points(near, far, sag, 0.0, _T), colour, 2 if name == "middle" else 1)
        for end, place in (("A", near), ("B", far)):
            sheet.mark(place, f"{conductor.id} {end}", colour, ring=True)
    for mark in span.landmarks:
        seen = mark.id in study.site.landmark_ids
        sheet.mark(np.array(mark.position, dtype=float), mark.id, _MARK if seen else _UNSEEN, ring=False)
    return sheet.with_legend(_legend(study))


def _draw_ground(sheet: _Sheet, span: Span) -> None:
    """The profile below the first measured conductor, and obstacles across it."""
    frame = SpanFrame.of(span)
    profile = np.array(span.ground.profile)
    along = np.linspace(profile[0, 0], profile[-1, 0], 600)
    height = np.interp(along, profile[:, 0], profile[:, 1])
    sheet.polyline(frame.to_site(np.stack([along, np.zeros(600), height], axis=1)), _GROUND, 2)
    for obstacle in span.ground.obstacles:
        first, last = obstacle.along_m
        right = 0.02 * frame.length
        corners = [(first, -right), (last, -right), (last, right), (first, right), (first, -right)]
        edges = np.array([(a, r, obstacle.height_m) for a, r in corners])
        dense = np.concatenate([np.linspace(p, q, 40) for p, q in itertools.pairwise(edges)])
        sheet.polyline(frame.to_site(dense), _OBSTACLE, 1)
        middle = frame.to_site(np.array([(first + last) / 2, 0.0, obstacle.height_m]))
        sheet.text_at(middle, obstacle.id, _OBSTACLE)


def _legend(study: Study) -> list[str]:
    turned = study.camera.turned_from
    lines = [camera_text(study.camera), *([] if turned is None else [turned_text(turned)])]
    for one in study.levels["middle"]:
        u = ", ".join(
            f"u({stem}) {millimetres(one.estimates[stem].u)} mm" for stem in ("sag", "clearance") if one.estimates
        )
        width = "" if one.width_px is None else ", wire " + " ".join(f"{w:.2f}" for w in one.width_px) + " px"
        text = f"{one.conductor}: sag {metres(one, one.sag_m)} m, {100 * one.in_view:.0f} % in view{width}"
        lines.append("; ".join(filter(None, [text, VERDICTS[one.validity], u])))
    lines.append("thick: middle sag   thin: small and large sag, as in the table   dark frame: edge of the picture")
    lines.append("rings: attachments   crosses: landmarks (grey: out of view)   green: ground   red: obstacles")
    return lines


def _wrapped(line: str, room_px: int) -> Iterator[str]:
    """A line of the legend in pieces that are not wider than the room for them."""
    piece = ""
    for word in line.split(" "):
        longer = f"{piece} {word}" if piece else word
        if piece.strip() and cv2.getTextSize(longer, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)[0][0] > room_px:
            yield piece
            longer = f"    {word}"
        piece = longer
    yield piece


class _Sheet:
    """A drawing larger than the frame; site points in, everything scaled to a handy size."""

    def __init__(self, intrinsics: Intrinsics, pose: Pose, scale: float) -> None:
        self._intrinsics, self._pose, self._scale = intrinsics, pose, scale
        border = (_MARGIN * intrinsics.width, _MARGIN * intrinsics.height)
        self._origin = np.array(border) * scale
        size = (np.array([intrinsics.width, intrinsics.height]) + 2 * np.array(border)) * scale
        width, height = (round(float(x)) for x in size)
        self._words = Words()
        self.canvas: ColourImage = np.full((height, width, 3), _OUTSIDE, np.uint8)
        corner = self._at(np.array([intrinsics.width, intrinsics.height], dtype=float))
        cv2.rectangle(self.canvas, self._at(np.zeros(2)), corner, _SKY, -1)
        cv2.rectangle(self.canvas, self._at(np.zeros(2)), corner, _FRAME, 2)

    @classmethod
    def of(cls, intrinsics: Intrinsics, pose: Pose) -> _Sheet:
        """A sheet for one camera. What lies beyond the frame is drawn as a perfect lens would show it."""
        ideal = intrinsics.without_distortion()
        return cls(ideal, pose, min(1.0, _WIDEST_PX / ((1 + 2 * _MARGIN) * intrinsics.width)))

    def polyline(self, points: FloatArray, colour: tuple[int, int, int], thickness: int) -> None:
        """A line through site points (N, 3), broken where they are behind the camera or far outside."""
        pixels, _ = project(self._intrinsics, self._pose, points)
        near = inside(self._intrinsics, pixels, -2.0 * self._intrinsics.width)
        draw_runs(self.canvas, pixels * self._scale + self._origin, near, colour, thickness)

    def mark(self, place: FloatArray, name: str, colour: tuple[int, int, int], *, ring: bool) -> None:
        """A ring or a cross at a site point (3,), with its name."""
        at = self._pixel(place)
        if at is None:
            return
        if ring:
            cv2.circle(self.canvas, at, 5, colour, 1, cv2.LINE_AA)
        else:
            cv2.drawMarker(self.canvas, at, colour, cv2.MARKER_CROSS, 14, 1, cv2.LINE_AA)
        self._text(name, (at[0] + 8, at[1] - 5), colour)

    def text_at(self, place: FloatArray, text: str, colour: tuple[int, int, int]) -> None:
        """A word beside a site point (3,)."""
        at = self._pixel(place)
        if at is not None:
            self._text(text, (at[0] + 8, at[1] + 4), colour)

    def with_legend(self, lines: list[str]) -> ColourImage:
        """The drawing with lines of text below."""
        lines = [part for line in lines for part in _wrapped(line.replace("°", " deg"), self.canvas.shape[1] - 24)]
        band = np.full((22 * len(lines) + 12, self.canvas.shape[1], 3), 250, np.uint8)
        for number, line in enumerate(lines):
            cv2.putText(
                band, line, (12, 22 * (number + 1)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA
            )
        return np.vstack([self.canvas, band])

    def _at(self, pixel: FloatArray) -> tuple[int, int]:
        u, v = pixel * self._scale + self._origin
        return round(float(u)), round(float(v))

    def _pixel(self, place: FloatArray) -> tuple[int, int] | None:
        """Where a site point is on the sheet; None where it is not."""
        pixel, _ = project(self._intrinsics, self._pose, place)
        if not np.isfinite(pixel).all():
            return None
        u, v = self._at(pixel)
        height, width = self.canvas.shape[:2]
        return (u, v) if 0 <= u < width and 0 <= v < height else None

    def _text(self, text: str, at: tuple[int, int], colour: tuple[int, int, int]) -> None:
        """Write a word at the first place from there downwards where no other word stands."""
        place = self._words.place(text, at, 0.42)
        cv2.putText(self.canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
