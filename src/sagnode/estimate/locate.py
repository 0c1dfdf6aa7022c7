"""Locating the conductors of a span in one frame: coarse search, sub-pixel refinement, joint estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.estimate.joint import ATTACHMENTS, SAG, SWING, CurveObservations, Solution, Survey, solve
from sagnode.estimate.register import Registered, moved_survey
from sagnode.geometry.camera import FloatArray
from sagnode.match.refine import Observed, Track, observe, shifted_score, trace
from sagnode.match.templates import Candidate, View, search
from sagnode.site import Site, SiteConductor

HALF_RANGES_PX = (8.0, 5.0, 4.0)
"""How far across the curve is looked, from the first refinement to the last."""
CANDIDATES = 4


@dataclass(frozen=True)
class Matched:
    """A conductor found in one frame."""

    survey: Survey
    solution: Solution
    view: View
    track: Track
    observed: Observed
    response: float
    score: float
    support: float
    rival: float = 0.0
    """Merit of the best different curve over the merit of this one; 0 if there is none."""

    @property
    def sag(self) -> tuple[float, float]:
        """In-plane sag and its standard uncertainty, m."""
        return float(self.solution.theta[SAG]), float(np.sqrt(self.solution.covariance[SAG, SAG]))

    @property
    def swing(self) -> tuple[float, float]:
        """Swing and its standard uncertainty, rad."""
        return float(self.solution.theta[SWING]), float(np.sqrt(self.solution.covariance[SWING, SWING]))


def locate(site: Site, image: GreyImage, registered: Registered) -> dict[str, Matched]:
    """Find all conductors of the span, those that are only known about included.

    Every conductor is first found alone; then each is refined once more with the others' curves masked, so that a
    neighbour a few pixels away cannot pull it.
    """
    alone = {c.id: _find(image, c, registered) for c in site.conductors}
    curves = {name: m.track.pixels for name, m in alone.items() if m is not None}
    found: dict[str, Matched] = {}
    for conductor in site.conductors:
        first = alone[conductor.id]
        if first is None:
            continue
        others = [pixels for name, pixels in curves.items() if name != conductor.id]
        final = _refine(image, conductor, registered, first.solution.theta, others, HALF_RANGES_PX[1:])
        if final is not None:
            found[conductor.id] = replace(final, rival=first.rival)
    return found


def _survey(conductor: SiteConductor, registered: Registered) -> Survey:
    movement = registered.movement_px or 0.0
    return moved_survey(conductor.survey, movement)


def _view(survey: Survey, conductor: SiteConductor, theta: FloatArray) -> View:
    intrinsics, pose = survey.camera(theta)
    shape = survey.shape(theta)
    return View(intrinsics, pose, shape.near, shape.far, conductor.width)


def _find(image: GreyImage, conductor: SiteConductor, registered: Registered) -> Matched | None:
    """Coarse search, then the best few candidates refined; the one that lies best on a wire wins."""
    survey = _survey(conductor, registered)
    view = _view(survey, conductor, registered.theta)
    candidates = search(
        image, view, survey.sag_range, conductor.swing_max, survey.swing_u, survey.attachment_u, CANDIDATES
    )
    results: list[Matched] = []
    for candidate in candidates:
        if results and candidate.score < 0.5 * candidates[0].score:
            break
        refined = _refine(image, conductor, registered, _start(registered, candidate), [], HALF_RANGES_PX)
        if refined is not None:
            results.append(refined)
    if not results:
        return None
    results.sort(key=_merit, reverse=True)
    best = results[0]
    others = [r for r in results[1:] if _different(best, r)]
    rival = _merit(others[0]) / max(_merit(best), 1e-9) if others else 0.0
    return replace(best, rival=rival)


def _start(registered: Registered, candidate: Candidate) -> FloatArray:
    theta = registered.theta.copy()
    theta[ATTACHMENTS] = 0.0
    theta[SAG], theta[SWING] = candidate.sag, candidate.swing
    return theta


def _merit(matched: Matched) -> float:
    """How well a candidate explains the picture without contradicting the survey."""
    return matched.support * max(matched.response, 0.0) / (1 + max(0.0, attachment_z(matched) - 3.0))


def _different(a: Matched, b: Matched) -> bool:
    """Whether two solutions are different curves: more than 3 px apart somewhere in the frame."""
    t = np.linspace(a.track.t[0], a.track.t[-1], 64)
    apart = a.view.pixels(float(a.solution.theta[SAG]), float(a.solution.theta[SWING]), t)[0]
    apart = apart - b.view.pixels(float(b.solution.theta[SAG]), float(b.solution.theta[SWING]), t)[0]
    distance = np.hypot(*apart.T)
    return bool(np.nanmax(distance) > 3.0) if np.isfinite(distance).any() else True


def _refine(
    image: GreyImage,
    conductor: SiteConductor,
    registered: Registered,
    theta: FloatArray,
    others: list[FloatArray],
    half_ranges: tuple[float, ...],
) -> Matched | None:
    """Measure across the curve, solve jointly, and again about the new curve, looking ever closer."""
    survey = _survey(conductor, registered)
    solution: Solution | None = None
    observed: Observed | None = None
    for half_range in half_ranges:
        view = _view(survey, conductor, theta)
        curve = trace(view, float(theta[SAG]), float(theta[SWING]))
        if curve is None:
            return None
        observed = observe(image, curve, half_range, others)
        use = observed.usable
        if int(use.sum()) < 4:
            return None
        offsets = CurveObservations(
            t=observed.t[use],
            arc=observed.arc[use],
            normal=observed.normal[use],
            measured=(observed.pixel + observed.offset[:, None] * observed.normal)[use],
            sigma=observed.sigma[use],
        )
        solution = solve(survey, theta, registered.landmarks, offsets)
        theta = solution.theta
    if solution is None or observed is None:
        return None
    view = _view(survey, conductor, theta)
    curve = trace(view, float(theta[SAG]), float(theta[SWING]))
    if curve is None:
        return None
    response, score = shifted_score(image, curve)
    return Matched(survey, solution, view, curve, observed, response, score, support(solution, observed))


def support(solution: Solution, observed: Observed) -> float:
    """Share of the blocks in view, and not masked, in which the wire was seen on the curve."""
    return float(on_curve(solution, observed).sum() / max(int((~observed.masked).sum()), 1))


def on_curve(solution: Solution, observed: Observed) -> NDArray[np.bool_]:
    """Which blocks (M,) show the wire on the solved curve."""
    result = np.zeros(len(observed.t), dtype=bool)
    limit = np.maximum(1.0, 3 * observed.sigma[observed.usable])
    result[observed.usable] = np.abs(solution.residual) < limit
    return result


def visible_share(matched: Matched) -> float:
    """Share of the span's horizontal length over which the wire was seen on the curve."""
    seen = on_curve(matched.solution, matched.observed)
    t = matched.observed.t
    # each block stands for half the way to its neighbours, at most for three times its own length
    extent = np.abs(np.gradient(t)) if len(t) > 1 else np.zeros(len(t))
    return float(np.clip(extent[seen].sum(), 0.0, 1.0))


def attachment_z(matched: Matched) -> float:
    """Largest correction to the surveyed attachments, in units of their standard uncertainty."""
    return float(np.max(np.abs(matched.solution.theta[ATTACHMENTS])) / max(matched.survey.attachment_u, 1e-6))
