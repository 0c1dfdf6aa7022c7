"""The paper's methods as the benchmarks run them: as printed, and with every help that sagnode could give them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from sagnode.capture.port import GreyImage
from sagnode.config.node import Measure, Method
from sagnode.config.span import Span
from sagnode.estimate.register import register
from sagnode.measurement import FrameMeasurement
from sagnode.pipeline import load_site
from sagnode.reference.matching import WHOLE_FRAME
from sagnode.reference.measure import PAPER, measure_by_reference
from sagnode.site import Site

METHODS: tuple[Method, ...] = ("paper-bezier", "cosh", "cosh-perspective")
PRINTED = replace(PAPER, whole_map=False)
"""Correlates around the anchor only: the scores of the whole map, as the tests say, a hundred times sooner."""
HELPED = replace(PRINTED, roi=WHOLE_FRAME, fictive_line=True)
"""Whole frame, and the lowest point of the Bézier curve looked for at mid-span in space."""


def by_paper(span: Span, image: GreyImage) -> Iterator[tuple[str, FrameMeasurement]]:
    """Measurements by each of the paper's methods: label and measurement.

    "as printed" takes the camera as surveyed, the top quadrants and B'(t) = 0. "helped" takes the camera as sagnode's
    landmarks show it in this very frame, the whole frame, and mid-span in space.
    """
    for method in METHODS:
        site = load_site(span, Measure(method=method))
        for measured in measure_by_reference(site, image, PRINTED):
            yield f"{method}, as printed", measured
        for measured in measure_by_reference(registered(site, image), image, HELPED):
            yield f"{method}, helped", measured


def registered(site: Site, image: GreyImage) -> Site:
    """The site with the camera as its landmarks show it in a frame; as surveyed where they are not recognised."""
    found, reasons = register(site, image)
    if reasons:
        return site
    intrinsics, pose = site.conductors[0].survey.camera(found.theta)
    return replace(site, intrinsics=intrinsics, pose=pose)
