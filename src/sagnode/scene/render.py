"""The way of a rendered frame, from far to near: sky, horizon, ground, things by distance, wires, lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.scene.canvas import Air, Canvas
from sagnode.scene.catenary import WireState
from sagnode.scene.noise import sample, tile
from sagnode.scene.optics import develop, exposure_and_gain, sunlight
from sagnode.scene.sky import air_light, paint_horizon, paint_sky
from sagnode.scene.spec import Moment, Scene, SpanFrame
from sagnode.scene.structures import Bar, Thing, landmark_things, tower
from sagnode.scene.terrain import paint_ground
from sagnode.scene.truth import truth_document
from sagnode.scene.vegetation import country_trees, draw_tree
from sagnode.scene.wires import WireLook, draw_conductor, draw_wire


@dataclass(frozen=True)
class Rendered:
    """A frame and the truth about it."""

    image: GreyImage
    """8-bit grey (height, width), raw (distorted) pixels."""
    truth: dict[str, object]
    """The JSON document, see :func:`sagnode.scene.truth.truth_document`."""


def render(scene: Scene, moment: Moment) -> Rendered:
    """Render one frame with its truth; the same scene and moment give the same pixels.

    Args:
        scene: the world and the camera.
        moment: how everything is at that time.
    """
    frame = SpanFrame.of(scene.true)
    air = Air(moment.fog_per_m + 0.0025 * moment.rain, air_light(moment))
    canvas = Canvas.blank(scene.intrinsics, scene.pose_at(moment), frame.rotation, moment.psf_px, air)
    sun = sunlight(moment)
    _paint_backdrop(canvas, scene, moment, frame, sun)
    for thing in sorted(_things(canvas, scene, frame, sun), key=lambda t: -t.distance_m):
        thing.draw()
    seen = _draw_wires(canvas, scene, moment, sun)
    image = develop(scene, moment, canvas.grey)
    return Rendered(image, truth_document(scene, moment, seen))


def _paint_backdrop(canvas: Canvas, scene: Scene, moment: Moment, frame: SpanFrame, sun: float) -> None:
    if scene.world.backdrop == "country":
        paint_sky(canvas, scene, moment)
        paint_horizon(canvas, scene, moment)
        paint_ground(canvas, scene, frame, sun)
        return
    canvas.grey[...] = scene.world.plain_grey
    if scene.world.backdrop == "textured":
        direction = canvas.direction / np.linalg.norm(canvas.direction, axis=-1, keepdims=True)
        scale = np.float32(canvas.intrinsics.fx)
        texture = tile(scene.seed, "clutter", slope=0.9, coarsest=48.0, finest=2.5)
        canvas.grey[...] += np.float32(16.0) * sample(texture, direction[..., 1] * scale, direction[..., 2] * scale)


def _things(canvas: Canvas, scene: Scene, frame: SpanFrame, sun: float) -> list[Thing]:
    """Everything that stands, with its distance."""
    camera = canvas.pose.position
    place = frame.to_span(camera)[:2]
    things = landmark_things(canvas, scene, frame, sun)
    for number, tree in enumerate(country_trees(scene, frame)):
        distance = float(np.hypot(tree.along_m - place[0], tree.across_m - place[1]))
        things.append(Thing(distance, _Draw(canvas, scene, frame, sun, tree=(number, tree))))
    if scene.world.towers and scene.world.backdrop == "country":
        for far in (True, False):
            bars = tower(scene, frame, far=far)
            distance = float(np.linalg.norm(np.mean([b.ends.mean(axis=0) for b in bars], axis=0) - camera))
            # The camera's own tower is behind the glass.
            if distance > 20.0 or far:
                things.append(Thing(distance, _Draw(canvas, scene, frame, sun, bars=bars)))
    return things


@dataclass(frozen=True)
class _Draw:
    """A tree or a tower, ready to be drawn."""

    canvas: Canvas
    scene: Scene
    frame: SpanFrame
    sun: float
    tree: tuple[int, object] | None = None
    bars: list[Bar] | None = None

    def __call__(self) -> None:
        if self.tree is not None:
            number, tree = self.tree
            draw_tree(self.canvas, self.scene, self.frame, tree, self.sun, number)  # type: ignore[arg-type]
        for bar in self.bars or ():
            self.canvas.segment(bar.ends, bar.width_m, bar.grey * (0.8 + 0.35 * self.sun), opaque=False)


def _draw_wires(canvas: Canvas, scene: Scene, moment: Moment, sun: float) -> dict[str, dict[str, float]]:
    """Draw all wires; by conductor id, what the truth file says about how they are seen."""
    if not moment.draw_wires:
        return {}
    look = WireLook(shade=46.0 + 12.0 * sun, lit=112.0 + 78.0 * sun)
    brightness, _ = exposure_and_gain(moment)
    for k, wire in enumerate(scene.world.other_wires):
        state = WireState(wire.sag_m)
        draw_wire(canvas, np.array(wire.near), np.array(wire.far), state, wire.diameter_m, look, [scene.seed, 900 + k])
    seen: dict[str, dict[str, float]] = {}
    for k, conductor in enumerate(scene.true.conductors):
        state_or_none = moment.wires.get(conductor.id)
        if state_or_none is None:
            continue
        how = draw_conductor(canvas, conductor, state_or_none, look, scene.seed + 1000 * (k + 1))
        seen[conductor.id] = {
            "visible_share": round(how.visible_share, 3),
            "contrast_grey": round(how.contrast * brightness, 1),
        }
    return seen
