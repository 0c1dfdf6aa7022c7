"""An evenly loaded conductor in a frame: coarse search, refinement of the best, a search along what is left open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.afar import approached
from sagnode.estimate.matched import Matched, attachment_z
from sagnode.estimate.refinement import STAGES, refine, remaining_stages, view_of
from sagnode.estimate.register import Registered
from sagnode.geometry.camera import FloatArray
from sagnode.geometry.conductor import gravity_direction
from sagnode.match.bundle import lines
from sagnode.match.library import Shelf
from sagnode.match.masks import Neighbour, near_another
from sagnode.match.ribbon import line_response, normals
from sagnode.match.robust import percentile
from sagnode.match.search import POLISHED, Candidate, search
from sagnode.match.templates import SAMPLES, STEP_PX, View
from sagnode.match.track import mixed_samples, trace
from sagnode.site import SiteConductor
from sagnode.survey import ATTACHMENTS, SAG, SWING, Survey

CANDIDATES, CANDIDATES_APART = 4, 8
"""Candidates of the search that are refined; the second where another wire is in the way, which is among them."""
THOROUGH = 40
"""Peaks of the search that a second look polishes: along a treeline, twenty lie before a thin wire's."""
COMPARED, COMPARED_SHARE = 32, 0.9
"""Samples of a refined curve that a candidate is compared at, and the share of them that must be near."""
NODES = np.polynomial.chebyshev.chebpts1(9)
"""Curves along the valley that are projected, from -1 to 1; the others between them are interpolated."""
THROUGH_NODES = np.linalg.inv(np.polynomial.chebyshev.chebvander(NODES, len(NODES) - 1))
"""Coefficients (9, 9) of Chebyshev's polynomials by the values at those."""
RIVAL_APART_PX = 3.0
RIVAL_MIN_PX = 16
RIVAL_WORTH_A_LOOK = 0.6
OUTDONE = 0.83
"""Share of the response of a refined curve below which a candidate's score promises nothing that comes near it."""
FLATTERED, ELSEWHERE_SHARE = 0.55, 0.7
"""What a candidate's score is worth as a response (each of its samples is the best within a band), and the share of a
refined curve near which a candidate runs that is the same."""
RIVAL_SHOWN = 0.75
"""Share of a bundle's response that must show a spacing aside for that to be refined and compared."""
RIVAL_RESPONSE = 2.0
"""Mean response, in grey levels, below which a stretch of curve is taken to lie on nothing."""


def find_even(
    image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered, shelf: Shelf | None = None
) -> Matched | None:
    """Coarse search, refinement of the best candidates, and a search along what the best one leaves open.

    Where that comes to less than the search promised, a second look is more thorough: at more of the search's peaks,
    and first as far aside as the survey leaves the wire.

    ``shelf`` holds the libraries that frames of the same burst have drawn before.
    """
    view = view_of(survey, conductor, registered.theta)
    shelf = Shelf() if shelf is None else shelf
    candidates = candidates_of(image, conductor, survey, view, shelf, CANDIDATES)
    starts = [start_of(registered, candidate) for candidate in candidates]
    refined = _refined(image, conductor, survey, registered, view, candidates, starts)
    found = best_of(image, refined)
    if candidates and (found is None or _outdone_by(view, candidates, found)):
        candidates = candidates_of(image, conductor, survey, view, shelf, CANDIDATES, THOROUGH)
        starts = [start_of(registered, candidate) for candidate in candidates]
        afar = [approached(image, conductor, survey, registered, start) for start in starts]
        refined += _refined(image, conductor, survey, registered, view, candidates, afar)
        # others that run beside it where the wide looks compare it with defeat those, but not a close one
        close = (refine(image, conductor, survey, registered, start, [], STAGES[-1:]) for start in starts)
        refined += [each for each in close if each is not None and each.solution.converged]
        found = best_of(image, refined)
    if found is None or not conductor.measured:
        return found
    return replace(found, rival=max(found.rival, _outdone_by(view, candidates, found)))


