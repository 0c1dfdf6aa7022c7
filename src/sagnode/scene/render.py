"""The way of a rendered frame, from far to near: sky, horizon, ground, things by distance, wires, lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.scene.canvas import Air, Canvas
from sagnode.scene.catenary import WireState, wire_points
from sagnode.scene.light import Light
from sagnode.scene.noise import Floats, sample, tile
from sagnode.scene.optics import develop, developed, exposure_and_gain, noise_level
from sagnode.scene.sky import air_light, paint_horizon, paint_sky
from sagnode.scene.spec import Moment, Scene, SpanFrame
from sagnode.scene.structures import Bar, Thing, landmark_things, tower
from sagnode.scene.terrain import paint_ground
from sagnode.scene.truth import truth_document
from sagnode.scene.vegetation import country_trees, draw_tree
from sagnode.scene.wires import Seen, WireLook, draw_conductor, draw_wire


@dataclass(frozen=True)
class Rendered:
    """A frame and the truth about it."""

    image: GreyImage
    """8-bit grey (height, width), raw (distorted) pixels."""
    truth: dict[str, object]
    """The JSON document, see :func:`sagnode.scene.truth.truth_document`."""
    seen: dict[str, tuple[Seen, ...]]
    """How every sub-conductor came out, by conductor id."""


def render(scene: Scene, moment: Moment) -> Rendered:
    """Render one frame with its truth; the same scene and moment give the same pixels.

    Args:
        scene: the world and the camera.
        moment: how everything is at that time.
    """
    frame = SpanFrame.of(scene.true)
    air = Air(moment.fog_per_m + 0.0025 * moment.rain, air_light(moment))
    canvas = Canvas.blank(scene.intrinsics, scene.pose_at(moment), frame.rotation, moment.psf_px, air)
    light = Light.of(moment)
    _paint_backdrop(canvas, scene, moment, frame, light)
    for thing in sorted(_things(canvas, scene, frame, light), key=lambda t: -t.distance_m):
        thing.draw()
    seen = _draw_wires(canvas, scene, moment, light)
    image = develop(scene, moment, canvas.grey)
    summary = {name: _summary(how, moment) for name, how in seen.items()}
    return Rendered(image, truth_document(scene, moment, summary), seen)


def _paint_backdrop(canvas: Canvas, scene: Scene, moment: Moment, frame: SpanFrame, light: Light) -> None:
    if scene.world.backdrop == "country":
        paint_sky(canvas, scene, moment)
        paint_horizon(canvas, scene, light)
        paint_ground(canvas, scene, frame, light)
        return
    canvas.grey[...] = scene.world.plain_grey
    if scene.world.backdrop == "textured":
        x, y, up = (canvas.direction[..., k] for k in range(3))
        scale = np.float32(canvas.intrinsics.fx)
        bearing, elevation = np.arctan2(y, x) * scale, np.arctan2(up, np.hypot(x, y)) * scale
        texture = tile(scene.seed, "clutter", slope=0.9, coarsest=48.0, finest=2.5)
        canvas.grey[...] += np.float32(16.0) * sample(texture, bearing, elevation)


def _things(canvas: Canvas, scene: Scene, frame: SpanFrame, light: Light) -> list[Thing]:
    """Everything that stands, with its distance."""
    camera = canvas.pose.position
    place = frame.to_span(camera)[:2]
    things = landmark_things(canvas, scene, frame, light)
    for number, tree in enumerate(country_trees(scene, frame)):
        distance = float(np.hypot(tree.along_m - place[0], tree.across_m - place[1]))
        things.append(Thing(distance, partial(draw_tree, canvas, scene, frame, tree, light, number)))
    if scene.world.towers and scene.world.backdrop == "country":
        for far in (True, False):
            bars = tower(scene, frame, far=far)
            distance = float(np.linalg.norm(np.mean([b.ends.mean(axis=0) for b in bars], axis=0) - camera))
            # The camera's own tower is behind the glass.
            if distance > 20.0 or far:
                things.append(Thing(distance, partial(_draw_bars, canvas, bars, light)))
    return things


def _draw_bars(canvas: Canvas, bars: list[Bar], light: Light) -> None:
    """Draw a lattice; wires are seen through it."""
    for bar in bars:
        grey = bar.grey * light.on_bar(bar.ends, canvas.pose.position, 0.8 + 0.35 * light.sun)
        axis = np.abs(bar.ends[1] - bar.ends[0])
        level = float(1 - axis[2] / max(float(np.linalg.norm(axis)), 1e-9))
        canvas.segment(bar.ends, bar.width_m, light.snowed(grey, 0.6 * level), opaque=False)


def _draw_wires(canvas: Canvas, scene: Scene, moment: Moment, light: Light) -> dict[str, tuple[Seen, ...]]:
    """Draw all wires; by conductor id, how they are seen."""
    if not moment.draw_wires:
        return {}
    tone, direct = scene.world.wire_tone, 78.0 * light.sun
    greys = tone * (46.0 + 12.0 * light.sun), tone * (112.0 + direct), tone * moment.rounded * direct
    look = WireLook(*greys, light.towards)
    for k, wire in enumerate(scene.world.other_wires):
        state = WireState(wire.sag_m)
        draw_wire(canvas, np.array(wire.near), np.array(wire.far), state, wire.diameter_m, look, [scene.seed, 900 + k])
    seen: dict[str, tuple[Seen, ...]] = {}
    for k, conductor in enumerate(scene.true.conductors):
        if conductor.id not in moment.wires:
            continue
        seed = scene.seed + 1000 * (k + 1)
        state, ends = moment.wires[conductor.id], (np.array(conductor.near), np.array(conductor.far))
        seen[conductor.id] = tuple(
            developed(scene, moment, drawn, wire_points(*ends, state, drawn.place))
            for drawn in draw_conductor(canvas, conductor, state, look, seed)
        )
    return seen


CLEAR_SNR = 3.0
"""Contrast over the noise of one pixel from which a wire is clear to see."""


def _summary(wires: tuple[Seen, ...], moment: Moment) -> dict[str, float]:
    """How much of a conductor is in the frame, and how much of it stands out from the noise.

    ``visible_share``: share of the span in the frame and behind nothing. ``resolved_share``: share of the span where
    the wire's contrast also reaches the noise of one pixel; ``clear_share``: three times that. ``contrast_grey`` and
    ``snr``: medians of contrast, and of contrast over noise, over the visible span. A bundle is told by its first
    sub-conductor. Rain streaks and drops on the lens come after this and are not counted.
    """
    how = wires[0]
    brightness, gain = exposure_and_gain(moment)
    if moment.lens in ("covered", "fogged") or how.share.size == 0:
        return dict.fromkeys(("visible_share", "resolved_share", "clear_share", "contrast_grey", "snr"), 0.0)
    contrast = how.contrast(moment.psf_px) * brightness
    noise = noise_level(moment, how.background * brightness, gain)
    snr = contrast / np.maximum(noise, np.float32(1e-6))
    return {
        "visible_share": round(min(float(how.share.sum()), 1.0), 3),
        "resolved_share": round(min(float(how.share[snr >= 1].sum()), 1.0), 3),
        "clear_share": round(min(float(how.share[snr >= CLEAR_SNR].sum()), 1.0), 3),
        "contrast_grey": round(_median(contrast, how.share), 1),
        "snr": round(_median(snr, how.share), 1),
    }


def _median(values: Floats, share: FloatArray) -> float:
    order = np.argsort(values)
    weight = np.cumsum(share[order])
    return float(values[order][int(np.searchsorted(weight, weight[-1] / 2))])
