"""Conductors that run beside each other: each is looked for in the picture without the others.

A wire a few pixels away is the higher peak about a weaker wire's curve, and one that runs anywhere within the reach of
the shifted curves that a curve is compared with makes every place on it look like texture. So what was found is taken
out (:mod:`sagnode.match.peel`), the surest first, and the next is looked for in what is left; then each once more
without all others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.estimate.even import best_of, find_apart, find_even, merit
from sagnode.estimate.matched import Matched, is_wire, looked_at, may_be_wire, measured_share
from sagnode.estimate.refinement import refine, remaining_stages, spread_along, survey_of
from sagnode.estimate.register import Registered
from sagnode.match.library import Shelf
from sagnode.match.masks import Neighbour, near, near_another
from sagnode.match.peel import Line, peeled
from sagnode.site import SiteConductor

KNOWN_PX = 0.7
"""A wire is taken out where its place is surer than this; farther off, most of it would stay."""
LOOKED_AT_PX = 45.0
"""Distance to which what looks at a curve looks beside it: shifted curves and their sides."""
CLEAR_SHARE = 0.75
"""Share of usable blocks from which a conductor was found clearly, whatever runs beside it at a distance."""
CLOSE_PX = 12.0
"""Distance within which another wire may have been followed instead."""
DISTURBED_SHARE = 0.2
"""Share of a curve beside which others run from which they are in the way of finding it; less is left aside when it is
measured."""
MOVED_PX, MOVED_SHARE = 0.5, 0.05
"""A wire that lies farther than this from where it was taken out, over this share of another beside it, was not."""
SAME_WIRE = 0.25
"""Share of a curve within a pixel or two of another from which both lie on one wire."""
SAME_PX = 2.0
RESTS = 0.5
"""Share of what a conductor's offsets say from which it rests on the places where they lie."""


@dataclass(frozen=True)
class Picture:
    """The picture as one conductor is to be looked for in it.

    Attributes:
        image: without the wires that are known.
        others: those, and stretches of them that are not known well enough and stayed.
    """

    image: GreyImage
    others: Sequence[Neighbour]


def without(image: GreyImage, own: Matched | None, others: Sequence[Matched]) -> Picture:
    """The picture without other conductors where they run beside one, or anywhere if nobody knows where that one is."""
    lines: list[Line] = []
    neighbours: list[Neighbour] = []
    for other in others:
        unsure = spread_along(other.survey, other.solution.theta, other.solution.covariance, other.track)
        track = other.track
        beside = np.ones(len(track.t), dtype=bool)
        if own is not None:
            beside = near(track.pixels, track.normal, own.track.pixels, np.full(len(track.t), LOOKED_AT_PX))
        known = unsure < KNOWN_PX
        for wire in track.wires():
            for part in _stretches(beside & known):
                lines.append(Line(wire[part], track.normal[part], track.width[part]))
                neighbours.append(Neighbour(wire[part], float(np.mean(track.width[part])), unsure[part]))
            neighbours += [
                Neighbour(wire[part], float(np.mean(track.width[part]))) for part in _stretches(beside & ~known)
            ]
    kept = [] if own is None else [Line(wire, own.track.normal, own.track.width) for wire in own.track.wires()]
    return Picture(peeled(image, lines, kept), neighbours)


def find_beside(
    image: GreyImage,
    conductors: Sequence[SiteConductor],
    registered: Registered,
    found: Mapping[str, Matched | None],
    shelf: Shelf | None = None,
) -> dict[str, Matched | None]:
    """Conductors as they are found without those beside them, by id; those that run clear of others stay as they are.

    Args:
        image: raw grey frame.
        conductors: all of the span.
        registered: the camera.
        found: each as it was found in the whole picture.
        shelf: libraries that were drawn before.
    """
    told = dict(found)
    if not any(disturbed(told[c.id], _others(told, c), settles=c.measured) for c in conductors):
        return told
    surest = sorted(conductors, key=lambda c: _strength(told[c.id]), reverse=True)
    taken: list[Matched] = []
    for conductor in surest:
        own = told[conductor.id]
        if taken and disturbed(own, taken, settles=conductor.measured):
            own = _again(image, conductor, registered, own, taken, shelf, anywhere=True)
        told[conductor.id] = own
        if own is not None and may_be_wire(looked_at(without(image, own, taken).image, own)):
            taken.append(own)
    for conductor in surest:
        own = told[conductor.id]
        others = [each for each in _others(told, conductor) if any(each is one for one in taken)]
        if disturbed(own, others, settles=conductor.measured):
            again = _again(image, conductor, registered, own, others, shelf, anywhere=False)
            taken = [again if each is own and again is not None else each for each in taken]
            told[conductor.id] = again
    return told


