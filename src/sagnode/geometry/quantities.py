"""From a conductor's shape to the numbers that are reported (design: sags, lowest point, clearance, tension)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sagnode.geometry.camera import FloatArray
from sagnode.geometry.conductor import catenary_half_angle, conductor_points, loaded_profile
from sagnode.geometry.ground import GroundProfile
from sagnode.native import kernels

_T = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Shape:
    """A conductor's shape: attachments (3,) in the site frame, in-plane sag m, swing rad, terms of an uneven load (K,).

    Several shapes at once have one leading axis (S,) more in every field.
    """

    near: FloatArray
    far: FloatArray
    sag: ArrayLike
    swing: ArrayLike = 0.0
    load: ArrayLike = ()

    def points(self, t: FloatArray = _T) -> FloatArray:
        """Points (..., N, 3) at curve parameters ``t`` (N,)."""
        return conductor_points(self.near, self.far, self.sag, self.swing, t, self.load)


POSSIBLE_TEMPERATURES_C = (-60.0, 300.0)
"""Of a conductor on a line, in any climate and under any current; stringing data that give others are wrong."""


@dataclass(frozen=True)
class Stringing:
    """Stringing data in SI: see :class:`sagnode.config.span.Stringing`."""

    temperature_c: float
    tension_n: float
    stiffness_n: float
    """E·S, N."""
    expansion_per_k: float


def _extreme(values: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Greatest value and its position (S,) of rows (S, N), by the parabola through the greatest and its neighbours."""
    rows = np.arange(len(values))
    positions = np.broadcast_to(positions, values.shape)
    last = values.shape[1] - 1
    i = np.argmax(values, axis=1)
    inner = np.clip(i, 1, last - 1)
    x0, x1, x2 = (positions[rows, inner + k] for k in (-1, 0, 1))
    y0, y1, y2 = (values[rows, inner + k] for k in (-1, 0, 1))
    # Newton's divided differences; the abscissae are nearly, but not exactly, equidistant
    d01, d12 = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    curvature = (d12 - d01) / (x2 - x0)
    bent = (curvature < 0) & (i == inner)
    safe = np.where(bent, curvature, -1.0)
    x = np.where(bent, (x0 + x1) / 2 - d01 / (2 * safe), positions[rows, i])
    x = np.where(bent, np.clip(x, np.minimum(x0, x2), np.maximum(x0, x2)), x)
    y = np.where(bent, y0 + d01 * (x - x0) + curvature * (x - x0) * (x - x1), values[rows, i])
    return y, x


def clearance_place_u(shape: Shape, ground: GroundProfile) -> float:
    """Standard uncertainty of the place of least clearance that the ground's height errors leave, m.

    Places whose clearance exceeds the least by less than two heights' errors may be the least in truth: the place is
    weighed by how likely each of them is.
    """
    if kernels is not None:
        return float(kernels.clearance_place_u(*_words(_many(shape), ground), ground.height_u))
    points, along = _layout(_many(shape))
    places, gap = (part[0] for part in _gaps(points, along, ground))
    order = np.argsort(places)
    places, excess = places[order], gap[order] - gap.min()
    weight = np.exp(-0.25 * (excess / max(ground.height_u, 1e-6)) ** 2) * np.gradient(places)
    best = places[int(np.argmin(excess))]
    return float(np.sqrt(np.sum(weight * (places - best) ** 2) / max(float(weight.sum()), 1e-12)))


def _many(shape: Shape) -> Shape:
    """The shapes with one leading axis."""
    near, far = np.atleast_2d(shape.near), np.atleast_2d(shape.far)
    sag, swing = (np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (shape.sag, shape.swing))
    return Shape(near, far, sag, swing, np.atleast_2d(np.asarray(shape.load, dtype=np.float64)))


def _words(many: Shape, ground: GroundProfile) -> tuple[FloatArray, ...]:
    """Shapes and ground, as compiled functions take them."""
    parts = (many.near, many.far, many.sag, many.swing, many.load, _T, ground.along, ground.height, ground.obstacles)
    return tuple(np.ascontiguousarray(part, dtype=np.float64) for part in parts)


def _layout(many: Shape) -> tuple[FloatArray, FloatArray]:
    """Points of the shapes (S, N, 3) and the points' horizontal distances from A (S, N)."""
    points = many.points()
    return points, np.asarray(np.einsum("snk,sk->sn", points[..., :2] - many.near[:, None, :2], _heading(many)))


def _heading(many: Shape) -> FloatArray:
    """Horizontal directions (S, 2) from A to B."""
    chord = (many.far - many.near)[:, :2]
    return np.asarray(chord / np.hypot(chord[:, 0], chord[:, 1])[:, None])


def _gaps(points: FloatArray, along: FloatArray, ground: GroundProfile) -> tuple[FloatArray, FloatArray]:
    """Places (distance from A) and vertical distances to the ground there (S, M), m."""
    # an obstacle's edge may fall between two samples: look just inside each edge too
    edges = np.concatenate([ground.along, ground.obstacles[:, 0], ground.obstacles[:, 1]])
    edges = edges[(edges > along[:, 0].max()) & (edges < along[:, -1].min())]
    between = [np.interp(edges, place, height) for place, height in zip(along, points[..., 2], strict=True)]
    places = np.concatenate([along, np.broadcast_to(edges, (len(along), len(edges)))], axis=1)
    heights = np.concatenate([points[..., 2], np.array(between)], axis=1)
    return places, np.asarray(heights - ground.top(places))


