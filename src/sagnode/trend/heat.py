"""A sag as the conductor temperature that it stands for, so that spans of any length are judged in kelvin.

A conductor of unstressed length fixed by its temperature hangs longer than its chord by ``8 D² cos⁴ψ / (3 S²)``
(parabola of sag D over a span S whose chord is inclined by ψ), and is stretched by its tension ``H = w S² / (8 D)``.
The state-change equation (CIGRE TB 324) equates the difference of the two with thermal expansion::

    α θ = 8 D² cos⁴ψ / (3 S²) - w S² / (8 D E A)          θ: temperature, but for a constant

Only differences of θ are used, so that the stringing temperature is not needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

WEIGHT_OVER_STIFFNESS = 4.4e-7
"""w / (E A), 1/m, where no stringing data are given: 4.41e-7 for 243-AL1/39-ST1A, 4.4e-7 to 4.9e-7 for aluminium alloy
(EN 50182: unit weight over final modulus times section)."""
EXPANSION_PER_K = 23e-6
"""Aluminium alloy, the most of all common conductors (EN 50182; steel-cored 18e-6 to 20e-6)."""
SECTION_FACTOR = 1.3
"""A span between suspension towers follows its section's tension: one longer than the section's ruling span moves more
per kelvin than it would alone, by the square of the ratio. 1.3 allows for spans 14 % longer than the ruling one."""


@dataclass(frozen=True)
class HeatScale:
    """Turns sags of one conductor into equivalent temperatures and back into metres.

    Attributes:
        span_m: horizontal distance of the attachments.
        rise_m: difference of their heights.
        weight_over_stiffness: w / (E A), 1/m.
        expansion_per_k: coefficient of linear thermal expansion, already widened by :data:`SECTION_FACTOR`.
    """

    span_m: float
    rise_m: float
    weight_over_stiffness: float = WEIGHT_OVER_STIFFNESS
    expansion_per_k: float = EXPANSION_PER_K * SECTION_FACTOR

    def temperature_k(self, sag_m: float) -> float:
        """Equivalent temperature of a sag above zero, K; only differences mean anything."""
        slack = 8 * sag_m**2 * self._cos4 / (3 * self.span_m**2)
        stretch = self.weight_over_stiffness * self.span_m**2 / (8 * sag_m)
        return (slack - stretch) / self.expansion_per_k

    def kelvin_per_m(self, sag_m: float) -> float:
        """Its derivative with respect to sag, K/m."""
        slack = 16 * sag_m * self._cos4 / (3 * self.span_m**2)
        stretch = self.weight_over_stiffness * self.span_m**2 / (8 * sag_m**2)
        return (slack + stretch) / self.expansion_per_k

    def stretch_k(self, sag_m: float) -> float:
        """Elastic stretch at this sag as a temperature, K: what a heavier apparent weight acts on."""
        return self.weight_over_stiffness * self.span_m**2 / (8 * sag_m) / self.expansion_per_k

    @property
    def _cos4(self) -> float:
        return (self.span_m / math.hypot(self.span_m, self.rise_m)) ** 4
