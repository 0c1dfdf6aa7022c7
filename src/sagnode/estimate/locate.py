"""Locating the conductors of a span in one frame: coarse search, sub-pixel refinement, joint estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.estimate.joint import CurveObservations, Solution, log_odds, solve, unevenness
from sagnode.estimate.register import Registered, moved_survey
from sagnode.geometry.camera import FloatArray
from sagnode.geometry.conductor import gravity_direction
from sagnode.match.bundle import lines
from sagnode.match.refine import (
    Observed,
    Sighting,
    Track,
    mixed_samples,
    near_another,
    observe,
    runs_near,
    sight,
    trace,
)
from sagnode.match.ribbon import line_response, normals
from sagnode.match.search import Candidate, search
from sagnode.match.templates import SAMPLES, STEP_PX, View
from sagnode.site import Site, SiteConductor
from sagnode.survey import ATTACHMENTS, LOAD, SAG, SWING, Survey


@dataclass(frozen=True)
class Stage:
    """One refinement: how far across the curve to look, how long blocks are, and which blocks count."""

    half_range_px: float
    block_px: float
    shifts: int
    """Shifted curves that a block is ranked against."""
    run: int
    """Least number of blocks in a row: long runs are the clear part of a wire, chance does not make them."""
    iterations: int
    """Most steps of the joint estimate."""


STAGES = (Stage(8.0, 8.0, 2, 6, 5), Stage(5.0, 8.0, 4, 1, 6), Stage(3.0, 20.0, 8, 1, 12))
"""From the first refinement to the last, which knows the curve to a pixel and follows the wire where it is faint."""
MAX_BLOCKS = 80
"""More blocks say nothing new: neighbours within a few dozen pixels share their error."""
CANDIDATES = 4
VALLEY_NODES = 9
"""Curves along the valley that are projected; the others between them are interpolated."""
LOAD_U = 0.3
"""Standard uncertainty of each term of an uneven load, where the picture asks for one: ice on half of the span with
half of the conductor's own weight is a first term of 0.3."""
SUSPECT_SUPPORT = 0.6
SUSPECT_SHARE = 0.35
"""Where less of an even curve, or of the span, shows a wire, the wire may hang unevenly, and that is tried."""
EVEN_ODDS = 2.0
"""Logarithm of the odds of an uneven over an even load above which the load is not taken for even."""
SUSPECT_ODDS = -5.0
APART_ODDS = -6.0
"""The same where there is a reason to doubt that the load is even: UNEVENNESS, or a swing apart from the others'.

Seen along the line, a swung even span and an unswung uneven one can look alike over the part that is clear. What the
picture does not decide, the wider uncertainty of the uneven load must carry.
"""
UNEVENNESS, DOUBTFUL = 4.5, 9.0
"""Misfit that an uneven load would take off, from which it is tried, and from which an even one is not believed: evenly
loaded wires rarely exceed 3."""
SWING_APART = (np.radians(1.0), 0.15, 3.0)
"""Swings differ more than wind explains: this angle, this share of their mean and this many of their uncertainties."""
FOLLOWING = 4
"""Rounds of the first refinement in which an uneven curve grows along the wire."""
TILTS = (-0.6, -0.3, 0.3, 0.6)
"""First terms of an uneven load that are searched where no even curve is found."""
RIVAL_APART_PX = 3.0
RIVAL_MIN_PX = 16
RIVAL_WORTH_A_LOOK = 0.6
OUTDONE = 0.83
"""Share of the response of a refined curve below which a candidate's score promises nothing that comes near it."""
RIVAL_SHOWN = 0.75
"""Share of a bundle's response that must show a spacing aside for that to be refined and compared."""
RIVAL_RESPONSE = 2.0
"""Mean response, in grey levels, below which a stretch of curve is taken to lie on nothing."""


NOT_LOOKED_AT = Sighting(0.0, np.zeros(0, dtype=bool))


