"""Locating the conductors of a span in one frame: each alone, then all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.beside import disturbed, find_beside, moved, on_one_wire, rests_on, without
from sagnode.estimate.conclude import conclude
from sagnode.estimate.even import find_even
from sagnode.estimate.exchange import exchangeable
from sagnode.estimate.identity import tell_apart
from sagnode.estimate.load import settle_loads
from sagnode.estimate.lone import without_lone
from sagnode.estimate.matched import Matched, is_wire, looked_at, measured_share
from sagnode.estimate.pairs import pair_up
from sagnode.estimate.refinement import STAGES, completed, narrowed, refine, remaining_stages, survey_of
from sagnode.estimate.register import Registered
from sagnode.estimate.wind import in_one_wind, sought_again, unlike_others
from sagnode.match.library import Shelf
from sagnode.match.masks import runs_near
from sagnode.site import Site, SiteConductor

BESIDE = 0.5
"""Share of a conductor's blocks that others hide, looked at with the usual range, from which a narrow look is tried."""

ROUNDS = 5
"""Most rounds of measuring conductors beside each other, each without the others where they were found last."""


def locate(
    site: Site,
    image: GreyImage,
    registered: Registered,
    shelf: Shelf | None = None,
    shared: tuple[float, float] | None = None,
) -> dict[str, Matched]:
    """Find the measured conductors of a span, by id.

    Every conductor, those that are only known about included, is first found alone under an even load. Two that run so
    near each other that neither was found clearly are looked for as a pair; where two were found on one wire, one of
    them is looked for beside it. Those that run close to another are looked for and refined
    once more in the picture without the others, so that a neighbour cannot pull them, and all are completed. Then
    they are compared: their swings, and what is left over, say whether the load of any may be uneven; what is followed
    under an uneven load is kept clear of the others likewise. Those that could as well be each other are marked. Last,
    what the others say of the wind makes surer what a picture leaves open, and what hangs evenly is solved for once
    more with its offsets as uncertain as all that is known by then leaves them; what would need a wind of its own is
    marked.

    ``shelf`` holds the libraries that frames of the same burst have drawn before. ``shared`` is what neighbouring
    offsets share, px and relative to their own, where the frame itself cannot tell.
    """
    found_alone = {c.id: find_even(image, c, survey_of(c, registered), registered, shelf) for c in site.conductors}
    found_alone = sought_again(image, site.conductors, registered, found_alone, shelf)
    found_alone = pair_up(image, site.conductors, registered, found_alone, shelf)
    told_apart = tell_apart(image, site.conductors, registered, found_alone, shelf)
    found = find_beside(image, site.conductors, registered, told_apart, shelf)
    measured = [c for c in site.conductors if c.measured]
    evens, pictures = _measured(image, measured, registered, found)
    # one that only shows where a neighbour runs is not told, and says nothing of loads
    crowded = {name for name, even in evens.items() if even is None and found[name] is not None}
    asked = [c for c in measured if c.id not in crowded]
    doubted = [(c, own and looked_at(pictures[c.id], own)) for c in asked for own in [evens[c.id]]]
    settled = dict(zip((c.id for c in asked), settle_loads(pictures, registered, doubted), strict=True))
    before = {name: evens.get(name) or match for name, match in found.items()}
    together = found | settled
    located: dict[str, Matched] = {}
    for conductor in measured:
        own, picture = together[conductor.id], pictures[conductor.id]
        others = {name: match for name, match in before.items() if name != conductor.id}
        if own is not None and conductor.id in crowded:
            own = _crowded(picture, own)
        elif own is not None and (own.survey.load_u or _outdated(own, others, together)):
            own, picture = _among_others(image, conductor, registered, together)
            own = own and looked_at(picture, own)
        if own is None or not is_wire(own) or own.survey.load_u:
            # where two were found on one wire, and nothing beside it, or only under a load that bends one of them
            # elsewhere, the wire is there, and either may hang on it
            own = _on_one(image, told_apart[conductor.id], found, conductor) or own
        if own is not None:
            located[conductor.id] = own
    located = _with_its_neighbours(located)
    known = {c.id: found[c.id] for c in site.conductors if not c.measured}
    clear = {name: None if own.crowded else own for name, own in located.items()}
    doubtful = exchangeable(site.conductors, registered, known | clear)
    marked = {name: replace(own, or_of=doubtful.get(name, "")) for name, own in located.items()}
    concluded = conclude(in_one_wind(image, measured, registered, marked, known), registered, shared)
    unlike = unlike_others(concluded)
    return {name: _asked(own, registered, unlike=name in unlike) for name, own in concluded.items()}


