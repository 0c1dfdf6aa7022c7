"""The camera that is planned with, and the site as the node would know it with that camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sagnode.config.span import Landmark, Span
from sagnode.geometry.camera import Intrinsics, inside, project
from sagnode.site import Site, load_site


@dataclass(frozen=True)
class PlannedCamera:
    """A camera, its lens, its place and its direction."""

    intrinsics: Intrinsics
    position: tuple[float, float, float]
    """Centre of projection in the site frame, m."""
    azimuth_deg: float
    elevation_deg: float
    roll_deg: float = 0.0
    focal_mm: float | None = None
    """As the lens is sold; None for the calibrated one."""
    turned_from: tuple[float, float] | None = None
    """Azimuth and elevation that were surveyed, degrees, where another direction is planned with, which shows more."""

    @property
    def field_deg(self) -> tuple[float, float]:
        """Width and height of the field of view through a perfect lens, degrees."""
        lens = self.intrinsics
        half = np.arctan([lens.width / 2 / lens.fx, lens.height / 2 / lens.fy])
        width, height = np.degrees(2 * half)
        return float(width), float(height)


def placed(span: Span, camera: PlannedCamera) -> Span:
    """The survey with that camera in its place, and no picture of it yet."""
    survey = span.camera.model_copy(
        update={
            "position": camera.position,
            "azimuth_deg": camera.azimuth_deg,
            "elevation_deg": camera.elevation_deg,
            "roll_deg": camera.roll_deg,
            "reference_image": None,
        }
    )
    return span.model_copy(update={"camera": survey})


def planned_site(span: Span, camera: PlannedCamera) -> Site:
    """The site with that camera, as if its reference picture were taken and every landmark in view clicked in it.

    Landmarks that would not lie in the picture with their whole patch are left out, for nobody could click them.
    """
    site = load_site(placed(span, camera).model_copy(update={"landmarks": ()}), lens=camera.intrinsics)
    marks = [(mark, pixel) for mark in span.landmarks if (pixel := _seen_at(site, mark)) is not None]
    return replace(
        site,
        landmark_ids=tuple(mark.id for mark, _ in marks),
        landmark_positions=np.array([mark.position for mark, _ in marks], dtype=float).reshape(-1, 3),
        landmark_position_u=np.array([mark.position_u_m for mark, _ in marks], dtype=float),
        landmark_clicks=np.array([pixel for _, pixel in marks], dtype=float).reshape(-1, 2),
        landmark_click_u=np.array([mark.pixel_u_px for mark, _ in marks], dtype=float),
        # there will be a reference picture; what its patches hold nobody knows
        patches=(None,) * len(marks),
    )


def _seen_at(site: Site, mark: Landmark) -> tuple[float, float] | None:
    """Where a landmark would be clicked; None where its patch would not lie in the picture."""
    pixel, _ = project(site.intrinsics, site.pose, np.array(mark.position, dtype=float))
    if not inside(site.intrinsics, pixel, mark.size_px // 2 + 1):
        return None
    return float(pixel[0]), float(pixel[1])
