"""The refinement that finds a conductor: measure across the curve, solve, again, looking ever closer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.joint import Solution, curve_uncertainty, solve, solve_on_curve
from sagnode.estimate.matched import NOT_LOOKED_AT, Matched, measured_share, of_blocks
from sagnode.estimate.offsets import CurveObservations
from sagnode.estimate.register import Registered, moved_survey
from sagnode.estimate.weigh import solve_loads
from sagnode.geometry.camera import FloatArray
from sagnode.match.fold import axis_at, turn_of
from sagnode.match.masks import Neighbour
from sagnode.match.refine import Observed, observe, with_tip
from sagnode.match.templates import SAMPLES, View
from sagnode.match.track import Track, mixed_samples, trace
from sagnode.site import SiteConductor
from sagnode.survey import LOAD, SAG, SWING, Survey


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


STAGES = (Stage(8.0, 8.0, 2, 6, 5), Stage(5.0, 8.0, 4, 1, 6), Stage(3.0, 20.0, 8, 1, 24))
"""From the first refinement to the last, which knows the curve to a pixel and follows the wire where it is faint."""
FOLLOWED_EXTENT, FOLLOWED_BLOCKS = 0.6, 0.75
"""A wire has been followed where its blocks reach over this share of the visible span, are this share of all blocks,"""
EXPLAINED_SHARE, EXPLAINED_PX = 0.97, 0.5
"""and this share of them lies off the solved curve by less than so many px."""
FORETOLD_BLOCKS_PX, FORETOLD_ENOUGH = (12.0, 24.0, 12.0), 0.95
"""Lengths of blocks in the rounds of following a wire where it is foretold (long ones see what is weak all along), and
the share of usable blocks that leaves nothing to do."""
FORETOLD_PX, FORETOLD_Z = 0.7, 3.0
"""How far aside a block is looked for: so many px, and so many standard uncertainties of the solved curve."""
FORETOLD_MARGIN_PX = 1.5
STILL_SHOWN = 0.9
"""Share of the response of a curve under an uneven load that must be left when more of it is measured."""
FORETOLD_SAMPLES = 60
"""Places along a curve where its uncertainty is worked out."""
AGREED_Z, AGREED_SHARE = 3.0, 0.5
"""Standard deviations by which blocks that are looked for where the rest foretells them may move sag and swing: of what
they add, but not less than this share of what was uncertain before."""
TIP_OPEN_PX = 0.5
"""Standard uncertainty of a tip's place, px, from which a look at it tells something that the offsets do not."""
TIP_RANGE_PX = (6, 16)
"""Least and greatest distance from where it is foretold in which a tip is looked for."""
MAX_BLOCKS = 80
"""More blocks say nothing new: neighbours within a few dozen pixels share their error."""


def survey_of(conductor: SiteConductor, registered: Registered) -> Survey:
    """What is known of camera and conductor, the camera's orientation as uncertain as its movement makes it."""
    movement = registered.movement_px or 0.0
    return moved_survey(conductor.survey, movement)


def view_of(survey: Survey, conductor: SiteConductor, theta: FloatArray) -> View:
    """How the conductor's curves project at θ (28,): its camera, attachments and load."""
    intrinsics, pose = survey.camera(theta)
    shape = survey.shape(theta)
    load = tuple(float(term) for term in theta[LOAD]) if survey.load_u > 0 else ()
    return View(intrinsics, pose, shape.near, shape.far, conductor.width, load, conductor.members)


def refine(
    image: GreyImage,
    conductor: SiteConductor,
    survey: Survey,
    registered: Registered,
    theta: FloatArray,
    others: Sequence[Neighbour],
    stages: tuple[Stage, ...],
    begun: Track | None = None,
) -> Matched | None:
    """Measure across the curve, solve jointly, and again about the new curve, looking ever closer.

    ``begun`` is the curve at ``theta``, where it is known already.
    """
    solution: Solution | None = None
    observed: Observed | None = None
    offsets: CurveObservations | None = None
    view, curve = None, begun
    if curve is None:
        view, curve = _traced(survey, conductor, theta)
    for stage in stages:
        if curve is None:
            return None
        block_px = max(stage.block_px, float(curve.arc[-1]) / MAX_BLOCKS)
        observed = observe(image, curve, stage.half_range_px, others, block_px, stage.shifts, stage.run)
        if int(observed.usable.sum()) < 4:
            return None
        offsets = offsets_of(observed, bent=survey.load_u > 0 and stage is STAGES[-1])
        last = stage is STAGES[-1]
        solution = (solve_on_curve if last else solve)(survey, theta, registered.camera, offsets, stage.iterations)
        if last:
            observed, offsets, solution = _with_tip(image, survey, observed, offsets, solution, registered, others)
        theta = solution.theta
        view, curve = _traced(survey, conductor, theta)
    if solution is None or observed is None or offsets is None or view is None or curve is None:
        return None
    response = mixed_response(image, curve)
    return Matched(survey, solution, view, curve, observed, solution.curve, response)


