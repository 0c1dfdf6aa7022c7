"""Locating the conductors of a span in one frame: each alone, then all together."""

from __future__ import annotations

from dataclasses import replace

from sagnode.capture.port import GreyImage
from sagnode.estimate.load import APART_ODDS, even_or_not, find, hangs_apart
from sagnode.estimate.matched import NOT_LOOKED_AT, STAGES, Matched, looked_at, refine
from sagnode.estimate.register import Registered
from sagnode.match.refine import runs_near
from sagnode.site import Site


def locate(site: Site, image: GreyImage, registered: Registered) -> dict[str, Matched]:
    """Find the measured conductors of a span, by id.

    Every conductor, those that are only known about included, is first found alone; then those that run close to
    another are refined once more with the others' curves masked, so that a neighbour cannot pull them.
    """
    alone = {c.id: find(image, c, registered) for c in site.conductors}
    for conductor in site.conductors:
        match = alone[conductor.id]
        if match is not None and conductor.measured and hangs_apart(match, [m for m in alone.values() if m]):
            alone[conductor.id] = even_or_not(image, conductor, registered, match, APART_ODDS)
    curves = {name: m.track.wires() for name, m in alone.items() if m is not None}
    found: dict[str, Matched] = {}
    for conductor in site.conductors:
        first = alone[conductor.id]
        if first is None or not conductor.measured:
            continue
        others = [wire for name, wires in curves.items() if name != conductor.id for wire in wires]
        if runs_near(first.track, others, STAGES[-1].half_range_px):
            masked = refine(image, conductor, first.survey, registered, first.solution.theta, others, STAGES[1:])
            first = None if masked is None else replace(masked, rival=first.rival)
        if first is not None:
            found[conductor.id] = first if first.sighting is not NOT_LOOKED_AT else looked_at(image, first)
    return found
