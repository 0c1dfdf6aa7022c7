"""Even load or uneven: where the picture, or the neighbours, ask for ice or a weight on a part of the span."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.evidence import Unevenness, log_odds, single_loads, unevenness
from sagnode.estimate.joint import solve
from sagnode.estimate.load_kinds import LOAD_U, any_single
from sagnode.estimate.matched import Matched, is_wire, looked_at, measured_share, share_standing_out, support
from sagnode.estimate.refinement import STAGES, refine, survey_of, view_of, weighed
from sagnode.estimate.register import Registered
from sagnode.estimate.starts import starts
from sagnode.estimate.swings import Explanation, expected_swing, explanation, explanations, uneven_probabilities
from sagnode.estimate.unexcluded import unexcluded
from sagnode.estimate.weigh import settled
from sagnode.geometry.camera import FloatArray
from sagnode.match.library import draw_library
from sagnode.match.search import Candidate, search
from sagnode.site import SiteConductor
from sagnode.survey import LOAD, SAG, SWING, Survey

LOADS_U = (0.1, LOAD_U)
"""The same for a light load and a heavy one: with these an even curve's residuals are asked whether there is one."""
ASKED = 0.01
"""Probability of an uneven load from which what it says widens what is told, the more the nearer it is to LET_IN."""
LET_IN = 0.04
"""Probability from which an uneven load is let in: before looking it is 0.028, a view that cannot tell leaves about as
much, and one that can tell and shows no sign of it less than 0.01."""
SUSPECT_SUPPORT, SUSPECT_SHARE = 0.6, 0.35
"""Where less of an even curve, or of the span, shows a wire, it is tried: what is beside the curve cannot ask."""
SURELY = 0.5
"""Probability of one conductor's uneven load from which no other is taken for even: ice does not fall on one alone."""
LIKELIER = 0.5
"""Probability from which the uneven load is told and the even one only held by the interval; below, the reverse."""
DOUBTFUL = 3.0
"""Surprise at what a light uneven load would take off the misfit, in standard deviations, from which an even one is
not believed."""
ONE_STEP = 50.0
"""The same, beyond which one linear step from an even curve says nothing about the uneven one."""
FOLLOWING = 4
"""Rounds of the first refinement in which an uneven curve grows along the wire."""
SHOWS_MORE = 1.05
"""Factor by which the picture must show more along a curve that followed an uneven load, for its offsets to count
against an even one that was found without them."""
FOLLOWED_SHARE = 0.3
"""Share of the span that must be seen following a load for the swing under it to be believed: with less, its errors
were twice as large as stated, from here on as stated."""
TILTS = (-0.6, -0.3, 0.3, 0.6)
"""First terms of an uneven load that are searched where no even curve is found."""


@dataclass(frozen=True)
class Doubt:
    """A conductor as an even load explains it, and what speaks against that.

    Attributes:
        conductor: which.
        survey: what is known of it, under an even load.
        even: the match; None where no even curve was found.
        strains: what its residuals say about a light and a heavy uneven load; empty where it lies on no wire. They are
            those before the even curve itself foretold where to look, and so is the swing that goes with them.
        singles: what they say about single loads, a weight or ice on one stretch.
    """

    conductor: SiteConductor
    survey: Survey
    even: Matched | None
    strains: list[Unevenness]
    singles: list[Unevenness]

    @property
    def swing_u(self) -> float:
        """Standard uncertainty of the surveyed swing, rad."""
        return self.survey.swing_u

    def as_even(self) -> list[Explanation]:
        """The even load as an explanation of the picture."""
        if self.even is None or not self.strains:
            return []
        return [explanation(0.0, *(self.even.unaided or self.even).swing, self.swing_u)]

    def as_uneven(self) -> list[Explanation]:
        """Uneven loads, by what the even one leaves over, as far as one step reaches."""
        near = [(each.log_odds, *each.swing) for each in (*self.singles, *self.strains) if each.misfit < ONE_STEP]
        return explanations(np.array(near).reshape(-1, 3), self.swing_u)

    def swing_loaded(self, found: Matched | None, uneven: list[Explanation]) -> list[Explanation]:
        """What it says of the wind under an uneven load: what was seen following it, where that was enough of it.

        One step from an even curve that the load has bent goes astray where the load is heavy. If there is nothing
        else, it is the last of the ``uneven`` explanations, for heavy loads: what a light one would let the others
        expect holds for no heavy one.
        """
        if found is not None and found.solution.converged and measured_share(found) >= FOLLOWED_SHARE:
            return [explanation(0.0, *found.swing, self.swing_u)]
        return uneven[-1:]

    def is_strained(self) -> bool:
        """Whether a light uneven load would take more off the misfit than a bare wire leaves."""
        return any(each.surprise > DOUBTFUL for each in self.strains[:1])

    def hardly_seen(self) -> bool:
        """Whether so little lies on the even curve that the wire may be elsewhere."""
        return (
            self.even is None or support(self.even) < SUSPECT_SUPPORT or share_standing_out(self.even) < SUSPECT_SHARE
        )


