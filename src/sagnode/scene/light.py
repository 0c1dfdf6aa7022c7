"""How a moment lights and clothes what stands in it: the sun's side and the shaded side, snow, bare trees.

In an ordinary moment, which has neither relief nor snow nor bareness, every tone is exactly the plain one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.scene.optics import sunlight
from sagnode.scene.spec import Moment

AMBIENT = 0.62
"""Light of a face that the sun does not reach, relative to the even light of an overcast noon."""
SNOW_GREY = 212.0


@dataclass(frozen=True)
class Light:
    """Light and season of a moment.

    Attributes:
        sun: share of direct light, 0 to 1.
        towards: unit vector to the sun, site frame (3,).
        relief: how far faces are lit by where they look, 0 (all alike) to 1.
        snow: share of what faces upwards that is white.
        bare: 0 in summer, 1 when the leaves are down.
    """

    sun: float
    towards: FloatArray
    relief: float
    snow: float
    bare: float

    @classmethod
    def of(cls, moment: Moment) -> Light:
        """The light of a moment."""
        azimuth, elevation = math.radians(moment.sun_azimuth_deg), math.radians(moment.sun_elevation_deg)
        level = math.cos(elevation)
        towards = np.array([math.sin(azimuth) * level, math.cos(azimuth) * level, math.sin(elevation)])
        return cls(sunlight(moment), towards, moment.relief, moment.snow, moment.bare)

    def on_face(self, normal: FloatArray, even: float) -> float:
        """Factor of a face's tone, by its outward unit normal; ``even`` is the factor that ordinary moments have."""
        return self._mixed(even, 1.05 * max(0.0, float(normal @ self.towards)))

    def on_bar(self, ends: FloatArray, camera: FloatArray, even: float) -> float:
        """Factor of a bar's tone: galvanised steel shines where the sun meets it from the camera's side."""
        axis = (ends[1] - ends[0]) / max(float(np.linalg.norm(ends[1] - ends[0])), 1e-9)
        view = camera - ends.mean(axis=0)
        normal = view - (view @ axis) * axis
        normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
        return self._mixed(even, 1.6 * max(0.0, float(normal @ self.towards)))

    def _mixed(self, even: float, direct: float) -> float:
        return even * (1 - self.relief) + self.relief * (AMBIENT + self.sun * direct)

    def snowed(self, grey: float, share: float = 1.0) -> float:
        """A tone under snow that covers ``share`` of it in full winter."""
        return grey + self.snow * share * (SNOW_GREY - grey)

    def shadow(self, place: FloatArray) -> float:
        """Factor of the part of a thing at a place (3,) on which a neighbour's shadow lies.

        The neighbours are not modelled: every place has its own, on some side of it.
        """
        lies = math.sin(float(place @ np.array([0.37, 0.71, 1.3])) + 1.5 * self._bearing) > 0
        return 1 - 0.55 * self.relief * self.sun * lies

    def shadow_edge(self, place: FloatArray) -> float:
        """Where across the thing the edge of that shadow stands, -1 to 1; it wanders as the sun does."""
        return math.sin(float(place @ np.array([1.1, 0.43, 0.77])) + 2.6 * self._bearing)

    @property
    def _bearing(self) -> float:
        return math.atan2(self.towards[0], self.towards[1])
