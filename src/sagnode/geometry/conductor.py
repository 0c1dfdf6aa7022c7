r"""The conductor in space: a quadratic Bézier, made exact by the catenary's departure from its parabola.

::

    A *--------- chord ----------* B      C(t) = (1-t)² A + 2t(1-t) P₁ + t² B + δ(t)·d(φ)
       \            |           /         P₁   = A + u (B-A) + 2 D d(φ), u = ½
        `--.        | D      .-'          d(φ) = apparent gravity: down, turned by the swing φ about the chord
            `--.____v____.--'             D    = distance from the middle of the chord along d(φ)

The departure ``δ`` makes the curve a true catenary of horizontal span L and rise h, turned as a whole about the chord.

Ice or a weight on part of the span makes the load uneven: ``w(s) = w̄ (1 + Σ cₖ Pₖ(2s-1))`` with Legendre's polynomials
along the span, k = 1, 2, …. A cable's depth below its chord is the bending moment of its load over the horizontal
tension, so each term adds ``D cₖ gₖ(s)``, gₖ being the twice integrated polynomial. ``c₁`` alone moves the Bézier's
middle control point along the chord: u = ½ + c₁/6. All functions broadcast over leading axes of their parameters.
"""

from __future__ import annotations

import math
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sagnode.geometry.camera import FloatArray
from sagnode.native import kernels

_DOWN = np.array([0.0, 0.0, -1.0])
_IDENTITY = np.eye(3)
_CLOCKWISE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])

NEWTON_STEPS, SETTLED = 6, 1e-6
"""Most steps towards a catenary's half-angle, and the change of its logarithm whose square is nothing."""


def catenary_half_angle(span: ArrayLike, rise: ArrayLike, sag: ArrayLike) -> FloatArray:
    """Half-angle q = L/(2a) of the catenary with vertical sag D at mid-chord, for span L and rise h (same unit).

    Solves ``D = (L/2q)·sqrt(1 + (h q/(L sinh q))²)·(cosh q - 1)``, which is the mid-chord sag of y = a cosh(x/a)
    between supports L apart and h different in height, by Newton's method in ln q from the parabola's value.
    """
    span_, rise_, sag_ = (np.asarray(value, dtype=np.float64) for value in (span, rise, sag))
    if span_.size == rise_.size == sag_.size == 1 and 0.0 < sag_.item() < span_.item():
        # one curve, as most calls ask for: plain floats take a tenth of the time that arrays of one element do
        q = _half_angle(span_.item(), rise_.item(), sag_.item())
        return np.full(np.broadcast_shapes(span_.shape, rise_.shape, sag_.shape), q)
    slope2 = (rise_ / span_) ** 2
    target = np.maximum(sag_, 1e-9 * span_) / span_
    qs = _parabolic_half_angle(slope2, target)
    qs = qs[0] / np.maximum(qs[1], 0.5)
    for _ in range(NEWTON_STEPS):
        step = np.clip(_newton_step(slope2, target, qs, np), -1.0, 1.0)
        qs = qs * np.exp(step)
        # the next step would be about the square of this one
        if not np.abs(step).max(initial=0.0) > SETTLED:
            break
    return np.asarray(qs)


def _half_angle(span: float, rise: float, sag: float) -> float:
    """:func:`catenary_half_angle` of one curve."""
    slope2 = (rise / span) ** 2
    target = max(sag, 1e-9 * span) / span
    parabolic, correction = _parabolic_half_angle(slope2, target)
    q = float(parabolic / max(correction, 0.5))
    for _ in range(NEWTON_STEPS):
        step = min(max(_newton_step(slope2, target, q, math), -1.0), 1.0)
        q *= math.exp(step)
        if not abs(step) > SETTLED:
            break
    return q


def _parabolic_half_angle(slope2: Any, target: Any) -> tuple[Any, Any]:
    """The parabola's half-angle, and the divisor by which the next term of the series corrects it."""
    q = 4 * target / (1 + slope2) ** 0.5
    return q, 1 + q * q * (1 / 12 - slope2 / (6 * (1 + slope2)))


def _newton_step(slope2: Any, target: Any, q: Any, functions: ModuleType) -> Any:
    """Newton's step in ln q: floats with the functions of ``math``, arrays with NumPy's."""
    # d ln(sag) / d ln q; cosh q - 1 = 2 sinh²(q/2) keeps its digits at small q
    sinh, excess = functions.sinh(q), 2 * functions.sinh(0.5 * q) ** 2
    steep2 = slope2 * (q / sinh) ** 2
    value = 0.5 * excess / q * functions.sqrt(1 + steep2)
    slope = q * sinh / excess - 1 + steep2 / (1 + steep2) * (1 - q * (1 + excess) / sinh)
    return functions.log(target / value) / slope


