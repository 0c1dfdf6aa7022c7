"""The truth beside a frame: all reported quantities by brute force from the dense exact curve, and its JSON file.

Independent of :mod:`sagnode.geometry`: every quantity is a plain maximum or minimum over points that are a centimetre
apart on a 270 m span.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from sagnode.config.span import Conductor, Span
from sagnode.errors import FrameError
from sagnode.geometry.camera import FloatArray, inside, project
from sagnode.message import QUANTITIES
from sagnode.scene.catenary import WireState, constant_of_state, load_skew, profile, wire_points
from sagnode.scene.spec import Moment, Scene

SCHEMA = "sagnode.truth/1"
DENSE = 20001
"""Points on the curve from which the truth is taken."""


def ground_and_obstacles(span: Span, along: FloatArray) -> FloatArray:
    """Height of whatever counts for clearance at ``along``: the profile, or an obstacle that is higher."""
    points = np.array(span.ground.profile)
    height = np.interp(along, points[:, 0], points[:, 1])
    for obstacle in span.ground.obstacles:
        within = (along >= obstacle.along_m[0]) & (along <= obstacle.along_m[1])
        height = np.where(within, np.maximum(height, obstacle.height_m), height)
    return np.asarray(height)


def true_quantities(span: Span, conductor: Conductor, state: WireState) -> dict[str, float]:
    """Every quantity of :data:`sagnode.message.QUANTITIES` that geometry gives, by stem; metres, degrees, newtons.

    ``inplane_sag`` is measured along apparent gravity, as the sag that a state is made of; ``blowout`` is a magnitude;
    under wind the tension belongs to the apparent weight w/cos φ. With extra loads H/w is still over the bare wire's
    weight, so that times it is the tension.
    """
    near, far = np.array(conductor.near), np.array(conductor.far)
    chord = far - near
    length = float(np.hypot(chord[0], chord[1]))
    s = np.linspace(0.0, 1.0, DENSE)
    points = wire_points(near, far, state, s)
    forward = chord[:2] / length
    offset = points[:, :2] - near[:2]
    along = offset @ forward
    across = offset @ np.array([forward[1], -forward[0]])
    below_chord = near[2] + along / length * chord[2] - points[:, 2]
    free = points[:, 2] - ground_and_obstacles(span, along)
    lowest, closest = int(np.argmin(points[:, 2])), int(np.argmin(free))
    middle = np.array([length / 2])
    mid_height = float(np.interp(middle, along, points[:, 2])[0])
    quantities = {
        "sag": float(np.max(below_chord)),
        "inplane_sag": float(np.max(profile(length, float(chord[2]), state, s))),
        "swing": state.swing_deg,
        "blowout": float(np.max(np.abs(across))),
        "lowest_height": float(points[lowest, 2]),
        "lowest_along": float(along[lowest]),
        "drop": float(max(near[2], far[2]) - points[lowest, 2]),
        "clearance": float(free[closest]),
        "clearance_along": float(along[closest]),
        "midspan_sag": float((near[2] + far[2]) / 2 - mid_height),
        "midspan_clearance": mid_height - float(ground_and_obstacles(span, middle)[0]),
        "catenary_constant": constant_of_state(length, float(chord[2]), state),
        "load_skew": load_skew(state.loads),
    }
    if conductor.unit_weight_n_m is not None:
        quantities["tension"] = (
            quantities["catenary_constant"] * conductor.unit_weight_n_m / math.cos(math.radians(state.swing_deg))
        )
    return quantities


def pixel_curve(scene: Scene, moment: Moment, conductor: Conductor, count: int = 4001) -> FloatArray:
    """Raw pixels (count, 2) of a true conductor's centre line, by equal steps along the span; NaN where not seen."""
    s = np.linspace(0.0, 1.0, count)
    points = wire_points(np.array(conductor.near), np.array(conductor.far), moment.wires[conductor.id], s)
    pixels, _ = project(scene.intrinsics, scene.pose_at(moment), points)
    return np.where(inside(scene.intrinsics, pixels)[..., None], pixels, np.nan)


@dataclass(frozen=True)
class Truth:
    """A truth file, read back."""

    time: datetime
    conductors: dict[str, dict[str, float]]
    """By conductor id: quantities by stem, as :func:`true_quantities` gives them."""
    document: dict[str, Any]
    """The whole file."""


def truth_document(scene: Scene, moment: Moment, seen: dict[str, dict[str, float]]) -> dict[str, Any]:
    """The JSON document of a frame.

    Args:
        scene: the scene.
        moment: the moment that was rendered.
        seen: by conductor id, how the renderer saw it (contrast, visible share), copied into the file.
    """
    pose = scene.pose_at(moment)
    units = {q.stem: q.value_field for q in QUANTITIES}
    conductors: dict[str, Any] = {}
    for conductor in scene.true.conductors:
        if conductor.id not in moment.wires:
            continue
        state = moment.wires[conductor.id]
        values = true_quantities(scene.true, conductor, state)
        curve = pixel_curve(scene, moment, conductor, 2001)
        kept = np.flatnonzero(np.isfinite(curve[:, 0]))
        # Equal steps in the picture, not along the span: the far half of the span is a few dozen pixels.
        chosen = kept[_even_in_picture(curve[kept], 24)] if kept.size else kept
        conductors[conductor.id] = {
            **{units[stem]: round(value, 4) for stem, value in values.items()},
            **({"loads": [repr(load) for load in state.loads]} if state.loads else {}),
            **seen.get(conductor.id, {}),
            "pixels": [[round(float(u), 2), round(float(v), 2)] for u, v in curve[chosen]],
        }
    return {
        "schema": SCHEMA,
        "time": moment.time.isoformat().replace("+00:00", "Z"),
        "seed": [scene.seed, moment.seed],
        "camera": {
            "position": [round(float(x), 5) for x in pose.position],
            "rotation": [[round(float(x), 8) for x in row] for row in pose.rotation],
        },
        "weather": {
            "sun_elevation_deg": round(moment.sun_elevation_deg, 2),
            "cloud": round(moment.cloud, 3),
            "fog_per_m": round(moment.fog_per_m, 6),
            "rain": round(moment.rain, 3),
            "lens": moment.lens,
        },
        "conductors": conductors,
    }


def _even_in_picture(pixels: FloatArray, count: int) -> np.ndarray[Any, np.dtype[np.intp]]:
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    return np.unique(np.searchsorted(length, np.linspace(0, length[-1], count)).clip(0, len(pixels) - 1))


def read_truth(path: Path) -> Truth:
    """Read a truth file.

    Args:
        path: the ``.json``, or the frame beside which it lies.

    Raises:
        FrameError: there is none, or it is not a truth file.
    """
    file = path.with_suffix(".json")
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FrameError(f"{file}: no readable truth file: {error}", "render the frame again") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise FrameError(f"{file}: not a truth file of schema {SCHEMA}", "render the frame again")
    units = {q.value_field: q.stem for q in QUANTITIES}
    conductors = {
        name: {units[key]: float(value) for key, value in fields.items() if key in units}
        for name, fields in document["conductors"].items()
    }
    return Truth(datetime.fromisoformat(document["time"]), conductors, document)
