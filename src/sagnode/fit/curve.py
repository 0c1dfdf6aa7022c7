"""The curve of an uncalibrated fit: a rational quadratic Bézier in the picture, and a slow departure from it.

A parabola in space seen by a pinhole camera is exactly ``c(t) = Σ Bᵢ(t) wᵢ pᵢ / Σ Bᵢ(t) wᵢ`` with the middle weight
w = w₁ (the outer two may be set to 1). What a lens, a splice or an insulator adds is a slow offset along the normal,
here a sum of Legendre polynomials of orders 3 and up of the position along the curve, since lower orders are the
Bézier's own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.match.ribbon import arc_length

LEAST_WEIGHT, GREATEST_WEIGHT = 0.6, 3.5
"""Bounds of the middle weight. Depths z₀, z₂ of the ends give (z₀+z₂)/(2√(z₀z₂)): 3.5 is a ratio of 47."""
FIRST_ORDER = 3
_DENSE = 257


@dataclass(frozen=True)
class Curve:
    """A rational quadratic Bézier with a slow normal departure.

    Attributes:
        control: control points (3, 2), px.
        weight: of the middle control point.
        departure: coefficients (K,) of Legendre orders 3, 4, ... of the arc fraction mapped to [-1, 1], px.
    """

    control: FloatArray
    weight: float
    departure: FloatArray = field(default_factory=lambda: np.empty(0))

    def conic(self, t: FloatArray) -> FloatArray:
        """Pixels (N, 2) of the Bézier alone at parameters t (N,)."""
        return np.asarray(shares(t, self.weight) @ self.control)

    def evenly(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Parameters (count,) and pixels (count, 2), ends included, at equal distances along the Bézier.

        The pixels include the departure, which is so slow that they stay equally spaced.
        """
        t = even_parameters(self, count)
        pixels = self.conic(t)
        if len(self.departure):
            tangent = np.gradient(pixels, axis=0)
            tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
            normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
            bend = legendre(np.linspace(0, 1, count), len(self.departure)) @ self.departure
            pixels = pixels + bend[:, None] * normal
        return t, pixels

    def length(self) -> float:
        """Length along the Bézier, px."""
        return float(arc_length(self.conic(np.linspace(0, 1, _DENSE)))[-1])

    def moved(self, origin: FloatArray, scale: float = 1.0) -> Curve:
        """The curve in a frame where pixels are ``(pixel - origin)·scale``."""
        return replace(self, control=(self.control - origin) * scale, departure=self.departure * scale)


def shares(t: FloatArray, weight: float) -> FloatArray:
    """Shares (..., 3) of the three control points at t (...): they sum to one."""
    basis = np.stack([(1 - t) ** 2, 2 * weight * t * (1 - t), t * t], axis=-1)
    return np.asarray(basis / basis.sum(axis=-1, keepdims=True))


def even_parameters(curve: Curve, count: int) -> FloatArray:
    """Parameters (count,) at equal distances along the Bézier."""
    t = np.linspace(0, 1, _DENSE)
    arc = arc_length(curve.conic(t))
    return np.interp(np.linspace(0, arc[-1], count), arc, t)


def legendre(fraction: FloatArray, count: int) -> FloatArray:
    """Legendre polynomials (N, count) of orders 3, 4, ... at arc fractions (N,)."""
    everything = np.polynomial.legendre.legvander(2 * fraction - 1, FIRST_ORDER + count - 1)
    return np.asarray(everything[:, FIRST_ORDER:])


def apart(one: Curve, other: Curve) -> float:
    """Root mean square distance of two curves between the same points, px."""
    difference = one.evenly(17)[1] - other.evenly(17)[1]
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


@dataclass(frozen=True)
class Prior:
    """What is known of the curve before the picture is looked at.

    Attributes:
        anchors: the two points that were given (2, 2), px.
        slack: their standard uncertainty, px.
        weight_spread: standard deviation of the logarithm of the middle weight about 0.1 (a little above 1, since
            (z₀+z₂)/2 is never less than √(z₀z₂)).
        bend: standard deviation of the lowest order of departure; higher orders fall as 1/order.
    """

    anchors: FloatArray
    slack: float
    weight_spread: float = 0.2
    bend: float = 0.0


