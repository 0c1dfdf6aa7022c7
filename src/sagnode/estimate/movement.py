"""Movement: how the camera has moved since the reference picture, by landmarks alone.

The survey's errors of a landmark's position shift it in the reference picture and in a frame by the same amount.
Compared with each other, two pictures of one camera agree to a fraction of a pixel, where either alone agrees with the
survey to several. That tells a landmark from something like it, and foretells where one is that cannot be found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sagnode.estimate.camera import LandmarkObservations, solve_camera
from sagnode.geometry.camera import FloatArray, project, projection_derivatives
from sagnode.site import Site
from sagnode.survey import CAMERA, Survey

SHIFT_U_M = 0.02
"""Standard uncertainty of the camera's place against that in the reference picture: a tower bends and sways."""
FOCUS_U = 2e-4
"""The same of the focal length, relative: glass and metal at other temperatures."""
CENTRE_U_PX = 0.2
SEEN_U_PX = 0.2
"""Standard uncertainty of a landmark found by the reference's patch in other light."""
ASIDE_PX = 1.0
"""Landmarks farther than this from where one movement of the camera puts them are not themselves."""


@dataclass(frozen=True)
class Anchor:
    """The camera of the reference picture.

    Attributes:
        survey: with that camera, and with how much it may have moved since.
        offset: from where it should see the surveyed landmarks to where they were clicked, px (N, 2).
    """

    survey: Survey
    offset: FloatArray


@dataclass(frozen=True)
class Movement:
    """What a camera that has moved so sees.

    Attributes:
        pixels: where every landmark must be, px (N, 2).
        sigma: standard uncertainty of that along the worse axis, px (N,).
    """

    pixels: FloatArray
    sigma: FloatArray


def anchored(site: Site) -> Anchor:
    """The camera of the reference picture, by the clicks in it."""
    survey = site.conductors[0].survey
    clicks = LandmarkObservations(
        site.landmark_positions, site.landmark_position_u, site.landmark_clicks, site.landmark_click_u
    )
    intrinsics, pose = survey.camera(solve_camera(survey, clicks).theta)
    offset = site.landmark_clicks - project(intrinsics, pose, site.landmark_positions)[0]
    possible = (site.max_movement_px + 8) / intrinsics.fx
    moved = replace(
        survey,
        intrinsics=intrinsics,
        pose=pose,
        orientation_u=possible,
        position_u=SHIFT_U_M,
        focal_u_rel=FOCUS_U,
        principal_point_u=CENTRE_U_PX,
        distortion_u=1e-6,
    )
    return Anchor(moved, offset)


def movement(site: Site, anchor: Anchor, pixels: FloatArray, sigma: FloatArray, seen: NDArray[np.bool_]) -> Movement:
    """The movement that the seen landmarks show.

    Args:
        site: with N landmarks.
        anchor: of the same site.
        pixels: where landmarks are, px (N, 2); looked at where ``seen``.
        sigma: standard uncertainty of that, px (N,).
        seen: which (N,).
    """
    positions = site.landmark_positions
    solution = solve_camera(
        anchor.survey,
        LandmarkObservations(
            positions[seen], np.zeros(int(seen.sum())), pixels[seen] - anchor.offset[seen], sigma[seen]
        ),
    )
    intrinsics, pose = anchor.survey.camera(solution.theta)
    _, by_camera = projection_derivatives(intrinsics, pose, positions)
    prior = np.diag(1 / anchor.survey.prior_sigma()[CAMERA] ** 2)
    covariance = np.linalg.inv(solution.knowledge.precision + prior)
    spread = np.einsum("nik,kl,njl->nij", by_camera, covariance, by_camera)
    worst = np.sqrt(np.linalg.eigvalsh(spread)[:, -1])
    return Movement(project(intrinsics, pose, positions)[0] + anchor.offset, worst)


def agreeing(
    site: Site,
    anchor: Anchor,
    pixels: FloatArray,
    sigma: FloatArray,
    seen: NDArray[np.bool_],
    least: int,
) -> NDArray[np.bool_]:
    """Those that fit one movement, found by leaving out the worst until all do; none where fewer than ``least`` do."""
    seen = seen.copy()
    while int(seen.sum()) >= least:
        told = movement(site, anchor, pixels, sigma, seen)
        aside = np.where(seen, np.hypot(*(pixels - told.pixels).T), 0.0)
        worst = int(np.argmax(aside))
        if aside[worst] <= ASIDE_PX:
            return seen
        seen[worst] = False
    return np.zeros_like(seen)