def _traced(survey: Survey, conductor: SiteConductor, theta: FloatArray) -> tuple[View, Track | None]:
    """How the conductor's curves project at θ (28,), and its own."""
    view = view_of(survey, conductor, theta)
    return view, trace(view, float(theta[SAG]), float(theta[SWING]))


def weighed(image: GreyImage, conductor: SiteConductor, registered: Registered, found: Matched) -> Matched:
    """The same conductor under all the loads that explain what was seen of it, by their weights."""
    start = found.solution.theta
    solution = solve_loads(found.survey, start, registered.camera, found.offsets, STAGES[-1].iterations)
    view, curve = _traced(found.survey, conductor, solution.theta)
    if curve is None or not solution.converged:
        return found
    response = mixed_response(image, curve)
    return replace(found, solution=solution, view=view, track=curve, response=response, sighting=NOT_LOOKED_AT)


def completed(
    image: GreyImage,
    conductor: SiteConductor,
    registered: Registered,
    found: Matched,
    others: Sequence[Neighbour],
) -> Matched:
    """The same conductor with what can be measured of it where the rest of the wire foretells its place.

    Where another wire, or another stretch of this one, runs a few pixels away, and where a faint wire is one among
    several things within the usual reach, only what is near the foretold place is looked at. What that adds foretells
    the next stretch, round by round.
    """
    for block_px in FORETOLD_BLOCKS_PX:
        if float(np.mean(found.observed.usable)) > FORETOLD_ENOUGH or not found.solution.converged:
            break
        again = _foretold(image, conductor, registered, found, others, block_px)
        if again is None or not again.solution.converged or measured_share(again) <= measured_share(found):
            continue
        # the wire lies where it was foretold; what moves it farther than that was uncertain is something else
        if not found.survey.load_u and not _agree(found.solution, again.solution):
            break
        # an uneven load may bend away from the wire to please what is no wire's; an even one cannot
        if not found.survey.load_u or again.response > STILL_SHOWN * found.response:
            found = again
    # what was seen at once is weighed by no round
    unweighed = found.survey.load_u > 0 and not found.solution.loads
    return weighed(image, conductor, registered, found) if unweighed else found


def _agree(before: Solution, after: Solution) -> bool:
    """Whether more blocks moved sag and swing as far as they may, by what they leave of the uncertainty (Hausman)."""
    own = [SAG, SWING]
    was, left = (np.diag(each.covariance)[own] for each in (before, after))
    may = AGREED_Z * np.sqrt(np.maximum(was - left, AGREED_SHARE**2 * was))
    return bool((np.abs(after.theta - before.theta)[own] <= may).all())


def narrowed(
    image: GreyImage, conductor: SiteConductor, registered: Registered, found: Matched, others: Sequence[Neighbour]
) -> Matched | None:
    """The same conductor, looked for no farther aside than its place is uncertain: others run beside it all along."""
    for block_px in FORETOLD_BLOCKS_PX[:2]:
        again = _foretold(image, conductor, registered, found, others, block_px, everywhere=True)
        if again is None or not again.solution.converged:
            return None
        found = again
    return found


def _foretold(
    image: GreyImage,
    conductor: SiteConductor,
    registered: Registered,
    found: Matched,
    others: Sequence[Neighbour],
    block_px: float,
    *,
    everywhere: bool = False,
) -> Matched | None:
    """One more round of measuring and solving, each block looked for as far aside as the solved curve is uncertain.

    Those that were seen before keep the whole range, unless nothing does (``everywhere``).
    """
    track, theta = found.track, found.solution.theta
    sigma = spread_along(found.survey, theta, found.solution.covariance, track)
    # where the wire was seen without being foretold, all of it speaks: what a wrong idea of its load leaves over too
    half_range = np.where(
        of_blocks(found.observed, found.observed.usable, track.t) & (not everywhere),
        STAGES[-1].half_range_px,
        np.minimum(STAGES[-1].half_range_px, FORETOLD_PX + FORETOLD_Z * sigma),
    )
    block_px = max(block_px, float(track.arc[-1]) / MAX_BLOCKS)
    observed = observe(
        image, track, half_range, others, block_px, STAGES[-1].shifts, STAGES[-1].run, FORETOLD_MARGIN_PX
    )
    if int(observed.usable.sum()) < 4:
        return None
    offsets = offsets_of(observed, bent=found.survey.load_u > 0)
    solve_for = solve_loads if found.survey.load_u > 0 else solve_on_curve
    solution = solve_for(found.survey, theta, registered.camera, offsets, STAGES[-1].iterations)
    observed, offsets, solution = _with_tip(image, found.survey, observed, offsets, solution, registered, others)
    view, curve = _traced(found.survey, conductor, solution.theta)
    if curve is None:
        return None
    return replace(
        found,
        solution=solution,
        view=view,
        track=curve,
        observed=observed,
        offsets=offsets if found.survey.load_u else solution.curve,
        response=mixed_response(image, curve),
        sighting=NOT_LOOKED_AT,
    )


