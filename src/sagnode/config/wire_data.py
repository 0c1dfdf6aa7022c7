"""What a wire's weight, section and tension say about each other: no matter is heavier, and none stronger, than this.

Limits of matter and not of practice, so that every conductor, earth wire, optical cable and laboratory thread passes
and a wrong unit does not; what is merely odd is for ``sagnode config check`` (:mod:`sagnode.check.wire_warnings`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sagnode.config.span import Conductor

GRAVITY = 9.81
HEAVIEST_KG_M3 = 25_000.0
"""Osmium has 22 590."""
STRONGEST_MPA = 20_000.0
"""The strongest fibres bear a third of it."""
_ROUNDED = 1.1
"""Diameters of data sheets are rounded."""


def density_kg_m3(conductor: Conductor) -> float | None:
    """Of a solid round wire of this diameter and weight; a stranded one's metal is denser by a third."""
    if conductor.unit_weight_n_m is None:
        return None
    return conductor.unit_weight_n_m / (GRAVITY * disc_mm2(conductor) * 1e-6)


def disc_mm2(conductor: Conductor) -> float:
    """Section of a solid round wire of this diameter."""
    return math.pi / 4 * (1e3 * conductor.diameter_m) ** 2


def stress_mpa(conductor: Conductor) -> float | None:
    """Tension over section, as strung."""
    return conductor.stringing.tension_n / conductor.stringing.section_mm2 if conductor.stringing else None


def contradictions(conductor: Conductor) -> Iterator[str]:
    """Sentences about what no wire can be."""
    density, stress = density_kg_m3(conductor), stress_mpa(conductor)
    if density is not None and density > HEAVIEST_KG_M3:
        yield (
            f"unit_weight_n_m = {conductor.unit_weight_n_m:g} with diameter_m = {conductor.diameter_m:g} would be"
            f" {density:.3g} kg/m3, denser than any matter; give newton per metre and metres"
        )
    if conductor.stringing is None or stress is None:
        return
    if conductor.stringing.section_mm2 > _ROUNDED * disc_mm2(conductor):
        yield (
            f"stringing.section_mm2 = {conductor.stringing.section_mm2:g} is more than a solid wire of diameter_m ="
            f" {conductor.diameter_m:g} has ({disc_mm2(conductor):.4g} mm2)"
        )
    if stress > STRONGEST_MPA:
        yield (
            f"stringing.tension_n = {conductor.stringing.tension_n:g} on section_mm2 ="
            f" {conductor.stringing.section_mm2:g} would be {stress:.3g} MPa, which no matter bears; give newton and"
            " square millimetres"
        )