def _asked(own: Matched, registered: Registered, *, unlike: bool) -> Matched:
    """A located conductor; under an uneven load with what is left of it without a block that decides alone."""
    loaded = own.survey.load_u > 0 and own.solution.converged and not unlike
    left = without_lone(own, registered, STAGES[-1].iterations) if loaded else None
    return replace(own, unlike_others=unlike, without_lone=left)


def _measured(
    image: GreyImage, conductors: Sequence[SiteConductor], registered: Registered, found: Mapping[str, Matched | None]
) -> tuple[dict[str, Matched | None], dict[str, GreyImage]]:
    """Conductors as they are measured without each other, by id, and the pictures that they are measured in.

    What moves is taken out of the others' pictures anew. Those beside which it never comes to rest are not measured:
    they may lie on a wire that was taken out elsewhere.
    """
    latest, pictures = dict(found), dict.fromkeys(found, image)
    evens: dict[str, Matched | None] = {}
    beside: dict[str, dict[str, Matched | None]] = {}
    for _ in range(ROUNDS):
        again = [c for c in conductors if c.id not in beside or _outdated(latest[c.id], beside[c.id], latest)]
        for c in again:
            beside[c.id] = {name: other for name, other in latest.items() if name != c.id}
            evens[c.id], pictures[c.id] = _among_others(image, c, registered, latest)
            latest[c.id] = evens[c.id] or latest[c.id]
        if not again:
            return evens, pictures
    restless = [c.id for c in conductors if _outdated(latest[c.id], beside[c.id], latest)]
    return evens | dict.fromkeys(restless), pictures


def _outdated(own: Matched | None, beside: Mapping[str, Matched | None], latest: Mapping[str, Matched | None]) -> bool:
    """Whether any of those that a conductor was measured without has moved since."""
    return own is not None and any(moved(own, before, latest[name]) for name, before in beside.items())


def _crowded(image: GreyImage, found: Matched) -> Matched | None:
    """A conductor of which nothing can be measured by itself, if it lies on a wire at all."""
    found = looked_at(image, found)
    return replace(found, crowded=True) if is_wire(found) else None


def _on_one(
    image: GreyImage, first: Matched | None, found: Mapping[str, Matched | None], conductor: SiteConductor
) -> Matched | None:
    """A conductor as it was found ``first``, if another hangs on the wire that it was found on."""
    others = [each for name, each in found.items() if each is not None and name != conductor.id]
    if first is None or not any(on_one_wire(first, other) for other in others):
        return None
    return _crowded(image, first)


def _with_its_neighbours(located: Mapping[str, Matched]) -> dict[str, Matched]:
    """The same; what rests on places beside a conductor that cannot be measured by itself cannot be either.

    Where that one hangs is not known, and what it shows there is taken for the other's.
    """
    crowded = [each for each in located.values() if each.crowded]
    return {
        name: replace(own, crowded=own.crowded or any(rests_on(own, each) for each in crowded))
        for name, own in located.items()
    }


def _hidden(found: Matched) -> bool:
    """Whether others hide most of a conductor."""
    return float(np.mean(found.observed.masked)) > BESIDE


def _among_others(
    image: GreyImage, conductor: SiteConductor, registered: Registered, all_found: Mapping[str, Matched | None]
) -> tuple[Matched | None, GreyImage]:
    """A conductor as it is measured without the others, None where it is not; and the picture without them."""
    found = all_found[conductor.id]
    if found is None:
        return None, image
    others = [other for name, other in all_found.items() if other is not None and name != conductor.id]
    close = any(runs_near(found.track, other.track.wires(), STAGES[-1].half_range_px) for other in others)
    if not close and not disturbed(found, others):
        return replace(completed(image, conductor, registered, found, []), unaided=found), image
    clear = without(image, found, others)
    start, stages = found.solution.theta, remaining_stages(found)
    again = refine(clear.image, conductor, found.survey, registered, start, clear.others, stages, found.track)
    if again is None or _hidden(again):
        narrow = narrowed(clear.image, conductor, registered, found, clear.others)
        if narrow is not None and (again is None or measured_share(narrow) > measured_share(again)):
            again = narrow
    if again is None or (_hidden(again) and not again.solution.converged):
        return None, clear.image
    again = replace(
        again,
        rival=found.rival,
        other=found.other,
        other_weight=found.other_weight,
        doubtful_load=found.doubtful_load,
    )
    return replace(completed(clear.image, conductor, registered, again, clear.others), unaided=again), clear.image
