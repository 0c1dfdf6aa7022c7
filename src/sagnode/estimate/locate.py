"""Locating the conductors of a span in one frame: each alone, then all together."""

from __future__ import annotations

from dataclasses import replace

from sagnode.capture.port import GreyImage
from sagnode.estimate.even import find_even
from sagnode.estimate.load import settle_loads
from sagnode.estimate.matched import (
    NOT_LOOKED_AT,
    STAGES,
    Matched,
    completed,
    looked_at,
    refine,
    remaining_stages,
    survey_of,
)
from sagnode.estimate.register import Registered
from sagnode.match.library import Shelf
from sagnode.match.masks import runs_near
from sagnode.site import Site


def locate(site: Site, image: GreyImage, registered: Registered, shelf: Shelf | None = None) -> dict[str, Matched]:
    """Find the measured conductors of a span, by id.

    Every conductor, those that are only known about included, is first found alone under an even load. Then the
    measured ones are compared: their swings, and what is left over, say whether the load of any may be uneven. Last,
    those that run close to another are refined once more with the others' curves masked, so that a neighbour cannot
    pull them.

    ``shelf`` holds the libraries that frames of the same burst have drawn before.
    """
    alone = {c.id: find_even(image, c, survey_of(c, registered), registered, shelf) for c in site.conductors}
    measured = [c for c in site.conductors if c.measured]
    evens = [(c, None if (even := alone[c.id]) is None else looked_at(image, even)) for c in measured]
    alone |= dict(zip((c.id for c in measured), settle_loads(image, registered, evens), strict=True))
    curves = {name: m.track.wires() for name, m in alone.items() if m is not None}
    found: dict[str, Matched] = {}
    for conductor in measured:
        first = alone[conductor.id]
        if first is None:
            continue
        others = [wire for name, wires in curves.items() if name != conductor.id for wire in wires]
        if runs_near(first.track, others, STAGES[-1].half_range_px):
            start, stages = first.solution.theta, remaining_stages(first)
            masked = refine(image, conductor, first.survey, registered, start, others, stages, first.track)
            if masked is not None:
                masked = replace(masked, rival=first.rival, doubtful_load=first.doubtful_load)
                masked = completed(image, conductor, registered, masked, others)
            first = masked
        if first is not None:
            found[conductor.id] = first if first.sighting is not NOT_LOOKED_AT else looked_at(image, first)
    return found