def sag_profile(span: ArrayLike, rise: ArrayLike, sag: ArrayLike, s: FloatArray) -> FloatArray:
    """Distance below the chord along gravity at the horizontal fractions ``s`` (N,): shape (..., N), exact catenary."""
    span_, rise_, sag_ = (np.asarray(value, dtype=np.float64)[..., None] for value in (span, rise, sag))
    q = catenary_half_angle(span_, rise_, sag_)
    a = span_ / (2 * q)
    m = np.arcsinh(rise_ * q / (span_ * np.sinh(q)))
    # chord - catenary, with y(s) - y(0) = 2a sinh(m - q + q s) sinh(q s): the product keeps its digits at small sag,
    # and both factors come out of one exponential, which takes a tenth of the time of two hyperbolic sines
    grown, start = np.exp(q * s), np.exp(m - q)
    shrunk = 1 / grown
    rise_here = 0.5 * (start * grown - shrunk / start) * (grown - shrunk)
    rise_end = 2 * np.sinh(m) * np.sinh(q)
    return np.asarray(a * (s * rise_end - rise_here))


def gravity_direction(near: FloatArray, far: FloatArray, swing_rad: ArrayLike) -> FloatArray:
    """d(φ) (..., 3): straight down turned by the swing about the chord; positive swings to the right seen from A."""
    chord = far - near
    swing = np.asarray(swing_rad, dtype=np.float64)
    if chord.ndim == 1 and swing.ndim == 0:
        x, y, z = (float(part) for part in chord)
        return np.array(_turned_down(x, y, z, swing.item()), dtype=np.float64)
    chord = chord / np.sqrt(np.sum(chord * chord, axis=-1, keepdims=True))
    swing = swing[..., None]
    # Rodrigues about the chord c: (d·c) c + cos φ (d - (d·c) c) + sin φ (c x up), d being straight down
    along = -chord[..., 2:] * chord
    side = np.stack([chord[..., 1], -chord[..., 0], np.zeros(chord.shape[:-1])], axis=-1)
    cosine = np.cos(swing)
    return np.asarray((1 - cosine) * along + cosine * _DOWN + np.sin(swing) * side)


def _turned_down(x: float, y: float, z: float, swing: float) -> tuple[float, float, float]:
    """:func:`gravity_direction` of one chord (x, y, z) and one swing."""
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    cosine, sine = math.cos(swing), math.sin(swing)
    along = (cosine - 1) * z
    return along * x + sine * y, along * y - sine * x, along * z - cosine


def load_shapes(s: FloatArray, count: int) -> FloatArray:
    """What the first ``count`` terms of an uneven load add to the depth below the chord, over D: gₖ(s), (count, N).

    ``gₖ = -2 ∬ Pₖ`` over x = 2s-1 with gₖ(±1) = 0, so that an even load (k = 0) would give 1 at mid-span.
    """
    x = 2 * np.asarray(s, dtype=np.float64) - 1
    return np.asarray(_load_polynomials(count) @ np.polynomial.polynomial.polyvander(x, count + 2).T)


def finer_load_shapes(s: FloatArray, first: int, last: int) -> FloatArray:
    """The shapes of :func:`load_shapes` for the terms ``first`` to ``last``, at least 2: (last - first + 1, N).

    By Legendre's recurrence, which keeps its digits where the powers of x of a high term cancel.
    """
    values = np.polynomial.legendre.legvander(2 * np.asarray(s, dtype=np.float64) - 1, last + 2).T
    k = np.arange(first, last + 1)
    above, own, below = ((2 * k + 1) * (2 * k + 3), (2 * k - 1) * (2 * k + 3), (2 * k - 1) * (2 * k + 1))
    return np.asarray(
        4 * values[k] / own[:, None] - 2 * values[k + 2] / above[:, None] - 2 * values[k - 2] / below[:, None]
    )


@cache
def _load_polynomials(count: int) -> FloatArray:
    """Coefficients (count, count + 3) of the polynomials gₖ in x, lowest power first."""
    legendre = [np.polynomial.legendre.leg2poly([0.0] * k + [1.0]) for k in range(count + 3)]
    rows = np.zeros((count, count + 3))
    for k, row in enumerate(rows, start=1):
        row[: k + 3] -= 2 * legendre[k + 2] / ((2 * k + 1) * (2 * k + 3))
        row[: k + 1] += 4 * legendre[k] / ((2 * k - 1) * (2 * k + 3))
        # of P₁ the second integral has no term below it: what makes it vanish at both ends is x itself
        below = legendre[k - 2] / ((2 * k - 1) * (2 * k + 1)) if k > 1 else np.array([0.0, 1 / 3])
        row[: len(below)] -= 2 * below
    return rows


