"""One wind on all conductors of a span: what the others' swings tell of one whose own picture hardly shows it.

Seen along the line, the picture of a wire often shows one combination of sag and swing well and the other hardly: less
sag with a little more swing makes the same picture, and a search may settle anywhere along that. The camera sees the
planes in which its neighbours hang at other angles, and they swing as it does to within tenths of the angle
(:mod:`sagnode.estimate.swings`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.beside import Picture, disturbed, without
from sagnode.estimate.even import find_even, merit
from sagnode.estimate.joint import solve
from sagnode.estimate.judge import RIVAL_MAX
from sagnode.estimate.matched import Matched, is_wire, looked_at
from sagnode.estimate.refinement import STAGES, completed, refine, survey_of
from sagnode.estimate.register import Registered
from sagnode.estimate.swings import apart, expected_swing, explanation
from sagnode.match.library import Shelf
from sagnode.match.masks import runs_near
from sagnode.site import SiteConductor
from sagnode.survey import SAG, SWING

SURER = 1.5
"""A conductor is sought again where the others know its swing so many times surer than its own picture does."""
WORTHWHILE = 0.9
"""Share of its uncertainty of sag that the others' wind must leave at most, to be reckoned with."""
CONTRADICTED_Z = 3.0
"""A swing farther than this many standard uncertainties from what the others let expect has a wind of its own."""
UNLIKE_Z = 2.0
"""A wire under an uneven load whose swing lies this far from that of every other has another load, or is another wire.
Seen from the side a load and a swing bend the curve alike. Its swing was solved for as the others let expect it, so
that chance alone takes it nowhere near as far."""
STILL_SHOWN = 0.95
"""Share of the response that must be left of a curve that the wind has moved."""


def sought_again(
    image: GreyImage,
    conductors: Sequence[SiteConductor],
    registered: Registered,
    alone: Mapping[str, Matched | None],
    shelf: Shelf | None = None,
) -> dict[str, Matched | None]:
    """The same, where the others know the swing of a conductor far better: sought again with that.

    The others tell where to look and nothing more: what is found there is solved for under the survey's own swing, so
    that it says of its load and of the wind what its own picture shows. A wire that is only known about is to be kept
    out of the way of, and is taken where the wind has it.
    """
    lost = [c for c in conductors if _may_be_lost(alone[c.id])]
    if not lost or len(conductors) < 2:
        return dict(alone)
    told = [(c.id, alone[c.id]) for c in conductors if c.measured]
    telling = {name: each for name, each in told if each is not None and _tells(image, each)}
    result = dict(alone)
    for conductor in lost:
        survey, first = survey_of(conductor, registered), alone[conductor.id]
        swing, swing_u = _expected(conductor, telling)
        known = first.swing[1] if first is not None and first.solution.converged else survey.swing_u
        if known < SURER * swing_u:
            continue
        narrow = replace(survey, swing_mean=swing, swing_u=swing_u)
        there = find_even(image, conductor, narrow, registered, shelf)
        if there is None:
            continue
        if not conductor.measured:
            if first is None or merit(there) > merit(first):
                result[conductor.id] = there
            continue
        found = refine(image, conductor, survey, registered, there.solution.theta, [], STAGES[-1:])
        if found is not None and found.solution.converged and _is_better(found, first):
            result[conductor.id] = replace(found, rival=there.rival)
    return result


def in_one_wind(
    image: GreyImage,
    conductors: Sequence[SiteConductor],
    registered: Registered,
    located: Mapping[str, Matched],
    known: Mapping[str, Matched | None],
) -> dict[str, Matched]:
    """The same, evenly loaded conductors solved for with what the others say about their swing, where that tells more.

    To be asked last, when the loads are settled and who hangs where: what the others say of the swing must not speak
    for or against either. ``known`` are wires that are not measured, and in the way like the others.
    """
    every = {**known, **located}
    settled = {name: each for name, each in located.items() if _is_settled(each)}
    telling = {name: each for name, each in settled.items() if each.solution.converged}
    result = dict(located)
    for conductor in conductors:
        found = settled.get(conductor.id)
        if found is None or not telling.keys() - {conductor.id}:
            continue
        swing, swing_u = _expected(conductor, telling)
        if abs(swing - found.swing[0]) > CONTRADICTED_Z * np.hypot(swing_u, found.swing[1]):
            continue
        if _left_of_sag_u(found, swing_u) < WORTHWHILE:
            others = [each for name, each in every.items() if each is not None and name != conductor.id]
            result[conductor.id] = _solved_in(image, conductor, registered, found, (swing, swing_u), others)
    return result


