"""From a conductor's shape to the numbers that are reported (design: sags, lowest point, clearance, tension)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.geometry.conductor import catenary_half_angle, conductor_points, sag_profile
from sagnode.geometry.ground import GroundProfile

_T = np.linspace(0.0, 1.0, 801)


@dataclass(frozen=True)
class Shape:
    """One conductor's estimated shape: attachments (3,) in the site frame, in-plane sag m, swing rad, load skew."""

    near: FloatArray
    far: FloatArray
    sag: float
    swing: float = 0.0
    skew: float = 0.5

    def points(self, t: FloatArray = _T) -> FloatArray:
        """Points (N, 3) at curve parameters ``t`` (N,)."""
        return conductor_points(self.near, self.far, self.sag, self.swing, t, self.skew)


@dataclass(frozen=True)
class Stringing:
    """Stringing data in SI: see :class:`sagnode.config.span.Stringing`."""

    temperature_c: float
    tension_n: float
    stiffness_n: float
    """E·S, N."""
    expansion_per_k: float


def _extreme(values: FloatArray, positions: FloatArray) -> tuple[float, float]:
    """Greatest value and its position, by the parabola through the greatest sample and its neighbours."""
    i = int(np.argmax(values))
    if i in (0, len(values) - 1):
        return float(values[i]), float(positions[i])
    x0, x1, x2 = positions[i - 1 : i + 2]
    y0, y1, y2 = values[i - 1 : i + 2]
    # Newton's divided differences; the abscissae are nearly, but not exactly, equidistant
    d01, d12 = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    curvature = (d12 - d01) / (x2 - x0)
    if curvature >= 0:
        return float(y1), float(x1)
    x = (x0 + x1) / 2 - d01 / (2 * curvature)
    x = float(np.clip(x, min(x0, x2), max(x0, x2)))
    return float(y0 + d01 * (x - x0) + curvature * (x - x0) * (x - x1)), x


def clearance(points: FloatArray, along: FloatArray, ground: GroundProfile) -> tuple[float, float]:
    """Least vertical distance to the ground and its obstacles, and the distance from A of its place (m, m)."""
    all_along, gap = _gaps(points, along, ground)
    i = int(np.argmin(gap))
    return float(gap[i]), float(all_along[i])


def clearance_place_u(shape: Shape, ground: GroundProfile) -> float:
    """Standard uncertainty of the place of least clearance that the ground's height errors leave, m.

    Places whose clearance exceeds the least by less than two heights' errors may be the least in truth: the place is
    weighed by how likely each of them is.
    """
    points = shape.points()
    chord = shape.far - shape.near
    along = (points[:, :2] - shape.near[:2]) @ (chord[:2] / np.hypot(chord[0], chord[1]))
    places, gap = _gaps(points, along, ground)
    order = np.argsort(places)
    places, excess = places[order], gap[order] - gap.min()
    weight = np.exp(-0.25 * (excess / max(ground.height_u, 1e-6)) ** 2) * np.gradient(places)
    best = places[int(np.argmin(excess))]
    return float(np.sqrt(np.sum(weight * (places - best) ** 2) / max(float(weight.sum()), 1e-12)))


def _gaps(points: FloatArray, along: FloatArray, ground: GroundProfile) -> tuple[FloatArray, FloatArray]:
    """Places (distance from A) and vertical distances to the ground there, m."""
    # an obstacle's edge may fall between two samples: look just inside each edge too
    edges = np.concatenate([ground.along, ground.obstacles[:, 0], ground.obstacles[:, 1]])
    edges = edges[(edges > along[0]) & (edges < along[-1])]
    all_along = np.concatenate([along, edges])
    heights = np.concatenate([points[:, 2], np.interp(edges, along, points[:, 2])])
    return all_along, np.asarray(heights - ground.top(all_along))


def quantities(shape: Shape, ground: GroundProfile, unit_weight_n_m: float | None = None) -> dict[str, float]:
    """All reported quantities of a shape by stem (:data:`sagnode.message.QUANTITIES`), lengths m, angles degrees."""
    points = shape.points()
    chord = shape.far - shape.near
    span = float(np.hypot(chord[0], chord[1]))
    heading = chord[:2] / span
    offset = points[:, :2] - shape.near[:2]
    along = offset @ heading
    across = offset @ np.array([heading[1], -heading[0]])
    below_chord = shape.near[2] + chord[2] * along / span - points[:, 2]
    sag, _ = _extreme(below_chord, along)
    lowest, lowest_along = _extreme(-points[:, 2], along)
    lowest_height = -lowest
    blowout, _ = _extreme(np.abs(across), along)
    inplane, _ = _extreme(sag_profile(span, chord[2], shape.sag, _T), _T)
    gap, gap_along = clearance(points, along, ground)
    middle = span / 2
    midspan_height = float(np.interp(middle, along, points[:, 2]))
    constant = span / (2 * float(catenary_half_angle(span, chord[2], shape.sag)))
    result = {
        "sag": sag,
        "inplane_sag": inplane,
        "swing": float(np.degrees(shape.swing)),
        "blowout": blowout,
        "lowest_height": lowest_height,
        "lowest_along": lowest_along,
        "drop": float(max(shape.near[2], shape.far[2])) - lowest_height,
        "clearance": gap,
        "clearance_along": gap_along,
        "midspan_sag": float(np.interp(middle, along, below_chord)),
        "midspan_clearance": midspan_height - float(ground.top(np.array([middle]))[0]),
        "catenary_constant": constant,
    }
    if unit_weight_n_m is not None:
        # the swung conductor hangs in apparent gravity w/cos(swing)
        result["tension"] = constant * unit_weight_n_m / float(np.cos(shape.swing))
    return result


def catenary_length_and_tension(span: float, rise: float, constant: float, unit_weight: float) -> tuple[float, float]:
    """Length (m) and mean tension (N) of y = a cosh(x/a) between supports ``span`` apart and ``rise`` high."""
    q = span / (2 * constant)
    m = float(np.arcsinh(rise / (2 * constant * np.sinh(q))))
    x0, x1 = m - q, m + q
    length = constant * (np.sinh(x1) - np.sinh(x0))
    # mean of w·y over the arc: w a ∫ cosh² dx / length
    integral = constant**2 * ((x1 - x0) / 2 + (np.sinh(2 * x1) - np.sinh(2 * x0)) / 4)
    return float(length), float(unit_weight * integral / length)


def conductor_temperature(span: float, rise: float, constant: float, unit_weight: float, stringing: Stringing) -> float:
    """Conductor temperature (°C) at which the unloaded catenary has this constant: the state-change equation.

    The unstressed length grows by thermal expansion, the stressed one by mean tension over E·S (see CIGRE TB 324).
    """
    length, tension = catenary_length_and_tension(span, rise, constant, unit_weight)
    length0, tension0 = catenary_length_and_tension(span, rise, stringing.tension_n / unit_weight, unit_weight)
    stretch = (1 + tension / stringing.stiffness_n) / (1 + tension0 / stringing.stiffness_n)
    return stringing.temperature_c + (length / length0 / stretch - 1) / stringing.expansion_per_k