def quantities(shape: Shape, ground: GroundProfile, unit_weight_n_m: float | None = None) -> dict[str, float]:
    """All reported quantities of a shape by stem (:data:`sagnode.message.QUANTITIES`), lengths m, angles degrees."""
    return {stem: float(value[0]) for stem, value in quantities_of_many(shape, ground, unit_weight_n_m).items()}


def quantities_of_many(
    shape: Shape, ground: GroundProfile, unit_weight_n_m: float | None = None
) -> dict[str, FloatArray]:
    """:func:`quantities` of several shapes at once, arrays (S,)."""
    many = _many(shape)
    swings = np.asarray(many.swing)
    found = _along_the_curves(many, ground)
    sag, inplane_sag, blowout, lowest, lowest_along, clearance, clearance_along, midspan, above, constant = found
    result = {
        "sag": sag,
        "inplane_sag": inplane_sag,
        "swing": np.degrees(swings),
        "blowout": blowout,
        "lowest_height": lowest,
        "lowest_along": lowest_along,
        "drop": np.maximum(many.near[:, 2], many.far[:, 2]) - lowest,
        "clearance": clearance,
        "clearance_along": clearance_along,
        "midspan_sag": 0.5 * (many.near[:, 2] + many.far[:, 2]) - midspan,
        "midspan_clearance": above,
        "catenary_constant": constant,
    }
    if np.asarray(many.load).shape[-1]:
        # H over which weight? an uneven load has no one weight per metre
        del result["catenary_constant"]
        result["load_skew"] = np.asarray(many.load)[:, 0]
    elif unit_weight_n_m is not None:
        # the swung conductor hangs in apparent gravity w/cos(swing)
        result["tension"] = constant * unit_weight_n_m / np.cos(swings)
    return result


def _along_the_curves(many: Shape, ground: GroundProfile) -> tuple[FloatArray, ...]:
    """What is looked for along the curves (S,), m.

    Sag, in-plane sag, blow-out, least height and its place, least clearance and its place, height at mid-span and
    clearance there, constant of the catenary.
    """
    if kernels is not None:
        result = np.empty((10, len(many.near)))
        kernels.quantities(*_words(many, ground), result)
        return tuple(result)
    points, along = _layout(many)
    sags = np.asarray(many.sag)
    chord = many.far - many.near
    span = np.hypot(chord[:, 0], chord[:, 1])
    heading = _heading(many)
    offset = points[..., :2] - many.near[:, None, :2]
    across = offset[..., 0] * heading[:, None, 1] - offset[..., 1] * heading[:, None, 0]
    below_chord = many.near[:, None, 2] + (chord[:, 2] / span)[:, None] * along - points[..., 2]
    lowest, lowest_along = _extreme(-points[..., 2], along)
    places, gap = _gaps(points, along, ground)
    rows, least = np.arange(len(gap)), np.argmin(gap, axis=1)
    middle = span / 2
    at_middle = [np.interp(m, a, z) for m, a, z in zip(middle, along, points[..., 2], strict=True)]
    midspan_height = np.array(at_middle)
    return (
        _extreme(below_chord, along)[0],
        _extreme(loaded_profile(span, chord[:, 2], sags, _T, many.load), _T)[0],
        _extreme(np.abs(across), along)[0],
        -lowest,
        lowest_along,
        gap[rows, least],
        places[rows, least],
        midspan_height,
        midspan_height - ground.top(middle),
        span / (2 * catenary_half_angle(span, chord[:, 2], sags)),
    )


def catenary_length_and_tension(
    span: FloatArray, rise: FloatArray, constant: FloatArray, unit_weight: float
) -> tuple[FloatArray, FloatArray]:
    """Length (m) and mean tension (N) of y = a cosh(x/a) between supports ``span`` apart and ``rise`` high."""
    q = span / (2 * constant)
    m = np.arcsinh(rise / (2 * constant * np.sinh(q)))
    x0, x1 = m - q, m + q
    length = constant * (np.sinh(x1) - np.sinh(x0))
    # mean of w·y over the arc: w a ∫ cosh² dx / length
    integral = constant**2 * ((x1 - x0) / 2 + (np.sinh(2 * x1) - np.sinh(2 * x0)) / 4)
    return length, unit_weight * integral / length


def conductor_temperature(
    span: FloatArray, rise: FloatArray, constant: FloatArray, unit_weight: float, stringing: Stringing
) -> FloatArray:
    """Conductor temperature (°C) at which the unloaded catenary has this constant: the state-change equation.

    The unstressed length grows by thermal expansion, the stressed one by mean tension over E·S (see CIGRE TB 324).
    """
    length, tension = catenary_length_and_tension(span, rise, constant, unit_weight)
    strung = np.full_like(constant, stringing.tension_n / unit_weight)
    length0, tension0 = catenary_length_and_tension(span, rise, strung, unit_weight)
    stretch = (1 + tension / stringing.stiffness_n) / (1 + tension0 / stringing.stiffness_n)
    return np.asarray(stringing.temperature_c + (length / length0 / stretch - 1) / stringing.expansion_per_k)
