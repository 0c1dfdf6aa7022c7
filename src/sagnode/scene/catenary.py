r"""Exact hanging curves: the independent truth against which the measurement is judged.

Nothing here is shared with :mod:`sagnode.geometry.conductor`: the catenary constant is found by bisection of
``y(x) = a cosh((x - x0)/a) + c`` through both attachments, uneven loads hang as the catenaries that statics joins, and
the swing turns the finished curve as a rigid body.

::

    A *- - - - chord - - - -* B     profile: vertical distance from the chord down to the curve, before the swing
       `-.__     |D    __.-'        D: the profile at mid-chord
            `--._v__.-'
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from sagnode.geometry.camera import FloatArray, rotation_from_vector


@dataclass(frozen=True)
class PartialLoad:
    """Extra weight over part of the span (ice that has not yet dropped): ``ratio`` times the conductor's own weight."""

    start: float
    """Beginning, as a fraction of the horizontal span."""
    end: float
    ratio: float
    """Extra weight per length of the wire over the wire's own."""
    sleeve_m: float = 0.0
    """By how much it makes the wire thicker to look at (diameter)."""


@dataclass(frozen=True)
class PointLoad:
    """A weight at one place (a trolley, a fallen branch): ``share`` times the weight of the whole bare span."""

    at: float
    """Place, as a fraction of the horizontal span."""
    share: float
    """Weight over own weight per length times horizontal span."""
    size_m: float = 0.0
    """How far it hangs down from the wire to look at; 0: it cannot be seen."""


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


def profile(span: float, rise: float, state: WireState, s: FloatArray) -> FloatArray:
    """Vertical distance from the chord down to the unswung wire at the horizontal fractions ``s`` (N,), m.

    A uniform load gives the exact catenary, extra loads the exact :class:`Polycatenary`.
    """
    if state.loads:
        return polycatenary(span, rise, state.sag_m, state.loads).below_chord(s)
    a = catenary_constant(span, rise, state.sag_m)
    vertex = _vertex(span, rise, a)
    x = s * span
    return np.asarray(s * rise - 2 * a * np.sinh((x - 2 * vertex) / (2 * a)) * np.sinh(x / (2 * a)))


def constant_of_state(span: float, rise: float, state: WireState) -> float:
    """H/w (m) with w the bare wire's weight: horizontal tension is H also where loads are hung on."""
    if state.loads:
        return polycatenary(span, rise, state.sag_m, state.loads).constant
    return catenary_constant(span, rise, state.sag_m)


def load_skew(loads: tuple[Load, ...]) -> float:
    """How much heavier than the mean a wire hangs at B, and lighter at A, by the straight line nearest to its load.

    ``3 ∫ w(s)(2s - 1) ds / ∫ w(s) ds`` over the horizontal fractions s; 0 for an even load.
    """
    total, moment = 1.0, 0.0
    for load in loads:
        if isinstance(load, PointLoad):
            total += load.share
            moment += load.share * (2 * load.at - 1)
        else:
            total += load.ratio * (load.end - load.start)
            moment += load.ratio * (load.end - load.start) * (load.start + load.end - 1)
    return 3 * moment / total


@dataclass(frozen=True)
class Polycatenary:
    r"""A cable whose weight changes along it: catenaries of one horizontal tension H, joined where the load changes.

    On a stretch that is ``r`` times as heavy as the bare wire the slope is ``sinh τ`` with ``dτ/dx = r/a``, a = H/w,
    and the height gains ``(a/r)(cosh τ₁ - cosh τ₀)``. A weight P at one place raises the slope there by P/H.
    """

    span: float
    rise: float
    constant: float
    """a = H/w of the bare wire, m."""
    knots: FloatArray
    """Where stretches begin, and the end of the last (K + 1,): horizontal distance from A, m."""
    weights: FloatArray
    """Weight of the stretches over the bare wire's (K,)."""
    angles: FloatArray
    """τ at the beginning of each stretch (K,)."""
    heights: FloatArray
    """Height of each stretch's beginning above A (K,), m."""

    def below_chord(self, s: FloatArray) -> FloatArray:
        """Vertical distance (N,) from the chord down to the cable at the horizontal fractions ``s`` (N,), m."""
        x = np.asarray(s, dtype=np.float64) * self.span
        k = np.clip(np.searchsorted(self.knots, x, side="right") - 1, 0, len(self.weights) - 1)
        own, first = self.constant / self.weights[k], self.angles[k]
        gain = (x - self.knots[k]) / own
        height = self.heights[k] + 2 * own * np.sinh(first + gain / 2) * np.sinh(gain / 2)
        return np.asarray(x / self.span * self.rise - height)