def spread_along(survey: Survey, theta: FloatArray, covariance: FloatArray, curve: Track) -> FloatArray:
    """Standard uncertainty (N,) of a curve across itself by a covariance (28, 28) of θ, px."""
    some = np.unique(np.linspace(0, len(curve.t) - 1, FORETOLD_SAMPLES).astype(np.intp))
    at = CurveObservations(curve.t[some], curve.arc[some], curve.normal[some], curve.pixels[some], np.ones(len(some)))
    return np.interp(curve.arc, curve.arc[some], curve_uncertainty(survey, theta, covariance, at))


def _with_tip(
    image: GreyImage,
    survey: Survey,
    observed: Observed,
    offsets: CurveObservations,
    solution: Solution,
    registered: Registered,
    others: Sequence[Neighbour],
) -> tuple[Observed, CurveObservations, Solution]:
    """What was seen and solved, with the tip of a fold, where the offsets leave it open and the picture shows it.

    Not under an uneven load, whose terms bend to a tip as to anything.
    """
    turn = None if survey.load_u else turn_of(observed.track)
    if turn is not None:
        unsure = _uncertainty_at(survey, solution, observed.track, turn)
        if unsure > TIP_OPEN_PX:
            half_range = int(np.clip(np.ceil(FORETOLD_Z * unsure), *TIP_RANGE_PX))
            tipped = with_tip(image, observed, turn, others, half_range)
            if tipped is not None:
                offsets = offsets_of(tipped, bent=False)
                again = solve(survey, solution.theta, registered.camera, offsets, STAGES[-1].iterations)
                return tipped, offsets, again
    return observed, offsets, solution


def _uncertainty_at(survey: Survey, solution: Solution, track: Track, turn: int) -> float:
    """Standard uncertainty of the solved curve along the axis of the fold where a track turns back, px."""
    at = slice(turn, turn + 1)
    place = CurveObservations(track.t[at], track.arc[at], axis_at(track, turn)[None], track.pixels[at], np.ones(1))
    return float(curve_uncertainty(survey, solution.theta, solution.covariance, place)[0])


def offsets_of(observed: Observed, *, bent: bool) -> CurveObservations:
    """The usable blocks, as the joint estimate takes them.

    An even curve leaves texture aside, which then weighs little; what it moves all the same is reckoned with later. The
    terms of an uneven load bend to it (``bent``).
    """
    use = observed.usable
    sigma = np.hypot(observed.sigma, observed.scatter)
    if bent:
        sigma = np.hypot(sigma, observed.texture)
    return CurveObservations(
        t=observed.t[use],
        arc=observed.arc[use],
        normal=observed.normal[use],
        measured=(observed.pixel + observed.offset[:, None] * observed.normal)[use],
        sigma=sigma[use],
        texture=None if bent else observed.texture[use],
        shading=None if observed.shading is None else observed.shading[use],
    )


def remaining_stages(found: Matched) -> tuple[Stage, ...]:
    """What is left to do after a refinement: at once the last stage where the wire was followed along the curve.

    A part of the curve that showed no wire yet may lie several pixels off it, and is approached step by step.
    """
    extent = np.ptp(found.offsets.t) / max(np.ptp(found.track.t), 1e-9)
    followed = extent > FOLLOWED_EXTENT and np.mean(found.observed.usable) > FOLLOWED_BLOCKS
    explained = np.mean(np.abs(found.solution.residual) < EXPLAINED_PX) > EXPLAINED_SHARE
    return STAGES[-1:] if found.solution.converged and followed and explained else STAGES[1:]


def mixed_response(image: GreyImage, track: Track) -> float:
    """Mean response of a curve, half by length in the picture and half by length of the span, grey levels."""
    response = track.response(image, mixed_samples(track, SAMPLES))
    seen = np.isfinite(response)
    return float(np.sum(response, where=seen)) / max(int(np.count_nonzero(seen)), 1)
