"""Even load or uneven: where the picture, or the neighbours, ask for ice or a weight on a part of the span."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.even import find_even
from sagnode.estimate.joint import log_odds, solve, unevenness
from sagnode.estimate.matched import STAGES, Matched, looked_at, refine, support, survey_of, view_of, visible_share
from sagnode.estimate.register import Registered
from sagnode.match.search import Candidate, search
from sagnode.site import SiteConductor
from sagnode.survey import LOAD, SAG, SWING, Survey

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


def find(image: GreyImage, conductor: SiteConductor, registered: Registered) -> Matched | None:
    """A conductor alone: hanging evenly, or, where the picture asks for it, with ice or a weight on a part of it."""
    survey = survey_of(conductor, registered)
    even = find_even(image, conductor, survey, registered)
    if not conductor.measured:
        return even
    if even is not None:
        even = looked_at(image, even)
        strain = unevenness(even.solution, survey, LOAD_U)
        if strain > UNEVENNESS:
            even = replace(even, doubtful_load=strain > DOUBTFUL)
            return even_or_not(image, conductor, registered, even, SUSPECT_ODDS)
        if support(even) > SUSPECT_SUPPORT and visible_share(even) > SUSPECT_SHARE:
            return even
    return even_or_not(image, conductor, registered, even, EVEN_ODDS)


def hangs_apart(match: Matched, all_matches: list[Matched]) -> bool:
    """Whether an evenly loaded conductor's swing differs from the others' by more than wind explains."""
    others = [other.swing for other in all_matches if other is not match and not other.survey.load_u]
    if match.survey.load_u or not others:
        return False
    middle = float(np.median([swing for swing, _ in others]))
    swing, u = match.swing
    angle, share, sigmas = SWING_APART
    limit = angle + share * 0.5 * abs(swing + middle) + sigmas * np.hypot(u, np.median([v for _, v in others]))
    return bool(abs(swing - middle) > limit)


def even_or_not(
    image: GreyImage, conductor: SiteConductor, registered: Registered, even: Matched | None, least_odds: float
) -> Matched | None:
    """The conductor under an uneven load if its odds over the even one exceed ``least_odds``, else the even one.

    From the part of an even curve that lies on the wire the terms of the load follow it along, round by round; where
    there is no such part, curves are searched whose load rises or falls along the span.
    """
    plain = survey_of(conductor, registered)
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
    found = refine(image, conductor, survey, registered, start, [], FOLLOWING * STAGES[:1] + STAGES[1:])
    if found is None or even is None:
        return found or even
    # both explanations of the same offsets; an even load that sees little of the wire must not choose what to explain
    simple = solve(plain, even.solution.theta, registered.camera, found.offsets, STAGES[-1].iterations)
    odds = log_odds(found.solution, survey, simple, plain)
    if odds <= least_odds:
        return even
    # the even curve's rivals, held against what this one shows
    return replace(found, rival=even.rival * min(1.0, even.response / max(found.response, 1e-3)))


def _tilted(
    image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered, tilt: float
) -> Candidate | None:
    """Best curve of the coarse search among those whose load rises along the span by ``tilt``."""
    view = replace(view_of(survey, conductor, registered.theta), load=(tilt,))
    found = search(image, view, survey.sag_range, conductor.swing_max, survey.swing_u, survey.attachment_u, 1)
    return found[0] if found else None
