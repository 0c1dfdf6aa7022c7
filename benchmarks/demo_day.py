"""The demonstration's day: sagnode on every frame, the paper's methods on some, against the truth beside the frames."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from sagnode.capture.images import read_grey
from sagnode.capture.port import GreyImage
from sagnode.config.load import load_span
from sagnode.config.node import Measure, Method
from sagnode.pipeline import load_site, measure_burst
from sagnode.reference.matching import TOP_QUADRANTS, WHOLE_FRAME
from sagnode.reference.measure import PAPER, measure_by_reference
from sagnode.scene.site import site_directory
from sagnode.scene.truth import read_truth
from sagnode.site import Site
from tally import Outcome, outcome

PAPER_METHODS: tuple[Method, ...] = ("paper-bezier", "cosh", "cosh-perspective")
PAPER_EVERY = 6
"""The paper's methods see every so many frames: a second and more for each conductor."""


@dataclass(frozen=True)
class Timing:
    """Seconds for one frame with all its conductors; the least of the repeats."""

    method: str
    seconds: float
    frame: str


def frames_of_the_day() -> list[Path]:
    """The rendered frames that have their truth beside them, in their order in time."""
    found = [p.with_suffix(suffix) for p in site_directory().rglob("*.json") for suffix in (".jpg", ".png", ".pgm")]
    return sorted((p for p in found if p.exists()), key=lambda p: p.name)


def demo_site_for(method: Method) -> Site:
    """The demonstration's site as the pipeline loads it."""
    return load_site(load_span(site_directory() / "span.toml").span, Measure(method=method))


def measure_day(frames: Sequence[Path]) -> list[Outcome]:
    """Sagnode's own method on all frames."""
    site = demo_site_for("rational-bezier")
    results = []
    for file in frames:
        truth = read_truth(file)
        results += [
            outcome("demo day", file.stem, 0, measured, truth.conductors[measured.conductor])
            for measured in measure_burst(site, [read_grey(file)])
        ]
    return results


def measure_by_paper(frames: Sequence[Path]) -> list[Outcome]:
    """The paper's methods, in its top quadrants and in the whole frame.

    Around the anchor only, which gives the scores of the whole correlation map (see the tests).
    """
    results = []
    for method in PAPER_METHODS:
        site = demo_site_for(method)
        for file in frames:
            truth = read_truth(file)
            image = read_grey(file)
            for roi, where in ((TOP_QUADRANTS, "top quadrants"), (WHOLE_FRAME, "whole frame")):
                settings = replace(PAPER, roi=roi, whole_map=False)
                for measured in measure_by_reference(site, image, settings):
                    label = f"{method}, {where}"
                    results.append(
                        outcome("demo day", file.stem, 0, measured, truth.conductors[measured.conductor], label)
                    )
    return results


def timings(frame: Path, repeats: int = 5) -> list[Timing]:
    """One thread, one frame, all conductors: sagnode through the pipeline, and the paper's literal whole maps."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        image = read_grey(frame)
        result = [Timing("rational-bezier", _least("rational-bezier", image, repeats), frame.stem)]
        result += [Timing(method, _least(method, image, 1), frame.stem) for method in PAPER_METHODS]
    finally:
        cv2.setNumThreads(threads)
    return result


def _least(method: Method, image: GreyImage, repeats: int) -> float:
    site = demo_site_for(method)
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        measure_burst(site, [image])
        seconds.append(time.perf_counter() - start)
    return min(seconds)
