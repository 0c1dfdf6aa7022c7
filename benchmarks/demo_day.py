"""The demonstration's day: sagnode on every frame, the paper's methods on some, against the truth beside the frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import cv2

from paper import Timing, by_paper, timings
from sagnode.capture.images import read_grey
from sagnode.config.load import load_span
from sagnode.config.span import Span
from sagnode.pipeline import load_site, measure_burst
from sagnode.scene.site import site_directory
from sagnode.scene.truth import read_truth
from sagnode.site import Site
from tally import Outcome, outcome

PAPER_EVERY = 16
"""The paper's methods see every so many frames: seconds for each conductor."""
GROUP = "demo day"


def frames_of_the_day() -> list[Path]:
    """The rendered frames that have their truth beside them, in their order in time."""
    found = [p.with_suffix(suffix) for p in site_directory().rglob("*.json") for suffix in (".jpg", ".png")]
    return sorted((p for p in found if p.exists()), key=lambda p: p.name)


def demo_span() -> Span:
    """The demonstration's survey."""
    return load_span(site_directory() / "span.toml").span


def measure_day(frames: Sequence[Path], jobs: int) -> Iterator[Outcome]:
    """Sagnode's own method on all frames, in their order."""
    yield from _on_each(_frame_by_sagnode, frames, jobs)


def measure_day_by_paper(frames: Sequence[Path], jobs: int) -> Iterator[Outcome]:
    """The paper's methods, as printed and helped, in the order of the frames."""
    yield from _on_each(_frame_by_paper, frames, jobs)


def _on_each(function: Callable[[Path], list[Outcome]], frames: Sequence[Path], jobs: int) -> Iterator[Outcome]:
    # spawned, since a fork does not survive the threads that OpenCV may have started here
    with ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn")) as pool:
        for outcomes in pool.map(function, frames):
            yield from outcomes


def time_of_a_frame(file: Path) -> list[Timing]:
    """How long one frame of the day takes."""
    return timings(demo_span(), read_grey(file), file.stem)


@lru_cache(maxsize=1)
def _site() -> Site:
    return load_site(demo_span())


def _frame_by_sagnode(file: Path) -> list[Outcome]:
    cv2.setNumThreads(1)
    truth = read_truth(file).conductors
    return [
        outcome(GROUP, file.stem, 0, measured, truth[measured.conductor])
        for measured in measure_burst(_site(), [read_grey(file)])
    ]


def _frame_by_paper(file: Path) -> list[Outcome]:
    cv2.setNumThreads(1)
    truth = read_truth(file).conductors
    return [
        outcome(GROUP, file.stem, 0, measured, truth[measured.conductor], label)
        for label, measured in by_paper(demo_span(), read_grey(file))
    ]
