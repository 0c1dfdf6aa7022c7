"""The frame that is expected: the span's wires as thick and as dark as they would be, before an assumed background."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.config.span import Span
from sagnode.geometry.camera import Intrinsics
from sagnode.scene.canvas import Air, Canvas
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene, SpanFrame, World, survey_pose
from sagnode.scene.wires import WireLook, draw_conductor

Backdrop = Literal["plain", "textured", "country"]

MODEL_M = 20.0
"""Shorter spans are models, and stand before a wall."""
SKY = 170.0
"""Grey level of the even sky."""
BLUR_PX = 0.75
"""Point spread of a good lens in focus, standard deviation."""


@dataclass(frozen=True)
class Look:
    """What is assumed of the picture."""

    backdrop: Backdrop
    """plain: an even sky or wall, the best that can be; country: ground, fields and a wood below a clouded sky, all
    invented; textured: clutter everywhere."""
    contrast: float = 60.0
    """Before a plain sky: by how many grey levels a wire that fills a pixel is darker."""
    noise: float = 2.0
    """Before a plain sky: standard deviation of a pixel, grey levels."""

    def __str__(self) -> str:
        if self.backdrop == "plain":
            return f"an even sky, wires {self.contrast:g} grey levels darker, noise {self.noise:g} grey levels"
        if self.backdrop == "textured":
            return "clutter behind all wires, a clear day"
        return "invented country behind the wires (fields, a wood, sky), a clear day"


def usual_backdrop(span: Span) -> Backdrop:
    """What is probably behind the wires of a span."""
    return "country" if SpanFrame.of(span).length >= MODEL_M else "plain"


def expected_frame(span: Span, intrinsics: Intrinsics, states: Mapping[str, WireState], look: Look) -> GreyImage:
    """Draw every conductor of a span as it hangs; the same arguments give the same pixels.

    Args:
        span: with the planned camera in its place.
        intrinsics: of that camera.
        states: by conductor id.
        look: what is assumed of the picture.
    """
    if look.backdrop == "plain":
        return _before_sky(span, intrinsics, states, look)
    return render(Scene(span, span, intrinsics, World(look.backdrop)), Moment(states)).image


def _before_sky(span: Span, intrinsics: Intrinsics, states: Mapping[str, WireState], look: Look) -> GreyImage:
    shape = (intrinsics.height, intrinsics.width)
    canvas = Canvas(
        np.full(shape, SKY, np.float32),
        np.full(shape, np.inf, np.float32),
        np.empty((0, 0, 3), np.float32),
        intrinsics,
        survey_pose(span),
        BLUR_PX,
        Air(0.0, SKY),
    )
    dark = WireLook(shade=SKY - look.contrast, lit=SKY - look.contrast)
    for number, conductor in enumerate(span.conductors):
        draw_conductor(canvas, conductor, states[conductor.id], dark, seed=number)
    grey = canvas.grey
    grey += np.float32(look.noise) * np.random.default_rng(1).standard_normal(shape, dtype=np.float32)
    return np.asarray(np.clip(np.rint(grey), 0, 255), dtype=np.uint8)