def adjust(
    curve: Curve,
    fraction: FloatArray,
    offset: FloatArray,
    precision: FloatArray,
    prior: Prior,
    orders: int = 0,
) -> tuple[Curve, FloatArray]:
    """One damped Gauss-Newton step of the curve towards measured normal offsets.

    Args:
        curve: where the offsets were measured from.
        fraction: arc fractions (M,) of the measurements.
        offset: of the wire along the normal (M,), px.
        precision: inverse variances (M,), 0 for measurements to leave out.
        prior: see :class:`Prior`.
        orders: how many orders of departure to allow.

    Returns:
        The new curve, and the predicted shift (M,) along the normal at the measurements.
    """
    t = np.interp(fraction, np.linspace(0, 1, _DENSE), even_parameters(curve, _DENSE))
    share = shares(t, curve.weight)
    pixels = share @ curve.control
    step = 1e-4
    tangent = curve.conic(np.minimum(t + step, 1)) - curve.conic(np.maximum(t - step, 0))
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    chord = curve.control[2] - curve.control[0]
    length = float(np.linalg.norm(chord))
    along = chord / max(length, 1e-9)
    across = np.array([-along[1], along[0]])
    columns = [
        share[:, 0] * (normal @ across),
        share[:, 2] * (normal @ across),
        share[:, 1] * (normal @ along),
        share[:, 1] * (normal @ across),
        share[:, 1] * np.einsum("mi,mi->m", curve.control[1] - pixels, normal),
    ]
    jacobian = np.column_stack([*columns, legendre(fraction, orders)])
    was = np.zeros(orders)
    kept = min(orders, len(curve.departure))
    was[:kept] = curve.departure[:kept]
    # the measurements were made from the curve with its departure; what is beyond the orders allowed comes back
    lost = legendre(fraction, len(curve.departure))[:, kept:] @ curve.departure[kept:] if len(curve.departure) else 0.0
    wanted = offset + lost
    expected, spread = _prior_terms(curve, prior, across, length, orders)
    expected[5:] -= was
    weight = precision[:, None]
    normal_matrix = jacobian.T @ (weight * jacobian) + np.diag(1 / spread**2)
    right = jacobian.T @ (precision * wanted) + expected / spread**2
    change = np.linalg.solve(normal_matrix, right)
    change[:5] *= min(1.0, 0.5 * length / (1e-9 + float(np.abs(change[2:4]).max())))
    log_weight = np.clip(np.log(curve.weight) + change[4], np.log(LEAST_WEIGHT), np.log(GREATEST_WEIGHT))
    control = curve.control.copy()
    control[0] += change[0] * across
    control[2] += change[1] * across
    control[1] += change[2] * along + change[3] * across
    return Curve(control, float(np.exp(log_weight)), was + change[5:]), jacobian @ change - lost


def _prior_terms(
    curve: Curve, prior: Prior, across: FloatArray, length: float, orders: int
) -> tuple[FloatArray, FloatArray]:
    """Expected change and its standard deviation for each parameter of :func:`adjust`."""
    start, end = ((prior.anchors[i] - curve.control[2 * i]) @ across for i in (0, 1))
    middle = 0.5 * (curve.control[0] + curve.control[2])
    chord = curve.control[2] - curve.control[0]
    along = float((middle - curve.control[1]) @ chord) / max(length, 1e-9)
    expected = np.array([start, end, along, 0.0, 0.1 - np.log(curve.weight), *np.zeros(orders)])
    spread = np.array([prior.slack, prior.slack, 0.6 * length, 10 * length, prior.weight_spread])
    bends = prior.bend * FIRST_ORDER / np.arange(FIRST_ORDER, FIRST_ORDER + orders) if orders else np.empty(0)
    return expected, np.concatenate([spread, np.maximum(bends, 1e-6)])