@lru_cache(maxsize=64)
def polycatenary(span: float, rise: float, sag: float, loads: tuple[Load, ...]) -> Polycatenary:
    """The cable over ``span`` with ``rise`` whose mid-chord sag is ``sag`` with the ``loads`` on it (lengths m).

    Solved by bisection twice: the slope at A brings the cable through B, the tension brings it to the sag.
    """
    pieces = _pieces(span, loads)
    middle = np.array([0.5])

    def hang(log_a: float) -> Polycatenary:
        return _through_far_end(span, rise, math.exp(log_a), pieces)

    # a stretch n times as heavy sags as a bare one of an n-th of the constant
    low, high = math.log(span / 40), math.log(span * 1e9)
    while high - low > 1e-14:
        between = (low + high) / 2
        if between in (low, high):
            break
        if float(hang(between).below_chord(middle)[0]) > sag:
            low = between
        else:
            high = between
    return hang((low + high) / 2)


@dataclass(frozen=True)
class _Pieces:
    """Where the load changes: knots (K + 1,) m, weights (K,) over the bare wire's, what hangs on each knot, m of it."""

    knots: tuple[float, ...]
    weights: tuple[float, ...]
    hung: tuple[float, ...]


def _pieces(span: float, loads: tuple[Load, ...]) -> _Pieces:
    places = {0.0, 1.0}
    for load in loads:
        places |= {load.at} if isinstance(load, PointLoad) else {load.start, load.end}
    knots = sorted(p for p in places if 0 <= p <= 1)
    weights = [
        1.0 + sum(q.ratio for q in loads if isinstance(q, PartialLoad) and q.start <= (left + right) / 2 <= q.end)
        for left, right in pairwise(knots)
    ]
    hung = [sum(q.share for q in loads if isinstance(q, PointLoad) and q.at == k) * span for k in knots[:-1]]
    return _Pieces(tuple(k * span for k in knots), tuple(weights), tuple(hung))


def _through_far_end(span: float, rise: float, a: float, pieces: _Pieces) -> Polycatenary:
    """The cable of one tension that begins at A and ends at B."""

    def run(angle: float) -> tuple[list[float], list[float], float]:
        angles, heights, height = [], [], 0.0
        for left, right, weight, hung in zip(pieces.knots, pieces.knots[1:], pieces.weights, pieces.hung, strict=False):
            if hung:
                angle = math.asinh(math.sinh(angle) + hung / a)
            angles.append(angle)
            heights.append(height)
            gain = (right - left) * weight / a
            height += 2 * a / weight * math.sinh(angle + gain / 2) * math.sinh(gain / 2)
            angle += gain
        return angles, heights, height

    total = sum((r - k) * w for k, r, w in zip(pieces.knots, pieces.knots[1:], pieces.weights, strict=False))
    reach = math.asinh(abs(rise) / span) + (total + sum(pieces.hung)) / a + 1e-9
    low, high = -reach, reach
    while True:
        middle = (low + high) / 2
        if middle in (low, high):
            break
        if run(middle)[2] > rise:
            high = middle
        else:
            low = middle
    angles, heights, _ = run(low)
    return Polycatenary(
        span, rise, a, np.array(pieces.knots), np.array(pieces.weights), np.array(angles), np.array(heights)
    )


def wire_points(near: FloatArray, far: FloatArray, state: WireState, s: FloatArray) -> FloatArray:
    """Points (N, 3) in the site frame of the wire from ``near`` to ``far`` at the fractions ``s`` (N,)."""
    chord = far - near
    span = float(np.hypot(chord[0], chord[1]))
    hanging = s[:, None] * chord - profile(span, float(chord[2]), state, s)[:, None] * np.array([0.0, 0.0, 1.0])
    axis = chord / np.linalg.norm(chord)
    # A turn about the chord by -φ takes "down" to the right of someone who looks from A to B.
    turn = rotation_from_vector(-math.radians(state.swing_deg) * axis)
    return np.asarray(near + hanging @ turn.T)