def doubt(conductor: SiteConductor, registered: Registered, even: Matched | None) -> Doubt:
    """What one conductor's even match says against itself."""
    survey = survey_of(conductor, registered)
    # a curve on nothing has nothing to say, neither about the load nor about the wind
    strains: list[Unevenness] = []
    singles: list[Unevenness] = []
    if even is not None and is_wire(even):
        seen = even.unaided or even
        strains = unevenness(seen.solution, survey, LOADS_U)
        singles = single_loads(seen.solution, survey, seen.offsets.t)
    return Doubt(conductor, survey, even, strains, singles)


def settle_loads(
    pictures: Mapping[str, GreyImage], registered: Registered, evens: list[tuple[SiteConductor, Matched | None]]
) -> list[Matched | None]:
    """Every measured conductor of a span under the load that its picture and the others' swings leave it.

    An even load is the rule, and where nothing speaks against it nothing more is done. What is suspected is followed
    under an uneven one too; which of the wires may be uneven is decided for all together, and those are refined once
    more with the swing that the others let expect. ``pictures`` are those that each is looked for in, by id.
    """
    doubts = [doubt(conductor, registered, even) for conductor, even in evens]
    explained = [(each.as_even(), each.as_uneven()) for each in doubts]
    probable = _probable(explained, doubts)
    suspects = [each.hardly_seen() or p > ASKED for each, p in zip(doubts, probable, strict=True)]
    if not any(suspects):
        return [_left_even(each, p, explained, k) for k, (each, p) in enumerate(zip(doubts, probable, strict=True))]
    images = [pictures[conductor.id] for conductor, _ in evens]
    followed = [
        _follow(image, registered, each) if it else None
        for image, each, it in zip(images, doubts, suspects, strict=True)
    ]
    followed = [None if _went_astray(each, found) else found for each, found in zip(doubts, followed, strict=True)]
    explained = [
        (each.as_even(), _as_uneven(registered, each, found)) for each, found in zip(doubts, followed, strict=True)
    ]
    probable = _probable(explained, doubts)
    iced = max(probable) > SURELY
    uneven = [p > ASKED or iced for p in probable]
    believed = [
        each.swing_loaded(found, pair[1]) if other else pair[0]
        for each, found, pair, other in zip(doubts, followed, explained, uneven, strict=True)
    ]
    settled: list[Matched | None] = []
    for k, (each, found) in enumerate(zip(doubts, followed, strict=True)):
        left_even = _left_even(each, probable[k], explained, k)
        if not uneven[k] and each.strains:
            settled.append(left_even)
            continue
        others = [other for other in (*believed[:k], *believed[k + 1 :]) if other]
        refined = _refined(images[k], registered, each, found, expected_swing(others, each.swing_u))
        settled.append(_either(replace(each, even=left_even), refined, probable[k], iced=iced))
    return settled


def _probable(explained: list[tuple[list[Explanation], list[Explanation]]], doubts: list[Doubt]) -> list[float]:
    """Probability of an uneven load of each conductor.

    It is 0 where no even curve lies on a wire, which says nothing, and 1 where the even one is not to be believed.
    """
    seen = [k for k, (even, _) in enumerate(explained) if even]
    result = [0.0] * len(explained)
    if seen:
        probable = uneven_probabilities([explained[k] for k in seen], max(each.swing_u for each in doubts))
        for k, p in zip(seen, probable, strict=True):
            result[k] = 1.0 if doubts[k].is_strained() else p
    return result


def _left_even(
    each: Doubt, probable: float, explained: list[tuple[list[Explanation], list[Explanation]]], own: int
) -> Matched | None:
    """A conductor under an even load, with the uneven ones that the picture does not exclude."""
    if each.even is None or not each.strains:
        return each.even
    others = [even for k, (even, _) in enumerate(explained) if even and k != own]
    loads = unexcluded(each.even.solution, each.survey, probable, expected_swing(others, each.swing_u))
    return replace(each.even, unexcluded=loads)


def _follow(image: GreyImage, registered: Registered, each: Doubt) -> Matched | None:
    """The conductor under an uneven load.

    From the part of an even curve that lies on the wire the terms of the load follow it along, round by round; where
    there is no such part, curves are searched whose load rises or falls along the span.
    """
    survey = replace(each.survey, load_u=LOAD_U, load_prior=any_single())
    if each.even is not None:
        start = each.even.solution.theta
    else:
        tilted = [(tilt, _tilted(image, each.conductor, survey, registered, tilt)) for tilt in TILTS]
        tilt, best = max(tilted, key=lambda pair: -1.0 if pair[1] is None else pair[1].score)
        if best is None:
            return None
        start = registered.theta.copy()
        start[SAG], start[SWING], start[LOAD.start] = best.sag, best.swing, tilt
    grown = _grown(image, each.conductor, survey, registered, start)
    return _gone_on(image, each, survey, registered, grown)