def _refined(
    image: GreyImage,
    conductor: SiteConductor,
    survey: Survey,
    registered: Registered,
    view: View,
    candidates: Sequence[Candidate],
    starts: Sequence[FloatArray],
) -> list[Matched]:
    """What some candidates of the search, the best first, and the θ (28,) to start from come to."""
    results: list[Matched] = []
    for candidate, start in zip(candidates, starts, strict=True):
        # a curve on the wire shows at least what the search saw of it; what the search saw of others is flattered
        if results and candidate.score < RIVAL_WORTH_A_LOOK * candidates[0].score:
            break
        if results and candidate.score < OUTDONE * max(r.response for r in results):
            break
        if any(r.solution.converged and _near_enough(view, candidate, r) for r in results):
            continue
        results += filter(None, [refine(image, conductor, survey, registered, start, [], STAGES[:1])])
    if not results:
        return []
    results.sort(key=merit, reverse=True)
    if not conductor.measured:
        # known to a pixel is enough to keep out of its way, and one that has not settled is not
        best = results[0]
        if best.solution.converged:
            return [best]
        start = best.solution.theta
        return [refine(image, conductor, survey, registered, start, [], remaining_stages(best), best.track) or best]
    # what is left open by the clear part of the best one, and other candidates that are nearly as good
    again = [results[0], *(r for r in results[1:] if _rivalry(image, results[0], r) > RIVAL_WORTH_A_LOOK)]
    refined = [
        refine(image, conductor, survey, registered, r.solution.theta, [], remaining_stages(r), r.track) for r in again
    ]
    valley = _along_the_valley(image, results[0], conductor)
    refined += [refine(image, conductor, survey, registered, start, [], STAGES[1:]) for start in valley]
    aside = _a_spacing_aside(image, results[0], conductor)
    refined += [refine(image, conductor, survey, registered, start, [], STAGES) for start in aside]
    return [each for each in refined if each is not None]


def find_apart(
    image: GreyImage,
    conductor: SiteConductor,
    survey: Survey,
    registered: Registered,
    others: Sequence[Neighbour],
    shelf: Shelf | None = None,
) -> Matched | None:
    """A conductor where it is clear of other wires, one of which it could be taken for.

    The first stages of a refinement look so far aside that they would see those wires; a candidate of the search lies
    near enough for the last.
    """
    view = view_of(survey, conductor, registered.theta)
    refined = [
        refine(image, conductor, survey, registered, start_of(registered, candidate), others, STAGES[-1:])
        for candidate in candidates_of(image, conductor, survey, view, shelf, CANDIDATES_APART)
    ]
    return best_of(image, [each for each in refined if each is not None and each.solution.converged])


def candidates_of(
    image: GreyImage,
    conductor: SiteConductor,
    survey: Survey,
    view: View,
    shelf: Shelf | None,
    keep: int,
    polished: int = POLISHED,
) -> list[Candidate]:
    """The best of the coarse search, ``keep`` at most, best first, of ``polished`` peaks that are looked at closely."""
    shelf = Shelf() if shelf is None else shelf
    library = shelf.take(conductor.id, view, survey.sag_range, conductor.swing_max, survey.attachment_u)
    return search(image, library, survey.swing_u, keep, survey.swing_mean, polished)


def start_of(registered: Registered, candidate: Candidate) -> FloatArray:
    """θ (28,) of a candidate, its camera as the landmarks have it."""
    start = registered.theta.copy()
    start[ATTACHMENTS] = 0.0
    start[SAG], start[SWING] = candidate.sag, candidate.swing
    return start


def best_of(image: GreyImage, refined: Sequence[Matched | None]) -> Matched | None:
    """The best of some refined conductors, with the strongest of the others as its rival."""
    finals = sorted(filter(None, refined), key=merit, reverse=True)
    if not finals:
        return None
    rival = max((_rivalry(image, finals[0], other) for other in finals[1:]), default=0.0)
    return replace(finals[0], rival=rival)


