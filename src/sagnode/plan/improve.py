r"""What would help most: every source of uncertainty made half as large, one at a time.

The inverse of the posterior is a sum of what survey, landmarks and wire know, ``Σ⁻¹ = P⁻¹ + A + JᵀC⁻¹J``. So a better
survey or better landmarks only change their own term, ``Σ'⁻¹ = Σ⁻¹ + (P'⁻¹ - P⁻¹) + (A' - A)``, which is exact for a
linear estimate: nothing need be measured again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sagnode.estimate.camera import CameraKnowledge, LandmarkObservations, solve_camera
from sagnode.estimate.matched import Matched
from sagnode.estimate.tell import propagate
from sagnode.geometry.camera import FloatArray
from sagnode.plan.foresee import Foreseen, expected_landmarks
from sagnode.site import Site
from sagnode.survey import CAMERA, Survey


@dataclass(frozen=True)
class Gain:
    """What one improvement would do."""

    what: str
    sag_u: float
    """Standard uncertainty of the sag with it, m."""
    clearance_u: float
    sag_share: float
    """By which share the sag's uncertainty shrinks, at most 1."""
    clearance_share: float

    @property
    def best(self) -> float:
        """The greater of both."""
        return max(self.sag_share, self.clearance_share)


def gains(site: Site, foreseen: Foreseen) -> list[Gain]:
    """Every improvement with its effect on one conductor, the most helpful first; none where nothing was found."""
    if foreseen.matched is None:
        return []
    conductor = next(c for c in site.conductors if c.id == foreseen.conductor)
    before = [foreseen.estimates[stem].u for stem in ("sag", "clearance")]
    results = []
    for what, changed, found in _changes(site, foreseen.matched):
        estimates, _ = propagate(changed, conductor, found)
        after = [estimates[stem].u for stem in ("sag", "clearance")]
        results.append(Gain(what, *after, *(1 - a / b for a, b in zip(after, before, strict=True))))
    return sorted(results, key=lambda gain: -gain.best)


def _changes(site: Site, found: Matched) -> Iterator[tuple[str, Site, Matched]]:
    """Every improvement: its name, the site and what was found with it."""
    ground = replace(site.ground, height_u=site.ground.height_u / 2)
    yield "ground heights half as uncertain", replace(site, ground=ground), found
    for what, survey in _better_surveys(found.survey):
        yield f"{what} half as uncertain", site, _knowing(found, survey, found.solution.camera)
    seen = expected_landmarks(site).landmarks
    for what, better in _better_landmarks(seen) if seen is not None else ():
        knowledge = solve_camera(site.conductors[0].survey, better).knowledge
        yield what, site, _knowing(found, found.survey, knowledge)


def _better_surveys(survey: Survey) -> Iterator[tuple[str, Survey]]:
    yield "attachments", replace(survey, attachment_u=survey.attachment_u / 2)
    yield "camera position", replace(survey, position_u=survey.position_u / 2)
    yield "camera orientation", replace(survey, orientation_u=survey.orientation_u / 2)
    yield "what is known of wind (swing prior)", replace(survey, swing_u=survey.swing_u / 2)
    lens = replace(
        survey,
        focal_u_rel=survey.focal_u_rel / 2,
        principal_point_u=survey.principal_point_u / 2,
        distortion_u=survey.distortion_u / 2,
    )
    yield "lens (focal length, principal point, distortion)", lens


def _better_landmarks(seen: LandmarkObservations) -> Iterator[tuple[str, LandmarkObservations]]:
    yield "landmark positions half as uncertain", replace(seen, position_u=seen.position_u / 2)
    yield "landmarks clicked half as uncertain", replace(seen, pixel_u=seen.pixel_u / 2)
    parts = (seen.positions, seen.position_u, seen.pixels, seen.pixel_u)
    twice = LandmarkObservations(*(np.concatenate([part, part]) for part in parts))
    yield f"twice as many landmarks ({seen.count} more like these)", twice


def _knowing(found: Matched, survey: Survey, camera: CameraKnowledge) -> Matched:
    """The same match with another survey, and other knowledge of the camera, behind it."""
    solution, free = found.solution, found.survey.unknowns()
    own = np.ix_(free, free)
    change = np.diag(1 / survey.prior_sigma() ** 2 - 1 / found.survey.prior_sigma() ** 2)
    change[CAMERA, CAMERA] += camera.precision - solution.camera.precision
    covariance = np.zeros_like(solution.covariance)
    covariance[own] = _inverse(_inverse(solution.covariance[own]) + change[own])
    return replace(found, survey=survey, solution=replace(solution, covariance=covariance, camera=camera))


def _inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive matrix whose unknowns have very different units."""
    scale = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale))
