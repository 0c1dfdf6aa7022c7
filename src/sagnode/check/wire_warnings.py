"""Stringing data that no line is likely to have: wrong units, mostly. Sag and clearance do not depend on them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sagnode.config.lines import KeyPath
from sagnode.config.span import Conductor, Span
from sagnode.config.wire_data import density_kg_m3, disc_mm2, stress_mpa
from sagnode.geometry.conductor import catenary_half_angle
from sagnode.geometry.quantities import POSSIBLE_TEMPERATURES_C, Stringing, conductor_temperature

Warned = tuple[KeyPath, str]

_DENSITY_KG_M3 = (400.0, 9500.0)
"""A solid wire's, from spun thread to copper; a weight in kilograms makes an aluminium wire lighter than this."""
_LEAST_SECTION = 0.15
"""Of the disc; optical cables have the least metal in them."""
_STRESS_MPA = 1500.0
"""The strongest steel strands are strung at half of it."""
_SAG_FACTOR = 1.5


def wire_warnings(conductor: Conductor) -> Iterator[Warned]:
    """What in a conductor's weight and stringing data gives tensions and temperatures that nobody would believe."""
    density = density_kg_m3(conductor)
    if density is not None and not _DENSITY_KG_M3[0] <= density <= _DENSITY_KG_M3[1]:
        text = (
            f"{conductor.unit_weight_n_m:g} N/m would make a solid wire of diameter_m = {conductor.diameter_m:g} weigh"
            f" {density:.3g} kg/m3; is it newton per metre, of one sub-conductor?"
        )
        yield ("unit_weight_n_m",), text
    stringing = conductor.stringing
    if stringing is None:
        return
    share = stringing.section_mm2 / disc_mm2(conductor)
    if share < _LEAST_SECTION:
        text = f"{stringing.section_mm2:g} mm2 is {100 * share:.2g} % of what diameter_m = {conductor.diameter_m:g} has"
        yield ("stringing", "section_mm2"), f"{text} room for; is it in square millimetres?"
    stress = stress_mpa(conductor)
    if stress is not None and stress > _STRESS_MPA:
        text = f"{stringing.tension_n:g} N on section_mm2 = {stringing.section_mm2:g} is {stress:.3g} MPa; is it newton"
        yield ("stringing", "tension_n"), f"{text}, of one sub-conductor?"
    if conductor.unit_weight_n_m is not None:
        yield from _against_sags(conductor, conductor.unit_weight_n_m)


def _against_sags(conductor: Conductor, unit_weight_n_m: float) -> Iterator[Warned]:
    """Would the wire hang as it was strung, and at some temperature, within the sags that are searched?"""
    data = conductor.stringing
    if data is None:
        return
    along = np.subtract(conductor.far, conductor.near)
    span, rise = float(np.hypot(along[0], along[1])), float(along[2])
    # the parabola will do: it is a few per cent off where sag is a tenth of the span
    strung = unit_weight_n_m * span * float(np.hypot(span, rise)) / (8 * data.tension_n)
    if not conductor.sag_min_m / _SAG_FACTOR <= strung <= conductor.sag_max_m * _SAG_FACTOR:
        text = (
            f"{data.tension_n:g} N would hold {conductor.id} at {strung:.3g} m of sag, and {conductor.sag_min_m:g} to"
            f" {conductor.sag_max_m:g} m are searched; check tension, unit_weight_n_m and their units"
        )
        yield ("stringing", "tension_n"), text
        return
    sags = np.linspace(conductor.sag_min_m, conductor.sag_max_m, 41)
    constants = span / (2 * catenary_half_angle(span, rise, sags))
    stiffness_n = data.modulus_gpa * 1e3 * data.section_mm2
    stringing = Stringing(data.temperature_c, data.tension_n, stiffness_n, data.expansion_per_k)
    with np.errstate(all="ignore"):
        temperatures = conductor_temperature(np.asarray(span), np.asarray(rise), constants, unit_weight_n_m, stringing)
    low, high = POSSIBLE_TEMPERATURES_C
    if not ((temperatures >= low) & (temperatures <= high)).any():
        text = (
            f"the sags that are searched would be those of {temperatures[0]:.3g} to {temperatures[-1]:.3g} degrees, and"
            f" no temperature is told below {low:g} or above {high:g}; check the stringing data"
        )
        yield ("stringing",), text


def obstacle_warnings(span: Span) -> Iterator[Warned]:
    """Obstacles below no conductor count for no clearance."""
    longest = max(float(np.hypot(c.far[0] - c.near[0], c.far[1] - c.near[1])) for c in span.conductors if c.measured)
    for index, obstacle in enumerate(span.ground.obstacles):
        first, last = obstacle.along_m
        if first >= longest or last <= 0:
            text = (
                f"{obstacle.id} lies from {first:g} to {last:g} m, and the span goes from 0 to {longest:.1f}; it counts"
                " for no clearance, and no alarm will be raised for it"
            )
            yield ("ground", "obstacles", index, "along_m"), text
