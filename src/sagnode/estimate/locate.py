"""Locating the conductors of a span in one frame: each alone, then all together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.conclude import conclude
from sagnode.estimate.even import find_even
from sagnode.estimate.exchange import exchangeable
from sagnode.estimate.identity import tell_apart
from sagnode.estimate.load import settle_loads
from sagnode.estimate.matched import Matched, is_wire, looked_at, measured_share
from sagnode.estimate.refinement import STAGES, completed, narrowed, refine, remaining_stages, survey_of
from sagnode.estimate.register import Registered
from sagnode.match.library import Shelf
from sagnode.match.masks import runs_near
from sagnode.site import Site, SiteConductor

BESIDE = 0.5
"""Share of a conductor's blocks that others hide, looked at with the usual range, from which a narrow look is tried."""


def locate(
    site: Site,
    image: GreyImage,
    registered: Registered,
    shelf: Shelf | None = None,
    shared: tuple[float, float] | None = None,
) -> dict[str, Matched]:
    """Find the measured conductors of a span, by id.

    Every conductor, those that are only known about included, is first found alone under an even load. Where two were
    found on one wire, one of them is looked for beside it. Those that run close to another are refined once more with
    the others' curves masked, so that a neighbour cannot pull them, and all are completed. Then they are compared:
    their swings, and what is left over, say whether the load of any may be uneven; what is followed under an uneven
    load is kept clear of the others likewise. Last, those that could as well be each other are marked, and what hangs
    evenly is solved for once more with its offsets as uncertain as all that is known by then leaves them.

    ``shelf`` holds the libraries that frames of the same burst have drawn before. ``shared`` is what neighbouring
    offsets share, px and relative to their own, where the frame itself cannot tell.
    """
    alone = {c.id: find_even(image, c, survey_of(c, registered), registered, shelf) for c in site.conductors}
    alone = tell_apart(image, site.conductors, registered, alone, shelf)
    measured = [c for c in site.conductors if c.measured]
    evens = {c.id: _among_others(image, c, registered, alone) for c in measured}
    # one that only shows where a neighbour runs is not told, and says nothing of loads
    crowded = {name for name, even in evens.items() if even is None and alone[name] is not None}
    asked = [c for c in measured if c.id not in crowded]
    doubted = [(c, found and looked_at(image, found)) for c in asked for found in [evens[c.id]]]
    settled = dict(zip((c.id for c in asked), settle_loads(image, registered, doubted), strict=True))
    together = alone | settled
    located: dict[str, Matched] = {}
    for conductor in measured:
        found = together[conductor.id]
        if found is not None and conductor.id in crowded:
            found = looked_at(image, found)
            found = replace(found, crowded=True) if is_wire(found) else None
        elif found is not None and found.survey.load_u:
            found = _among_others(image, conductor, registered, together)
            found = found and looked_at(image, found)
        if found is not None:
            located[conductor.id] = found
    known = {c.id: alone[c.id] for c in site.conductors if not c.measured}
    clear = {name: None if found.crowded else found for name, found in located.items()}
    doubtful = exchangeable(site.conductors, registered, known | clear)
    last = conclude(located, registered, shared)
    return {name: replace(found, or_of=doubtful.get(name, "")) for name, found in last.items()}


def _hidden(found: Matched) -> bool:
    """Whether others hide most of a conductor."""
    return float(np.mean(found.observed.masked)) > BESIDE


def _among_others(
    image: GreyImage, conductor: SiteConductor, registered: Registered, all_found: dict[str, Matched | None]
) -> Matched | None:
    """A conductor as it is measured where it is clear of the others; None where it is not."""
    found = all_found[conductor.id]
    if found is None:
        return None
    neighbours = [m.track for name, m in all_found.items() if m is not None and name != conductor.id]
    others = [wire for track in neighbours for wire in track.wires()]
    clear = found
    if runs_near(found.track, others, STAGES[-1].half_range_px):
        start, stages = found.solution.theta, remaining_stages(found)
        masked = refine(image, conductor, found.survey, registered, start, others, stages, found.track)
        if masked is None or _hidden(masked):
            narrow = narrowed(image, conductor, registered, found, others)
            if narrow is not None and (masked is None or measured_share(narrow) > measured_share(masked)):
                masked = narrow
        if masked is None or (_hidden(masked) and not masked.solution.converged):
            return None
        clear = replace(
            masked,
            rival=found.rival,
            other=found.other,
            other_weight=found.other_weight,
            doubtful_load=found.doubtful_load,
        )
    else:
        others = []
    return replace(completed(image, conductor, registered, clear, others), unaided=clear)