def _went_astray(each: Doubt, found: Matched | None) -> bool:
    """Whether a wire was lost that the even curve lies on: free to bend, a curve can follow what is no wire's."""
    if found is None or each.even is None or not each.strains:
        return False
    return measured_share(found) < measured_share(each.even) and found.response < each.even.response


def _grown(
    image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered, start: FloatArray
) -> Matched | None:
    return refine(image, conductor, survey, registered, start, [], FOLLOWING * STAGES[:1] + STAGES[1:])


def _gone_on(
    image: GreyImage, each: Doubt, survey: Survey, registered: Registered, grown: Matched | None
) -> Matched | None:
    """Of a wire as it grew, and as it may go on from the clear part of it, what the picture shows most of."""
    found = [grown]
    if each.even is not None and each.strains:
        seen = each.even.unaided or each.even
        found += [
            refine(image, each.conductor, survey, registered, start, [], STAGES[1:])
            for start in starts(image, survey, seen, registered.camera, seen.solution.theta)
        ]
    best = _clearest(found)
    return grown if best is None else weighed(image, each.conductor, registered, best)


def _clearest(found: Sequence[Matched | None]) -> Matched | None:
    """The one that the picture shows most of, of those that settled."""
    good = [one for one in found if one is not None and one.solution.converged]
    return max(good, key=lambda one: one.response, default=None)


def _as_uneven(registered: Registered, each: Doubt, found: Matched | None) -> list[Explanation]:
    """Uneven loads as explanations: by the even curve's own residuals, and by what was seen following the wire."""
    if found is None or not found.solution.converged:
        return each.as_uneven()
    if each.even is None or not each.strains:
        return [explanation(0.0, *found.swing, each.swing_u)]
    if found.response < SHOWS_MORE * each.even.response and each.as_uneven():
        # the even curve lies on as much of a wire: what it leaves over itself is as good a witness
        return each.as_uneven()
    # both explanations of the same offsets; an even load that sees little of the wire must not choose what to explain
    steps = STAGES[-1].iterations
    asked = (each.survey, each.even.solution.theta, registered.camera, found.offsets, steps)
    simple = settled(*asked) or solve(*asked)
    if not np.isfinite(simple.misfit):
        # no even curve comes near what was followed, and how much likelier than none that is cannot be told
        return each.as_uneven() or [explanation(0.0, *found.swing, each.swing_u)]
    odds = log_odds(found.solution, found.survey, simple, each.survey)
    by_following = explanation(odds, *found.swing, each.swing_u)
    return [by_following] if odds > 0 else [*each.as_uneven(), by_following]


def _refined(
    image: GreyImage, registered: Registered, each: Doubt, found: Matched | None, expected: tuple[float, float]
) -> Matched | None:
    """The conductor under an uneven load with the swing that the others let expect."""
    swing, swing_u = expected
    survey = replace(each.survey, load_u=LOAD_U, load_prior=any_single(), swing_mean=swing, swing_u=swing_u)
    start = found or each.even
    refined = None
    if start is not None:
        theta = start.solution.theta
        wide = _grown(image, each.conductor, survey, registered, theta)
        # from a curve that is right already a wide look would go astray
        near = refine(image, each.conductor, survey, registered, theta, [], STAGES[1:])
        refined = _gone_on(image, each, survey, registered, _clearest([wide, near]) or wide)
    if refined is None:
        return each.even and replace(each.even, doubtful_load=True)
    # what rivalled the even curve is that much less of a rival to one that lies better on the wire
    rival = each.even.rival * min(1.0, each.even.response / max(refined.response, 1e-3)) if each.even else 0.0
    return looked_at(image, replace(refined, rival=rival))


def _either(each: Doubt, refined: Matched | None, probable: float, *, iced: bool) -> Matched | None:
    """The likelier of even and uneven load, with the other beside it where neither can be left out."""
    if each.even is None or not each.strains or each.is_strained():
        return refined
    let_in = iced or probable > LET_IN
    followed = refined is not None and refined.survey.load_u > 0 and refined.solution.converged
    if refined is None or not followed or (each.hardly_seen() and let_in):
        # a load that is hardly likely need not be followed to its end
        return refined if let_in else each.even
    likelier, other = (refined, each.even) if probable > LIKELIER else (each.even, refined)
    chance = min(probable, 1 - probable)
    weight = 1.0 if iced and likelier is each.even else (chance - ASKED) / (LET_IN - ASKED)
    return replace(likelier, other=other, other_weight=min(weight, 1.0)) if weight > 0 else likelier


def _tilted(
    image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered, tilt: float
) -> Candidate | None:
    """Best curve of the coarse search among those whose load rises along the span by ``tilt``."""
    view = replace(view_of(survey, conductor, registered.theta), load=(tilt,))
    library = draw_library(view, survey.sag_range, conductor.swing_max, survey.attachment_u)
    found = search(image, library, survey.swing_u, 1)
    return found[0] if found else None
