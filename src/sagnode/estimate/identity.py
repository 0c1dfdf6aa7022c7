"""Which wire is whose: two conductors of a span that were found on one and the same wire."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.even import find_apart, merit
from sagnode.estimate.matched import Matched, looked_at, may_be_wire
from sagnode.estimate.refinement import survey_of
from sagnode.estimate.register import Registered
from sagnode.match.library import Shelf
from sagnode.match.masks import Neighbour, near_another
from sagnode.site import SiteConductor

TOGETHER_PX = 2.0
"""Curves that are nearer to each other than this lie on the same wire there."""
CONTESTED = 0.25
"""Share of a curve from which two that lie together mean the same wire; wires that only meet before the far tower do so
over much less."""


def tell_apart(
    image: GreyImage,
    conductors: Sequence[SiteConductor],
    registered: Registered,
    found: Mapping[str, Matched | None],
    shelf: Shelf | None = None,
) -> dict[str, Matched | None]:
    """The same, where two lie on one wire: each of them is looked for beside it, and the better pair of wires is kept.

    Where nothing lies beside it for either of them, both stay where they are.
    """
    told = dict(found)
    for one, other in combinations(conductors, 2):
        first, second = told[one.id], told[other.id]
        if first is None or second is None or not _contested(first, second):
            continue
        aside_one = find_apart(image, one, survey_of(one, registered), registered, _wires(second), shelf)
        aside_other = find_apart(image, other, survey_of(other, registered), registered, _wires(first), shelf)
        ways: list[tuple[Matched, Matched]] = []
        if aside_one is not None and _lies_on_something(image, aside_one):
            ways.append((aside_one, second))
        if aside_other is not None and _lies_on_something(image, aside_other):
            ways.append((first, aside_other))
        if ways:
            told[one.id], told[other.id] = max(ways, key=lambda pair: merit(pair[0]) + merit(pair[1]))
    return told


def _lies_on_something(image: GreyImage, aside: Matched) -> bool:
    """Whether a curve beside a wire lies on another: one on nothing must not drive away what lies on that wire."""
    return may_be_wire(looked_at(image, aside))


def _contested(one: Matched, other: Matched) -> bool:
    """Whether two conductors lie on one wire."""
    together = (near_another(a.track, b.track, TOGETHER_PX) for a, b in ((one, other), (other, one)))
    return max(float(np.mean(near)) for near in together) > CONTESTED


def _wires(match: Matched) -> list[Neighbour]:
    return [Neighbour(wire) for wire in match.track.wires()]
