"""Locating the conductors of a span in one frame: each alone, then all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class _Even:
    """The conductors of a span under an even load, by id.

    Attributes:
        first: each as it was found by itself, and beside those that were found on the same wire.
        found: each as it was found in the picture without the others that run near it.
        measured: those that are to be measured, each without the others; None where that never comes to rest.
        pictures: that each is measured in.
    """

    first: Mapping[str, Matched | None]
    found: Mapping[str, Matched | None]
    measured: Mapping[str, Matched | None]
    pictures: Mapping[str, GreyImage]

    @property
    def crowded(self) -> set[str]:
        """Those that only show where a neighbour runs: they are not told, and say nothing of loads."""
        return {name for name, own in self.measured.items() if own is None and self.found[name] is not None}


def locate(
    site: Site,
    image: GreyImage,
    registered: Registered,
    shelf: Shelf | None = None,
    shared: tuple[float, float] | None = None,
) -> dict[str, Matched]:
    """Find the measured conductors of a span, by id.

    Every conductor is found under an even load, those that are only known about included; then the loads of all are
    settled together, and each is measured under its own, clear of the others; last is asked what they say of each
    other.

    ``shelf`` holds the libraries that frames of the same burst have drawn before. ``shared`` is what neighbouring
    offsets share, px and relative to their own, where the frame itself cannot tell.
    """
    even = _under_even_loads(site, image, registered, shelf)
    settled = {**even.found, **_loads_settled(site, registered, even)}
    located = {c.id: _located(image, c, registered, even, settled) for c in site.conductors if c.measured}
    told = _with_its_neighbours({name: own for name, own in located.items() if own is not None})
    return _beside_each_other(site, image, registered, even, told, shared)


def _under_even_loads(site: Site, image: GreyImage, registered: Registered, shelf: Shelf | None) -> _Even:
    """Find each conductor alone, then beside the others, and measure it without them.

    Two that run so near each other that neither was found clearly are looked for as a pair; where two were found on one
    wire, one of them is looked for beside it. Those that run close to another are looked for and refined once more in
    the picture without the others, so that a neighbour cannot pull them, and all are completed.
    """
    every = site.conductors
    alone = {c.id: find_even(image, c, survey_of(c, registered), registered, shelf) for c in every}
    paired = pair_up(image, every, registered, sought_again(image, every, registered, alone, shelf), shelf)
    first = tell_apart(image, every, registered, paired, shelf)
    found = find_beside(image, every, registered, first, shelf)
    measured, pictures = _measured(image, [c for c in every if c.measured], registered, found)
    return _Even(first, found, measured, pictures)


def _loads_settled(site: Site, registered: Registered, even: _Even) -> dict[str, Matched | None]:
    """The measured conductors that are not crowded, under the loads that their swings and misfits leave them."""
    doubted: list[tuple[SiteConductor, Matched | None]] = []
    for conductor in site.conductors:
        if conductor.measured and conductor.id not in even.crowded:
            own = even.measured[conductor.id]
            doubted.append((conductor, own and looked_at(even.pictures[conductor.id], own)))
    settled = settle_loads(even.pictures, registered, doubted)
    return {conductor.id: own for (conductor, _), own in zip(doubted, settled, strict=True)}


def _located(
    image: GreyImage,
    conductor: SiteConductor,
    registered: Registered,
    even: _Even,
    settled: Mapping[str, Matched | None],
) -> Matched | None:
    """A conductor under its load, measured anew where the others have moved since; None where it is not found."""
    own, picture = settled[conductor.id], even.pictures[conductor.id]
    before = {name: even.measured.get(name) or match for name, match in even.found.items() if name != conductor.id}
    if own is not None and conductor.id in even.crowded:
        own = _crowded(picture, own)
    elif own is not None and (own.survey.load_u or _outdated(own, before, settled)):
        own, picture = _among_others(image, conductor, registered, settled)
        own = own and looked_at(picture, own)
    if own is not None and is_wire(own) and not own.survey.load_u:
        return own
    # where two were found on one wire, and nothing beside it, or only under a load that bends one of them elsewhere,
    # the wire is there, and either may hang on it
    return _on_one(image, even.first[conductor.id], even.found, conductor) or own


def _beside_each_other(
    site: Site,
    image: GreyImage,
    registered: Registered,
    even: _Even,
    located: Mapping[str, Matched],
    shared: tuple[float, float] | None,
) -> dict[str, Matched]:
    """Located conductors with what they say of each other.

    Those that could as well be each other are marked. What the others say of the wind makes surer what a picture
    leaves open, and what hangs evenly is solved for once more with its offsets as uncertain as all that is known by
    then leaves them; what would need a wind of its own is marked.
    """
    known = {c.id: even.found[c.id] for c in site.conductors if not c.measured}
    clear = {name: None if own.crowded else own for name, own in located.items()}
    doubtful = exchangeable(site.conductors, registered, known | clear)
    marked = {name: replace(own, or_of=doubtful.get(name, "")) for name, own in located.items()}
    measured = [c for c in site.conductors if c.measured]
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