@dataclass(frozen=True)
class Matched:
    """A conductor found in one frame."""

    survey: Survey
    solution: Solution
    view: View
    track: Track
    observed: Observed
    offsets: CurveObservations
    """The usable blocks of ``observed``, as they were solved for."""
    response: float
    """Mean response along the curve, half by length in the picture and half by length of the span, grey levels."""
    sighting: Sighting = NOT_LOOKED_AT
    rival: float = 0.0
    """Response of the best different curve over this one's where the two part; 0 if there is none."""
    doubtful_load: bool = False
    """The wire hangs unevenly by its misfit, and no uneven load was found that explains it better."""

    @property
    def sag(self) -> tuple[float, float]:
        """In-plane sag and its standard uncertainty, m."""
        return float(self.solution.theta[SAG]), float(np.sqrt(self.solution.covariance[SAG, SAG]))

    @property
    def swing(self) -> tuple[float, float]:
        """Swing and its standard uncertainty, rad."""
        return float(self.solution.theta[SWING]), float(np.sqrt(self.solution.covariance[SWING, SWING]))


def locate(site: Site, image: GreyImage, registered: Registered) -> dict[str, Matched]:
    """Find the measured conductors of a span, by id.

    Every conductor, those that are only known about included, is first found alone; then those that run close to
    another are refined once more with the others' curves masked, so that a neighbour cannot pull them.
    """
    alone = {c.id: _find(image, c, registered) for c in site.conductors}
    for conductor in site.conductors:
        match = alone[conductor.id]
        if match is not None and conductor.measured and _hangs_apart(match, [m for m in alone.values() if m]):
            alone[conductor.id] = _even_or_not(image, conductor, registered, match, APART_ODDS)
    curves = {name: m.track.wires() for name, m in alone.items() if m is not None}
    found: dict[str, Matched] = {}
    for conductor in site.conductors:
        first = alone[conductor.id]
        if first is None or not conductor.measured:
            continue
        others = [wire for name, wires in curves.items() if name != conductor.id for wire in wires]
        if runs_near(first.track, others, STAGES[-1].half_range_px):
            masked = _refine(image, conductor, first.survey, registered, first.solution.theta, others, STAGES[1:])
            first = None if masked is None else replace(masked, rival=first.rival)
        if first is not None:
            found[conductor.id] = first if first.sighting is not NOT_LOOKED_AT else _looked_at(image, first)
    return found


def _survey(conductor: SiteConductor, registered: Registered) -> Survey:
    movement = registered.movement_px or 0.0
    return moved_survey(conductor.survey, movement)


def _view(survey: Survey, conductor: SiteConductor, theta: FloatArray) -> View:
    intrinsics, pose = survey.camera(theta)
    shape = survey.shape(theta)
    load = tuple(float(term) for term in theta[LOAD]) if survey.load_u > 0 else ()
    return View(intrinsics, pose, shape.near, shape.far, conductor.width, load, conductor.members)


def _find(image: GreyImage, conductor: SiteConductor, registered: Registered) -> Matched | None:
    """A conductor alone: hanging evenly, or, where the picture asks for it, with ice or a weight on a part of it."""
    survey = _survey(conductor, registered)
    even = _find_even(image, conductor, survey, registered)
    if not conductor.measured:
        return even
    if even is not None:
        even = _looked_at(image, even)
        strain = unevenness(even.solution, survey, LOAD_U)
        if strain > UNEVENNESS:
            even = replace(even, doubtful_load=strain > DOUBTFUL)
            return _even_or_not(image, conductor, registered, even, SUSPECT_ODDS)
        if support(even) > SUSPECT_SUPPORT and visible_share(even) > SUSPECT_SHARE:
            return even
    return _even_or_not(image, conductor, registered, even, EVEN_ODDS)


def _looked_at(image: GreyImage, match: Matched) -> Matched:
    return replace(match, sighting=sight(image, match.track))


def _hangs_apart(match: Matched, all_matches: list[Matched]) -> bool:
    """Whether an evenly loaded conductor's swing differs from the others' by more than wind explains."""
    others = [other.swing for other in all_matches if other is not match and not other.survey.load_u]
    if match.survey.load_u or not others:
        return False
    middle = float(np.median([swing for swing, _ in others]))
    swing, u = match.swing
    angle, share, sigmas = SWING_APART
    limit = angle + share * 0.5 * abs(swing + middle) + sigmas * np.hypot(u, np.median([v for _, v in others]))
    return bool(abs(swing - middle) > limit)