def disturbed(own: Matched | None, others: Sequence[Matched], *, settles: bool = True) -> bool:
    """Whether others may have kept a conductor from being found, or from being found in its place.

    One that is measured ``settles`` unless something disturbs it. Of those that are only known about a pixel is enough,
    and often more cannot be had: that they do not settle is no sign.
    """
    if own is None or (settles and not own.solution.converged):
        return bool(others)
    clear = float(np.mean(own.observed.usable)) >= CLEAR_SHARE
    return _share_near(own, others, CLOSE_PX if clear else LOOKED_AT_PX) > DISTURBED_SHARE


def moved(own: Matched, before: Matched | None, after: Matched | None) -> bool:
    """Whether another that was taken out beside a conductor is not where it was then, as far as it can disturb."""
    if before is after:
        return False
    if before is None or after is None:
        return disturbed(own, [each for each in (before, after) if each is not None])
    if before.track is after.track:
        # solved for again, perhaps, but where it was
        return False
    for one, other in ((before, after), (after, before)):
        beside = near_another(one.track, own.track, CLOSE_PX)
        elsewhere = beside & ~near_another(one.track, other.track, MOVED_PX)
        if float(elsewhere.sum()) > MOVED_SHARE * len(own.track.t):
            return True
    return False


def _share_near(own: Matched, others: Sequence[Matched], reach: float) -> float:
    """Share of a curve, by its length in the picture, within whose reach, px, any of some others runs."""
    beside = np.zeros(len(own.track.t), dtype=bool)
    for other in others:
        beside |= near_another(own.track, other.track, reach)
    return float(np.mean(beside))


def _again(
    image: GreyImage,
    conductor: SiteConductor,
    registered: Registered,
    own: Matched | None,
    others: Sequence[Matched],
    shelf: Shelf | None,
    *,
    anywhere: bool,
) -> Matched | None:
    """A conductor looked for without some others: where it was found before, and ``anywhere`` if it shows no wire."""
    survey = survey_of(conductor, registered)
    on_one = own is not None and any(on_one_wire(own, other) for other in others)
    clear = without(image, None if on_one else own, others)
    results: list[Matched | None] = []
    if own is not None and not on_one:
        start = own.solution.theta
        results.append(
            refine(clear.image, conductor, survey, registered, start, clear.others, remaining_stages(own), own.track)
        )
    if anywhere or not _any_wire(clear.image, results):
        results.append(find_even(clear.image, conductor, survey, registered, shelf))
    if not _any_wire(clear.image, results):
        # among others a faint wire is no run of blocks that lead the curves beside it; as a whole it may stand out
        results.append(find_apart(clear.image, conductor, survey, registered, clear.others, shelf))
    return best_of(clear.image, results)


def _any_wire(image: GreyImage, matches: Sequence[Matched | None]) -> bool:
    return any(each is not None and is_wire(looked_at(image, each)) for each in matches)


def on_one_wire(one: Matched, other: Matched) -> bool:
    """Whether two conductors were found on the same wire."""
    return float(np.mean(near_another(one.track, other.track, SAME_PX))) > SAME_WIRE


def rests_on(own: Matched, other: Matched) -> bool:
    """Whether most of what a conductor's offsets say was seen where another one runs."""
    samples = near_another(own.track, other.track, SAME_PX)
    there = samples[np.minimum(np.searchsorted(own.track.arc, own.offsets.arc), len(samples) - 1)]
    said = 1 / own.offsets.sigma**2
    return float(said @ there) > RESTS * float(said.sum())


def _others(found: Mapping[str, Matched | None], conductor: SiteConductor) -> list[Matched]:
    return [each for name, each in found.items() if each is not None and name != conductor.id]


def _strength(match: Matched | None) -> float:
    """How surely a conductor was found: what its curve shows, and how much of it."""
    return -1.0 if match is None or not match.solution.converged else merit(match) * measured_share(match)


def _stretches(some: NDArray[np.bool_]) -> list[slice]:
    """Stretches of at least two samples that are all among some (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], some, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]
