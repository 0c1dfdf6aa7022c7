"""The way of a frame, top to bottom: look at it, register the camera, match and refine, solve, judge.

``measure_burst`` is what the worker, ``sagnode measure``, the benchmarks and the tests call. It is a pure function of a
:class:`sagnode.site.Site` and pictures. Undistortion is no pass of its own: curves are distorted point by point on
their way into the raw frame, which is exact and touches only the pixels that are needed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from math import isfinite

from sagnode.capture.port import GreyImage
from sagnode.estimate.combine import combine_burst
from sagnode.estimate.explain import explain
from sagnode.estimate.judge import borne_out, look
from sagnode.estimate.locate import locate
from sagnode.estimate.register import register
from sagnode.estimate.tell import refused, tell
from sagnode.geometry.quantities import POSSIBLE_TEMPERATURES_C
from sagnode.match.appearances import Appearances
from sagnode.match.library import Shelf
from sagnode.measurement import ConductorMeasurement, FrameMeasurement
from sagnode.reference.measure import measure_by_reference
from sagnode.site import Site, load_site

__all__ = ["load_site", "measure_burst", "measure_frame"]


def measure_burst(site: Site, images: Iterable[GreyImage], kept: Appearances = ()) -> list[ConductorMeasurement]:
    """One reading of every measured conductor from the frames (height, width) uint8 of one burst.

    ``kept``: further appearances of the site's landmarks, where a node has learnt some. Each picture is asked for when
    the one before it is measured and let go, so that those who read them one by one need room for one only.
    """
    measure = partial(measure_frame, site, kept=kept, shelf=Shelf())
    # a loop's variable would hold a picture while the next one is read
    return combine_burst(list(map(measure, images)))


def measure_frame(
    site: Site, image: GreyImage, kept: Appearances = (), shelf: Shelf | None = None
) -> list[FrameMeasurement]:
    """Measure every conductor of the span in one frame.

    ``shelf`` holds the template libraries that frames before this one have drawn; no frame hands on anything it shows.
    """
    # explain: where something is refused, is it the lens, fog or night?
    return explain(site, image, _measured(site, image, kept, shelf))


def _measured(site: Site, image: GreyImage, kept: Appearances, shelf: Shelf | None) -> list[FrameMeasurement]:
    # look: can anything be seen at all?
    reasons = look(site, image)
    if reasons:
        return refused(site, reasons)
    if site.method != "rational-bezier":
        # the paper's matchers know no landmarks and no uncertainty; they are here to be compared with
        return measure_by_reference(site, image)
    # register: where is the camera now?
    registered, reasons = register(site, image, kept)
    if reasons:
        return refused(site, reasons, registered)
    # match and refine, then solve: every conductor, known neighbours included
    located = locate(site, image, registered, shelf)
    # tell: the numbers and how sure they are, where the judgement lets them be told
    told = [tell(site, c, registered, located.get(c.id)) for c in site.conductors if c.measured]
    return borne_out([_without_impossible(frame) for frame in told])


def _without_impossible(frame: FrameMeasurement) -> FrameMeasurement:
    """Without a conductor temperature that no conductor can have: the stringing data it comes from are wrong."""
    temperature = frame.estimates.get("conductor_temp")
    low, high = POSSIBLE_TEMPERATURES_C
    if temperature is None or (low <= temperature.value <= high and isfinite(temperature.u)):
        return frame
    estimates = {stem: value for stem, value in frame.estimates.items() if stem != "conductor_temp"}
    budget = {stem: parts for stem, parts in frame.budget.items() if stem != "conductor_temp"}
    return replace(frame, estimates=estimates, budget=budget)
