"""A conductor of the demonstration's span as it is found in a picture along the line."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sagnode.config.load import load_span
from sagnode.estimate.even import find_even
from sagnode.estimate.matched import Matched, looked_at
from sagnode.estimate.refinement import completed, survey_of
from sagnode.estimate.register import register
from sagnode.pipeline import load_site
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.site import demo_site, site_directory
from sagnode.scene.spec import Moment
from sagnode.site import Site, SiteConductor

HIDDEN_FROM = 0.2
"""Share of the span beyond which the wire is painted over."""
SAG_M = 8.0


class Found(NamedTuple):
    site: Site
    conductor: SiteConductor
    match: Matched


@cache
def demo_picture() -> NDArray[np.uint8]:
    """The demonstration's span."""
    scene = demo_site().scene
    wires = {c.id: WireState(SAG_M, 0.0) for c in scene.surveyed.conductors}
    return render(scene, Moment(wires, seed=8)).image


@cache
def along_the_line(*, hidden: bool = False) -> Found:
    """The demonstration's conductor L2 as it is found, the far part of it painted over with what is behind it."""
    scene = demo_site().scene
    wires = {c.id: WireState(SAG_M, 0.0) for c in scene.surveyed.conductors}
    site = load_site(load_span(site_directory() / "span.toml").span)
    conductor = next(c for c in site.conductors if c.id == "L2")
    image = demo_picture()
    if hidden:
        without = render(scene, Moment({n: w for n, w in wires.items() if n != conductor.id}, seed=8)).image
        match = along_the_line().match
        far = match.track.pixels[match.track.t > HIDDEN_FROM]
        image = painted(image, without, far)
    registered, reasons = register(site, image)
    assert not reasons, reasons
    before = find_even(image, conductor, survey_of(conductor, registered), registered)
    assert before is not None
    match = replace(completed(image, conductor, registered, before, []), unaided=before)
    return Found(site, conductor, looked_at(image, match))


def painted(image: NDArray[np.uint8], other: NDArray[np.uint8], places: NDArray[np.float64]) -> NDArray[np.uint8]:
    result = image.copy()
    for u, v in places.astype(int):
        result[max(v - 8, 0) : v + 9, max(u - 8, 0) : u + 9] = other[max(v - 8, 0) : v + 9, max(u - 8, 0) : u + 9]
    return result


def of_blocks_alone(match: Matched, blocks: NDArray[np.bool_]) -> Matched:
    """As if of all blocks (M,) only these had shown the wire."""
    usable = match.observed.usable
    kept = blocks[usable]
    solution = replace(match.solution, residual=match.solution.residual[kept])
    observed = replace(match.observed, usable=usable & blocks)
    return replace(match, observed=observed, solution=solution, offsets=match.offsets.some(kept))
