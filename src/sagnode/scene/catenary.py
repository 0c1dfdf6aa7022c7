r"""Exact hanging curves: the independent truth against which the measurement is judged.

Nothing here is shared with :mod:`sagnode.geometry.conductor`: the catenary constant is found by bisection of
``y(x) = a cosh((x - x0)/a) + c`` through both attachments, and the swing turns the finished curve as a rigid body.

::

    A *- - - - chord - - - -* B     profile: vertical distance from the chord down to the curve, before the swing
       `-.__     |D    __.-'        D: the profile at mid-chord
            `--._v__.-'
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sagnode.geometry.camera import FloatArray, rotation_from_vector


@dataclass(frozen=True)
class PartialLoad:
    """Extra weight over part of the span (ice that has not yet dropped): ``ratio`` times the conductor's own weight."""

    start: float
    """Beginning, as a fraction of the horizontal span."""
    end: float
    ratio: float


@dataclass(frozen=True)
class PointLoad:
    """A weight at one place (a trolley, a fallen branch): ``share`` times the weight of the whole bare span."""

    at: float
    """Place, as a fraction of the horizontal span."""
    share: float


Load = PartialLoad | PointLoad


@dataclass(frozen=True)
class WireState:
    """How one wire hangs at a moment."""

    sag_m: float
    """Sag D at mid-chord in the wire's own plane, along apparent gravity, m."""
    swing_deg: float = 0.0
    """Turn of the wire's plane about the chord, positive to the right seen from A."""
    loads: tuple[Load, ...] = ()
    """Extra loads; ``sag_m`` is the sag with them."""


def catenary_constant(span: float, rise: float, sag: float) -> float:
    """The constant a = H/w (m) of the catenary over ``span`` with ``rise`` whose mid-chord sag is ``sag`` (all m)."""

    def mid_sag(a: float) -> float:
        return rise / 2 - _height(span, rise, a, span / 2)

    low, high = math.log(span / 40), math.log(span * 1e9)
    for _ in range(200):
        middle = (low + high) / 2
        if mid_sag(math.exp(middle)) > sag:
            low = middle
        else:
            high = middle
        if high - low < 1e-15:
            break
    return math.exp((low + high) / 2)


def _vertex(span: float, rise: float, a: float) -> float:
    """Horizontal distance of the catenary's vertex from A (may lie outside the span)."""
    return span / 2 - a * math.asinh(rise / (2 * a * math.sinh(span / (2 * a))))


def _height(span: float, rise: float, a: float, x: float) -> float:
    """Height of the catenary above A at the horizontal distance x."""
    vertex = _vertex(span, rise, a)
    return 2 * a * math.sinh((x - 2 * vertex) / (2 * a)) * math.sinh(x / (2 * a))


def _moment(s: FloatArray, loads: tuple[Load, ...]) -> FloatArray:
    """Bending moment of the simply supported beam of unit span under unit weight and the extra loads."""
    moment = s * (1 - s) / 2
    for load in loads:
        if isinstance(load, PointLoad):
            moment = moment + load.share * ((1 - load.at) * s - np.maximum(s - load.at, 0.0))
        else:
            reaction = load.ratio * (load.end - load.start) * (1 - (load.start + load.end) / 2)
            inside = np.maximum(s - load.start, 0.0) ** 2 - np.maximum(s - load.end, 0.0) ** 2
            moment = moment + reaction * s - load.ratio * inside / 2
    return moment


def profile(span: float, rise: float, state: WireState, s: FloatArray) -> FloatArray:
    """Vertical distance from the chord down to the unswung wire at the horizontal fractions ``s`` (N,), m.

    A uniform load gives the exact catenary. Extra loads bend it by their moment diagram (a cable hangs as M/H below
    its chord, exact for loads per horizontal metre) on top of the catenary's departure from its own parabola.
    """
    a = catenary_constant(span, rise, state.sag_m)
    vertex = _vertex(span, rise, a)
    x = s * span
    catenary = s * rise - 2 * a * np.sinh((x - 2 * vertex) / (2 * a)) * np.sinh(x / (2 * a))
    if not state.loads:
        return catenary
    bent = _moment(s, state.loads) / _moment(np.array([0.5]), state.loads)[0]
    return np.asarray(catenary + state.sag_m * (bent - 4 * s * (1 - s)))


def constant_of_state(span: float, rise: float, state: WireState) -> float:
    """H/w (m) with w the bare weight: the catenary's constant, raised by the moment ratio where loads are hung on."""
    middle = np.array([0.5])
    ratio = float(_moment(middle, state.loads)[0] / _moment(middle, ())[0])
    return ratio * catenary_constant(span, rise, state.sag_m)


def wire_points(near: FloatArray, far: FloatArray, state: WireState, s: FloatArray) -> FloatArray:
    """Points (N, 3) in the site frame of the wire from ``near`` to ``far`` at the fractions ``s`` (N,)."""
    chord = far - near
    span = float(np.hypot(chord[0], chord[1]))
    hanging = s[:, None] * chord - profile(span, float(chord[2]), state, s)[:, None] * np.array([0.0, 0.0, 1.0])
    axis = chord / np.linalg.norm(chord)
    # A turn about the chord by -φ takes "down" to the right of someone who looks from A to B.
    turn = rotation_from_vector(-math.radians(state.swing_deg) * axis)
    return np.asarray(near + hanging @ turn.T)