def _even_or_not(
    image: GreyImage, conductor: SiteConductor, registered: Registered, even: Matched | None, least_odds: float
) -> Matched | None:
    """The conductor under an uneven load if its odds over the even one exceed ``least_odds``, else the even one.

    From the part of an even curve that lies on the wire the terms of the load follow it along, round by round; where
    there is no such part, curves are searched whose load rises or falls along the span.
    """
    plain = _survey(conductor, registered)
    survey = replace(plain, load_u=LOAD_U)
    if even is not None:
        start = even.solution.theta.copy()
    else:
        tilted = [(tilt, _tilted(image, conductor, survey, registered, tilt)) for tilt in TILTS]
        tilt, best = max(tilted, key=lambda pair: -np.inf if pair[1] is None else pair[1].score)
        if best is None:
            return None
        start = registered.theta.copy()
        start[SAG], start[SWING], start[LOAD.start] = best.sag, best.swing, tilt
    found = _refine(image, conductor, survey, registered, start, [], FOLLOWING * STAGES[:1] + STAGES[1:])
    if found is None or even is None:
        return found or even
    # both explanations of the same offsets; an even load that sees little of the wire must not choose what to explain
    simple = solve(plain, even.solution.theta, registered.camera, found.offsets, STAGES[-1].iterations)
    odds = log_odds(found.solution, survey, simple, plain)
    return replace(found, rival=even.rival) if odds > least_odds else even


def _tilted(
    image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered, tilt: float
) -> Candidate | None:
    """Best curve of the coarse search among those whose load rises along the span by ``tilt``."""
    view = replace(_view(survey, conductor, registered.theta), load=(tilt,))
    found = search(image, view, survey.sag_range, conductor.swing_max, survey.swing_u, survey.attachment_u, 1)
    return found[0] if found else None


def _find_even(image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered) -> Matched | None:
    """Coarse search, refinement of the best candidates, and a search along what the best one leaves open."""
    view = _view(survey, conductor, registered.theta)
    candidates = search(
        image, view, survey.sag_range, conductor.swing_max, survey.swing_u, survey.attachment_u, CANDIDATES
    )
    results: list[Matched] = []
    for candidate in candidates:
        # a curve on the wire shows at least what the search saw of it; what the search saw of others is flattered
        if results and candidate.score < RIVAL_WORTH_A_LOOK * candidates[0].score:
            break
        if results and candidate.score < OUTDONE * max(r.response for r in results):
            break
        start = registered.theta.copy()
        start[ATTACHMENTS] = 0.0
        start[SAG], start[SWING] = candidate.sag, candidate.swing
        results += filter(None, [_refine(image, conductor, survey, registered, start, [], STAGES[:1])])
    if not results:
        return None
    results.sort(key=_merit, reverse=True)
    if not conductor.measured:
        # known to a pixel is enough to keep out of its way
        return results[0]
    # what is left open by the clear part of the best one, and other candidates that are nearly as good
    starts = [results[0].solution.theta, *_along_the_valley(image, results[0], conductor)]
    starts += [r.solution.theta for r in results[1:] if _rivalry(image, results[0], r) > RIVAL_WORTH_A_LOOK]
    refined = [_refine(image, conductor, survey, registered, start, [], STAGES[1:]) for start in starts]
    aside = _a_spacing_aside(image, results[0], conductor)
    refined += [_refine(image, conductor, survey, registered, start, [], STAGES) for start in aside]
    finals = sorted(filter(None, refined), key=_merit, reverse=True)
    if not finals:
        return None
    rival = max((_rivalry(image, finals[0], other) for other in finals[1:]), default=0.0)
    return replace(finals[0], rival=rival)


