"""Registration: where the camera is in this frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.camera import NOTHING_KNOWN, CameraKnowledge, CameraSolution, LandmarkObservations, solve_camera
from sagnode.estimate.movement import SEEN_U_PX, agreeing, anchored
from sagnode.estimate.recognise import recognise
from sagnode.geometry.camera import FloatArray
from sagnode.match.appearances import Appearances
from sagnode.match.landmarks import Tracked, track
from sagnode.quality import Cause, Reason
from sagnode.site import Site
from sagnode.survey import Survey

MIN_LANDMARKS = 3
"""Fewer cannot tell a moved camera from a mistaken landmark."""
MIN_SHARE = 0.4
"""Least share of the landmarks that must agree: a few patches find company by chance in a picture of something else."""
RESIDUAL_MAX = 3.5
"""Residuals beyond this many of their own standard uncertainties fit no place of the camera."""
UNWATCHED_PX = 3.0
"""Standard uncertainty of where a camera looks whose movement since the survey cannot be seen."""


@dataclass(frozen=True)
class Registered:
    """The camera in one frame, as the landmarks show it."""

    theta: FloatArray
    camera: CameraKnowledge
    """What the landmarks say, for the conductors' estimates."""
    landmarks: LandmarkObservations | None
    tracked: Tracked | None
    residual_px: float | None
    movement_px: float | None

    @property
    def by_appearance(self) -> tuple[datetime, ...]:
        """Of each landmark found by a kept appearance: when that was cut."""
        return () if self.tracked is None else tuple(self.tracked.cut_at.values())


def register(site: Site, image: GreyImage, kept: Appearances = ()) -> tuple[Registered, list[Reason]]:
    """Where the camera is in this frame: landmarks found in it, with the surveyed pose as the prior.

    Args:
        site: what is known beforehand.
        image: the frame (height, width) uint8.
        kept: appearances of the landmarks beside those of the reference picture, if any are kept.
    """
    survey = site.conductors[0].survey
    start = survey.prior_mean()
    if not len(site.landmark_ids):
        return Registered(start, NOTHING_KNOWN, None, None, None, None), []
    if site.patches is None:
        # no reference picture: the clicks say where the camera looked when it was surveyed, not where it looks now;
        # what it may have swayed since is common to all of them, so that their number must not make it smaller
        sway = UNWATCHED_PX * np.sqrt(len(site.landmark_ids))
        seen = LandmarkObservations(
            site.landmark_positions,
            site.landmark_position_u,
            site.landmark_clicks,
            np.hypot(site.landmark_click_u, sway),
        )
        solution = solve_camera(survey, seen)
        return Registered(solution.theta, solution.knowledge, seen, None, _landmark_rms(solution), None), []
    alike = track(image, list(site.patches), site.max_movement_px + 8, site.intrinsics)
    possible = int(alike.visible.sum())
    needed = min(max(MIN_LANDMARKS, math.ceil(MIN_SHARE * possible)), max(1, possible))
    tracked = _moved_alike(site, alike, needed)
    if kept:
        tracked = recognise(site, image, tracked, kept, needed)
    if tracked.count < needed:
        text = (
            f"{tracked.count} of {possible} landmarks recognised (needs {needed}): fog, night, a covered lens"
            " or a camera that looks elsewhere"
        )
        if alike.count >= needed:
            text = (
                f"{alike.count} of {possible} landmarks look like themselves, but no turn of the camera puts {needed}"
                " of them there: it looks elsewhere, was taken to another place, or the landmarks themselves have moved"
            )
        return Registered(start, NOTHING_KNOWN, None, tracked, None, None), [Reason(Cause.LANDMARKS_LOST, text)]
    keep = tracked.found
    shift = np.median(tracked.pixels[keep] - site.landmark_clicks[keep], axis=0)
    movement = float(np.hypot(*shift))
    seen = LandmarkObservations(
        site.landmark_positions[keep],
        site.landmark_position_u[keep],
        tracked.pixels[keep],
        np.hypot(site.landmark_click_u[keep], tracked.sigma[keep]),
    )
    moved = moved_survey(survey, movement)
    solution = solve_camera(moved, seen)
    residual = _landmark_rms(solution)
    registered = Registered(solution.theta, solution.knowledge, seen, tracked, residual, movement)
    if movement > site.max_movement_px:
        text = f"the landmarks have moved by {movement:.0f} px (limit {site.max_movement_px:g}); survey the camera anew"
        return registered, [Reason(Cause.CAMERA_MOVED, text)]
    if solution.z > RESIDUAL_MAX:
        text = (
            f"the landmarks fit no place of the camera: residual {residual:.1f} px,"
            f" {solution.z:.1f} times what survey and clicks allow; check both"
        )
        return registered, [Reason(Cause.BAD_CALIBRATION, text)]
    return registered, []


def _moved_alike(site: Site, tracked: Tracked, needed: int) -> Tracked:
    """The landmarks that one movement of the camera puts where they were found.

    The agreement by which they were chosen is wider than they can be found; several that
    lie near each other may all be a few pixels aside, and would turn the camera.
    """
    if tracked.count < needed:
        return tracked
    sigma = np.where(tracked.found, np.maximum(tracked.sigma, SEEN_U_PX), SEEN_U_PX)
    alike = agreeing(site, anchored(site), tracked.pixels, sigma, tracked.found, needed)
    return replace(
        tracked,
        pixels=np.where(alike[:, None], tracked.pixels, np.nan),
        sigma=np.where(alike, tracked.sigma, np.nan),
        found=alike,
    )


def moved_survey(survey: Survey, movement_px: float) -> Survey:
    """The survey with an orientation prior wide enough for the movement that the landmarks have shown."""
    sway = movement_px / survey.intrinsics.fx
    return replace(survey, orientation_u=float(np.hypot(survey.orientation_u, sway)))


def _landmark_rms(solution: CameraSolution) -> float:
    weight = solution.weight
    squared = np.sum(solution.residual**2, axis=1) / 2
    return float(np.sqrt(np.sum(weight * squared) / max(float(weight.sum()), 1e-9)))