def _near_enough(view: View, candidate: Candidate, found: Matched, share: float = COMPARED_SHARE) -> bool:
    """Whether a candidate lies near a refined curve, along more than a share of it.

    By default so near that its own refinement would come to that one.
    """
    track = found.track
    some = mixed_samples(track, COMPARED)
    pixels, _ = view.pixels(candidate.sag, candidate.swing, track.t[some])
    apart = np.abs(np.sum((pixels - track.pixels[some]) * track.normal[some], axis=1))
    return bool(np.mean(apart < STAGES[1].half_range_px) > share)


def _outdone_by(view: View, candidates: Sequence[Candidate], best: Matched) -> float:
    """Response of the best candidate over that of what was found, if that is elsewhere; 0 if it is not.

    A refinement may lose the wire that the search had found, and come to rest on half of it and something else.
    """
    first = max(candidates, key=lambda each: each.score)
    if FLATTERED * first.score < RIVAL_WORTH_A_LOOK * best.response or _near_enough(view, first, best, ELSEWHERE_SHARE):
        return 0.0
    return FLATTERED * first.score / max(best.response, 1e-3)


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
        return view_of(found.survey, conductor, moved).pixels(float(moved[SAG]), float(moved[SWING]), t)[0]

    base = pixels(0.0)
    small = 0.02 * reach
    travel = np.abs(np.sum((pixels(small) - base) * normals(base), axis=1)) / small
    if not np.isfinite(travel).any() or float(np.nanmax(travel)) * reach < 2 * STAGES[0].half_range_px / 3:
        return []
    count = int(np.clip(2 * reach * percentile(travel[np.isfinite(travel)], 95) / STEP_PX, 9, 300))
    amounts = np.linspace(-reach, reach, count)
    sags = theta[SAG] + amounts * direction[SAG]
    amounts = amounts[(sags > low) & (sags < high)]
    if not len(amounts):
        return []
    # a pixel's way along the valley is smooth: a polynomial through a few exact curves gives the others
    middle, half = 0.5 * (amounts[0] + amounts[-1]), 0.5 * (amounts[-1] - amounts[0])
    exact = np.stack([pixels(float(middle + half * node)) for node in NODES])
    wanted = np.polynomial.chebyshev.chebvander((amounts - middle) / max(half, 1e-12), len(NODES) - 1)
    curves = np.tensordot(wanted @ THROUGH_NODES, exact, axes=1)
    place, side = lines(found.track.members[:, some], found.track.width[some])
    response = line_response(image, curves, normals(curves), place, side)
    # one more sample that shows nothing: a curve that is out of the frame is no good one
    seen = np.isfinite(response)
    scores = np.where(seen, response, np.float32(0)).sum(axis=1) / (np.count_nonzero(seen, axis=1) + 1)
    starts = []
    for _ in range(2):
        if not len(scores) or not np.isfinite(scores).any():
            break
        best = int(np.nanargmax(scores))
        starts.append(theta + amounts[best] * direction)
        scores[max(0, best - 3) : best + 4] = -np.inf
    return starts


def _a_spacing_aside(image: GreyImage, found: Matched, conductor: SiteConductor) -> list[FloatArray]:
    """Starts θ (28,) at which the sub-conductors of a bundle would lie where others of it seem to be.

    A pattern that lies a spacing off covers a part of the bundle and looks like half an answer; against the right one
    it must lose. Only those come back near which the picture shows about as much; none for a single wire.
    """
    if len(conductor.members) == 1:
        return []
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
            if _shown_near(image, view_of(found.survey, conductor, start), start) > RIVAL_SHOWN * found.response:
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


def merit(matched: Matched) -> float:
    """How well a conductor as it was found explains the picture without contradicting the survey, grey levels."""
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
    return min(apart, merit(other) / max(merit(best), 1e-3))