def _along_the_valley(image: GreyImage, found: Matched, conductor: SiteConductor) -> list[FloatArray]:
    """Better starts θ (28,) along the direction of sag and swing that the wire seen so far leaves open.

    Seen along the line, the near half of a span fixes one combination of sag and swing, and a refinement that began
    too far off may never see the far half. The posterior knows that: it is long in one direction. Curves along that
    direction, all other unknowns following as the posterior correlates them, are compared with the picture.
    """
    theta, covariance = found.solution.theta, found.solution.covariance
    own = np.array([SAG, SWING])
    variance, axes = np.linalg.eigh(covariance[np.ix_(own, own)])
    length = float(np.sqrt(variance[-1]))
    direction = covariance[:, own] @ np.linalg.solve(covariance[np.ix_(own, own)], axes[:, -1])
    low, high = found.survey.sag_range
    per_unit = max(abs(direction[SAG]), 1e-9)
    reach = min(4 * length, (high - low) / per_unit)
    some = mixed_samples(found.track, SAMPLES)
    t = found.track.t[some]

    def pixels(amount: float) -> FloatArray:
        moved = theta + amount * direction
        return _view(found.survey, conductor, moved).pixels(float(moved[SAG]), float(moved[SWING]), t)[0]

    base = pixels(0.0)
    small = 0.02 * reach
    travel = np.abs(np.sum((pixels(small) - base) * normals(base), axis=1)) / small
    if not np.isfinite(travel).any() or float(np.nanmax(travel)) * reach < 2 * STAGES[0].half_range_px / 3:
        return []
    count = int(np.clip(2 * reach * float(np.nanpercentile(travel, 95)) / STEP_PX, 9, 300))
    amounts = np.linspace(-reach, reach, count)
    sags = theta[SAG] + amounts * direction[SAG]
    amounts = amounts[(sags > low) & (sags < high)]
    if not len(amounts):
        return []
    # a pixel's way along the valley is smooth: a polynomial through a few exact curves gives the others
    middle, half = 0.5 * (amounts[0] + amounts[-1]), 0.5 * (amounts[-1] - amounts[0])
    nodes = np.polynomial.chebyshev.chebpts1(VALLEY_NODES)
    exact = np.stack([pixels(float(middle + half * node)) for node in nodes])
    through = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, VALLEY_NODES - 1))
    wanted = np.polynomial.chebyshev.chebvander((amounts - middle) / max(half, 1e-12), VALLEY_NODES - 1)
    curves = np.tensordot(wanted @ through, exact, axes=1)
    place, side = lines(found.track.members[:, some], found.track.width[some])
    response = line_response(image, curves, normals(curves), place, side)
    # one more sample that shows nothing: a curve that is out of the frame is no good one
    scores = np.nansum(response, axis=1) / (np.isfinite(response).sum(axis=1) + 1)
    starts = []
    for _ in range(2):
        if not len(scores) or not np.isfinite(scores).any():
            break
        best = int(np.nanargmax(scores))
        starts.append(theta + amounts[best] * direction)
        scores[max(0, best - 3) : best + 4] = -np.inf
    return starts


def _a_spacing_aside(image: GreyImage, found: Matched, conductor: SiteConductor) -> list[FloatArray]:
    """Starts θ (24,) at which the sub-conductors of a bundle would lie where others of it seem to be.

    A pattern that lies a spacing off covers a part of the bundle and looks like half an answer; against the right one
    it must lose. Only those come back near which the picture shows about as much; none for a single wire.
    """
    theta = found.solution.theta
    starts: list[FloatArray] = []
    shape = found.survey.shape(theta)
    swing_now = float(theta[SWING])
    down, turned = gravity_direction(shape.near, shape.far, np.array([swing_now, swing_now + 0.5 * np.pi]))
    between = (conductor.members[:, None] - conductor.members).reshape(-1, 3)
    sags, swings = between @ down, between @ turned / max(float(theta[SAG]), 1e-6)
    for sag, swing in np.unique(np.round(np.stack([sags, swings], axis=1), 6), axis=0):
        if sag or swing:
            start = theta.copy()
            start[SAG] += sag
            start[SWING] += swing
            if _shown_near(image, _view(found.survey, conductor, start), start) > RIVAL_SHOWN * found.response:
                starts.append(start)
    return starts


def _shown_near(image: GreyImage, view: View, theta: FloatArray) -> float:
    """Greatest mean response of a curve moved across by a few pixels, grey levels."""
    curve = trace(view, float(theta[SAG]), float(theta[SWING]))
    if curve is None:
        return 0.0
    some = mixed_samples(curve, SAMPLES)
    place, side = lines(curve.members[:, some], curve.width[some])
    moved = curve.pixels[some] + np.arange(-6.0, 7.0)[:, None, None] * curve.normal[some]
    response = line_response(image, moved, curve.normal[some], place, side)
    seen = np.isfinite(response)
    return float(np.max(np.where(seen, response, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)))