def conductor_points(
    near: FloatArray,
    far: FloatArray,
    sag: ArrayLike,
    swing_rad: ArrayLike,
    t: FloatArray,
    load: ArrayLike = (),
) -> FloatArray:
    """Points (..., N, 3) of the conductor at the curve parameters ``t`` (N,).

    Args:
        near: attachment A (..., 3), m.
        far: attachment B (..., 3), m.
        sag: in-plane sag D that the mean load gives at mid-chord, m, shape (...).
        swing_rad: swing φ, rad, shape (...).
        t: curve parameter in [0, 1]: the fraction of the chord.
        load: terms cₖ of an uneven load, shape (..., K); none for an even one.
    """
    shape = (np.asarray(sag, dtype=np.float64), np.asarray(swing_rad, dtype=np.float64))
    terms = np.asarray(load, dtype=np.float64)
    if kernels is not None and near.ndim == far.ndim == terms.ndim == 1 and shape[0].ndim == shape[1].ndim == 0:
        points = np.empty((len(t), 3))
        places = (np.asarray(near, dtype=np.float64), np.asarray(far, dtype=np.float64))
        kernels.curve_points(*places, *shape, terms, np.asarray(t, dtype=np.float64), points)
        return points
    chord = far - near
    profile = loaded_profile(np.hypot(chord[..., 0], chord[..., 1]), chord[..., 2], sag, t, load)
    direction = gravity_direction(near, far, swing_rad)
    on_chord = near[..., None, :] + t[:, None] * chord[..., None, :]
    return np.asarray(on_chord + profile[..., None] * direction[..., None, :])


def conductor_derivatives(
    near: FloatArray, far: FloatArray, sag: float, swing_rad: float, t: FloatArray, load: ArrayLike = ()
) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) of one conductor, and their derivatives (N, 3, 8) by A (m), B (m), sag D (m) and swing φ (rad).

    Arguments as of :func:`conductor_points`. An attachment carries the chord along and, by turning it, d(φ): with
    e = (B-A)/|B-A|, ``∂d/∂e = (cos φ - 1)(e zᵀ + e_z I) + sin φ R``, R turning by -90° about z. The catenary's small
    departure from its parabola is taken to grow as D³ whatever the chord: derivatives are right to a thousandth.
    """
    chord = far - near
    profile = loaded_profile(np.hypot(chord[0], chord[1]), chord[2], sag, t, load)
    departure = profile - sag * (4 * t * (1 - t) + _uneven(t, load))
    length = np.sqrt(chord @ chord)
    unit = chord / length
    direction, aside = gravity_direction(near, far, np.array([swing_rad, swing_rad + 0.5 * np.pi]))
    turn = (np.cos(swing_rad) - 1) * (unit[2] * _IDENTITY - unit[:, None] * _DOWN) + np.sin(swing_rad) * _CLOCKWISE
    turn = turn @ (_IDENTITY - unit[:, None] * unit) / length
    derivatives = np.empty((len(t), 3, 8))
    turned = profile[:, None, None] * turn
    derivatives[:, :, 0:3] = (1 - t)[:, None, None] * _IDENTITY - turned
    derivatives[:, :, 3:6] = t[:, None, None] * _IDENTITY + turned
    derivatives[:, :, 6] = ((profile + 2 * departure) / sag)[:, None] * direction
    # what lies along the chord does not turn
    derivatives[:, :, 7] = profile[:, None] * (aside - (aside @ unit) * unit)
    return near + t[:, None] * chord + profile[:, None] * direction, derivatives


def loaded_profile(span: ArrayLike, rise: ArrayLike, sag: ArrayLike, s: FloatArray, load: ArrayLike = ()) -> FloatArray:
    """Depth (..., N) below the chord along apparent gravity: the exact catenary, and what an uneven load adds."""
    return sag_profile(span, rise, sag, s) + np.asarray(sag, dtype=np.float64)[..., None] * _uneven(s, load)


def _uneven(s: FloatArray, load: ArrayLike) -> FloatArray:
    """What an uneven load adds to the depth below the chord, over D: (..., N), or one zero for an even load."""
    terms = np.asarray(load, dtype=np.float64)
    count = terms.shape[-1]
    return np.asarray(terms @ load_shapes(s, count)) if count else np.zeros(1)


def control_points(
    near: FloatArray, far: FloatArray, sag: ArrayLike, swing_rad: ArrayLike, skew: ArrayLike = 0.5
) -> FloatArray:
    """Bézier control points (..., 3, 3): A, P₁, B with P₁ = A + u(B-A) + 2D·d(φ); u = ½ + c₁/6 for an uneven load."""
    direction = gravity_direction(near, far, swing_rad)
    sag_ = np.asarray(sag, dtype=np.float64)[..., None]
    handle = near + np.asarray(skew, dtype=np.float64)[..., None] * (far - near) + 2 * sag_ * direction
    return np.stack([np.broadcast_to(near, handle.shape), handle, np.broadcast_to(far, handle.shape)], axis=-2)