def unlike_others(located: Mapping[str, Matched]) -> set[str]:
    """Conductors under an uneven load, by id, that would have to have a wind of their own."""
    telling = {name: each for name, each in located.items() if each.solution.converged and not each.crowded}
    result = set()
    for name, each in telling.items():
        others = [other for other in telling if other != name]
        if each.survey.load_u and others:
            nearest = min(apart(each.swing, telling[other].swing) for other in others)
            if nearest > UNLIKE_Z:
                result.add(name)
    return result


def _may_be_lost(found: Matched | None) -> bool:
    return found is None or not found.solution.converged or found.swing[1] > SURER * np.radians(0.3)


def _tells(image: GreyImage, found: Matched) -> bool:
    return found.solution.converged and is_wire(looked_at(image, found))


def _is_settled(found: Matched) -> bool:
    """Whether a conductor is surely the one that it is taken for, under an even load."""
    if found.survey.load_u or found.other is not None or found.doubtful_load:
        return False
    return (
        found.solution.converged and is_wire(found) and not (found.crowded or found.or_of) and found.rival < RIVAL_MAX
    )


def _expected(conductor: SiteConductor, telling: Mapping[str, Matched]) -> tuple[float, float]:
    """Swing and its standard uncertainty, rad, that all but the conductor itself let expect."""
    prior_u = conductor.survey.swing_u
    others = [
        [explanation(0.0, *found.swing, found.survey.swing_u)]
        for name, found in telling.items()
        if name != conductor.id
    ]
    return expected_swing(others, prior_u)


def _is_better(found: Matched, first: Matched | None) -> bool:
    return first is None or not first.solution.converged or merit(found) > merit(first)


def _left_of_sag_u(found: Matched, swing_u: float) -> float:
    """Share of the uncertainty of sag that is left when the swing is known by others with ``swing_u``, rad."""
    covariance, own = found.solution.covariance, found.survey.swing_u
    more = 1 / swing_u**2 - 1 / own**2
    if more <= 0:
        return 1.0
    less = covariance[SAG, SWING] ** 2 / (covariance[SWING, SWING] + 1 / more)
    return float(np.sqrt(max(1 - less / covariance[SAG, SAG], 0.0)))


def _solved_in(
    image: GreyImage,
    conductor: SiteConductor,
    registered: Registered,
    found: Matched,
    wind: tuple[float, float],
    others: Sequence[Matched],
) -> Matched:
    """The conductor with that swing expected; as it was where that leads elsewhere."""
    survey = replace(found.survey, swing_mean=wind[0], swing_u=wind[1])
    theta = solve(survey, found.solution.theta, registered.camera, found.offsets, STAGES[-1].iterations).theta
    close = any(runs_near(found.track, other.track.wires(), STAGES[-1].half_range_px) for other in others)
    clear = without(image, found, others) if close or disturbed(found, others) else Picture(image, [])
    again = refine(clear.image, conductor, survey, registered, theta, clear.others, STAGES[-1:])
    if again is None or not again.solution.converged:
        return found
    again = completed(clear.image, conductor, registered, again, clear.others)
    if again.response < STILL_SHOWN * found.response or again.sag[1] > found.sag[1]:
        return found
    unaided, unexcluded = found.unaided or found, found.unexcluded
    return looked_at(clear.image, replace(again, rival=found.rival, unaided=unaided, unexcluded=unexcluded))