def _merit(matched: Matched) -> float:
    """How well a candidate explains the picture without contradicting the survey."""
    return max(matched.response, 0.0) / (1 + max(0.0, attachment_z(matched) - 3.0))


def _rivalry(image: GreyImage, best: Matched, other: Matched) -> float:
    """Response of another solution over that of the best where their curves part; 0 where it shows nothing itself.

    What they share says nothing about which is right, and solutions that agree within their uncertainty are one.
    """
    (sag_a, u_a), (sag_b, u_b) = best.sag, other.sag
    (swing_a, v_a), (swing_b, v_b) = best.swing, other.swing
    if abs(sag_a - sag_b) < 3 * np.hypot(u_a, u_b) and abs(swing_a - swing_b) < 3 * np.hypot(v_a, v_b):
        return 0.0
    mine = best.track.response(image)[~near_another(best.track, other.track, RIVAL_APART_PX)]
    theirs = other.track.response(image)[~near_another(other.track, best.track, RIVAL_APART_PX)]
    if len(theirs) < RIVAL_MIN_PX or not np.isfinite(theirs).any() or np.nanmean(theirs) < RIVAL_RESPONSE:
        return 0.0
    own = float(np.nanmean(mine)) if np.isfinite(mine).any() else 0.0
    apart = float(np.nanmean(theirs)) / max(own, 1e-3)
    return min(apart, _merit(other) / max(_merit(best), 1e-3))


def _refine(
    image: GreyImage,
    conductor: SiteConductor,
    survey: Survey,
    registered: Registered,
    theta: FloatArray,
    others: list[FloatArray],
    stages: tuple[Stage, ...],
) -> Matched | None:
    """Measure across the curve, solve jointly, and again about the new curve, looking ever closer."""
    solution: Solution | None = None
    observed: Observed | None = None
    offsets: CurveObservations | None = None
    for stage in stages:
        view = _view(survey, conductor, theta)
        curve = trace(view, float(theta[SAG]), float(theta[SWING]))
        if curve is None:
            return None
        block_px = max(stage.block_px, float(curve.arc[-1]) / MAX_BLOCKS)
        observed = observe(image, curve, stage.half_range_px, others, block_px, stage.shifts, stage.run)
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
        solution = solve(survey, theta, registered.camera, offsets, stage.iterations)
        theta = solution.theta
    if solution is None or observed is None or offsets is None:
        return None
    view = _view(survey, conductor, theta)
    curve = trace(view, float(theta[SAG]), float(theta[SWING]))
    if curve is None:
        return None
    response = _mixed_response(image, curve)
    return Matched(survey, solution, view, curve, observed, offsets, response)


def _mixed_response(image: GreyImage, track: Track) -> float:
    """Mean response of a curve, half by length in the picture and half by length of the span, grey levels."""
    response = track.response(image, mixed_samples(track, SAMPLES))
    return float(np.nanmean(response)) if np.isfinite(response).any() else 0.0


def on_curve(solution: Solution, observed: Observed) -> NDArray[np.bool_]:
    """Which blocks (M,) show the wire on the solved curve."""
    result = np.zeros(len(observed.t), dtype=bool)
    limit = np.maximum(1.0, 3 * observed.sigma[observed.usable])
    result[observed.usable] = np.abs(solution.residual) < limit
    return result


def support(matched: Matched) -> float:
    """Share of the curve in the frame, by its length in the picture, on which a wire stands out."""
    return float(np.mean(matched.sighting.seen))


def visible_share(matched: Matched) -> float:
    """Share of the span's horizontal length over which a wire stands out on the curve."""
    extent = np.abs(np.gradient(matched.track.t))
    return float(np.clip(extent[matched.sighting.seen].sum(), 0.0, 1.0))


def attachment_z(matched: Matched) -> float:
    """Largest correction to the surveyed attachments, in units of their standard uncertainty."""
    return float(np.max(np.abs(matched.solution.theta[ATTACHMENTS])) / max(matched.survey.attachment_u, 1e-6))
