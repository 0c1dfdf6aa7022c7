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

import numpy as np
from numpy.typing import ArrayLike

from sagnode.geometry.camera import FloatArray


def catenary_half_angle(span: ArrayLike, rise: ArrayLike, sag: ArrayLike) -> FloatArray:
    """Half-angle q = L/(2a) of the catenary with vertical sag D at mid-chord, for span L and rise h (same unit).

    Solves ``D = (L/2q)·sqrt(1 + (h q/(L sinh q))²)·(cosh q - 1)``, which is the mid-chord sag of y = a cosh(x/a)
    between supports L apart and h different in height, by Newton's method in ln q from the parabola's value.
    """
    span_, rise_, sag_ = (np.asarray(value, dtype=np.float64) for value in (span, rise, sag))
    slant = np.hypot(span_, rise_)
    target = np.maximum(sag_, 1e-9 * span_)
    q = 4 * target / slant

    for _ in range(5):
        # d ln(sag) / d ln q; cosh q - 1 = 2 sinh²(q/2) keeps its digits at small q
        steep2 = (rise_ * q / (span_ * np.sinh(q))) ** 2
        value = span_ / q * np.sqrt(1 + steep2) * np.sinh(q / 2) ** 2
        slope = q / np.tanh(q / 2) - 1 + steep2 / (1 + steep2) * (1 - q / np.tanh(q))
        q = q * np.exp(np.clip(np.log(target / value) / slope, -1.0, 1.0))
    return q


def sag_profile(span: ArrayLike, rise: ArrayLike, sag: ArrayLike, s: FloatArray) -> FloatArray:
    """Distance below the chord along gravity at the horizontal fractions ``s`` (N,): shape (..., N), exact catenary."""
    span_, rise_, sag_ = (np.asarray(value, dtype=np.float64)[..., None] for value in (span, rise, sag))
    q = catenary_half_angle(span_, rise_, sag_)
    a = span_ / (2 * q)
    m = np.arcsinh(rise_ * q / (span_ * np.sinh(q)))
    # chord - catenary, with cosh(m+x) - cosh(m+y) written as products of sinh to keep digits at small sag
    x = q * (2 * s - 1)
    # y(s) - y(0) and y(1) - y(0), in units of a
    rise_here = 2 * np.sinh(m + (x - q) / 2) * np.sinh((x + q) / 2)
    rise_end = 2 * np.sinh(m) * np.sinh(q)
    return np.asarray(a * (s * rise_end - rise_here))


def gravity_direction(near: FloatArray, far: FloatArray, swing_rad: ArrayLike) -> FloatArray:
    """d(φ) (..., 3): straight down turned by the swing about the chord; positive swings to the right seen from A."""
    chord = (far - near) / np.linalg.norm(far - near, axis=-1, keepdims=True)
    down = np.array([0.0, 0.0, -1.0])
    swing = np.asarray(swing_rad, dtype=np.float64)[..., None]
    # right of the chord seen from A: forward x up
    side = np.cross(chord, np.array([0.0, 0.0, 1.0]))
    # Rodrigues about the chord, sense such that "down" turns towards "side"
    along = np.sum(chord * down, axis=-1, keepdims=True) * chord
    return np.asarray(along + np.cos(swing) * (down - along) + np.sin(swing) * side)


def load_shapes(s: FloatArray, count: int) -> FloatArray:
    """What the first ``count`` terms of an uneven load add to the depth below the chord, over D: gₖ(s), (count, N).

    ``gₖ = -2 ∬ Pₖ`` over x = 2s-1 with gₖ(±1) = 0, so that an even load (k = 0) would give 1 at mid-span.
    """
    x = 2 * np.asarray(s, dtype=np.float64) - 1
    legendre = [np.ones_like(x), x]
    for k in range(2, count + 3):
        legendre.append(((2 * k - 1) * x * legendre[-1] - (k - 1) * legendre[-2]) / k)
    shapes = np.empty((count, *x.shape))
    for k in range(1, count + 1):
        below = legendre[k - 2] / ((2 * k - 1) * (2 * k + 1)) if k > 1 else x / 3
        integral = legendre[k + 2] / ((2 * k + 1) * (2 * k + 3)) - 2 * legendre[k] / ((2 * k - 1) * (2 * k + 3)) + below
        shapes[k - 1] = -2 * integral
    return shapes


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
    chord = far - near
    profile = loaded_profile(np.hypot(chord[..., 0], chord[..., 1]), chord[..., 2], sag, t, load)
    direction = gravity_direction(near, far, swing_rad)
    on_chord = near[..., None, :] + t[:, None] * chord[..., None, :]
    return np.asarray(on_chord + profile[..., None] * direction[..., None, :])


def loaded_profile(span: ArrayLike, rise: ArrayLike, sag: ArrayLike, s: FloatArray, load: ArrayLike = ()) -> FloatArray:
    """Depth (..., N) below the chord along apparent gravity: the exact catenary, and what an uneven load adds."""
    profile = sag_profile(span, rise, sag, s)
    terms = np.asarray(load, dtype=np.float64)
    if terms.shape[-1]:
        profile = profile + np.asarray(sag, dtype=np.float64)[..., None] * (terms @ load_shapes(s, terms.shape[-1]))
    return profile


def control_points(
    near: FloatArray, far: FloatArray, sag: ArrayLike, swing_rad: ArrayLike, skew: ArrayLike = 0.5
) -> FloatArray:
    """Bézier control points (..., 3, 3): A, P₁, B with P₁ = A + u(B-A) + 2D·d(φ); u = ½ + c₁/6 for an uneven load."""
    direction = gravity_direction(near, far, swing_rad)
    sag_ = np.asarray(sag, dtype=np.float64)[..., None]
    handle = near + np.asarray(skew, dtype=np.float64)[..., None] * (far - near) + 2 * sag_ * direction
    return np.stack([np.broadcast_to(near, handle.shape), handle, np.broadcast_to(far, handle.shape)], axis=-2)
