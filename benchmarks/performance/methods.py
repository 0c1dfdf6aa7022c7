"""The methods that are timed, each as one call on one picture for one conductor."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import numpy as np

from performance.frames import Shot
from performance.stages import bound, replaced
from sagnode.calibrate.undistort import undistort_image
from sagnode.pipeline import measure_frame
from sagnode.reference.anchored import DrawnLibrary, anchored_scores, best_of, draw_library
from sagnode.reference.bezier import bezier_points
from sagnode.reference.library import Scene, bezier_library, perspective_library
from sagnode.reference.matching import Match, Roi, Template, anchored_score, draw_template, edges
from sagnode.reference.measure import PAPER
from sagnode.site import Site

POINTS = np.linspace(0.0, 1.0, 401)
LITERAL = ("Bézier", "cosh with perspective")
SEARCH, LIBRARY = "sagnode.match.search", "sagnode.match.library"
MOST = 30_000
"""Templates of one stretch of curve that the search can hold: OpenCV's pictures end at 32 767 columns."""


@dataclass
class Literal:
    """The paper's search, stage by stage; it leaves behind what it found and the seconds of CPU each stage took.

    The control points are given: how P1 is chosen the paper does not say, so that it costs nothing here.
    """

    shot: Shot
    method: str
    templates: int
    """Spread over the same range of sags as the paper's 300."""
    spent: dict[str, float] = field(default_factory=dict)
    scores: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.scene = paper_scene(self.shot, self.templates)
        self.controls = [t.control for t in bezier_library(self.scene) if t.control is not None]
        self.roi = smallest_roi(self.shot, self.scene)

    def __call__(self) -> Match | None:
        """Search one picture."""
        spent = dict.fromkeys(("undistort", "edges", "curve points", "draw", "matchTemplate"), 0.0)
        clock = time.process_time
        began = clock()
        flat = undistort_image(self.shot.site.intrinsics, self.shot.image)
        spent["undistort"] = clock() - began
        left, top, right, bottom = self.roi.box(flat.shape)
        began = clock()
        source = edges(flat[top:bottom, left:right], *PAPER.canny)
        spent["edges"] = clock() - began
        best: Match | None = None
        curves = self._curves()
        index = -1
        self.scores = []
        while True:
            began = clock()
            template = next(curves, None)
            spent["curve points"] += clock() - began
            if template is None:
                break
            index += 1
            began = clock()
            drawn, origin = draw_template(template.points)
            spent["draw"] += clock() - began
            began = clock()
            found = anchored_score(source, drawn, origin - np.array([left, top]), PAPER.mode)
            spent["matchTemplate"] += clock() - began
            self.scores.append(float("nan") if found is None else found[0])
            if found is not None and (best is None or found[0] > best.score):
                best = Match(template.moved(found[1].astype(float)), found[0], index)
        self.spent = spent
        return best

    def _curves(self) -> Iterator[Template]:
        if self.method == "Bézier":
            return (Template(bezier_points(control, POINTS), control) for control in self.controls)
        return perspective_library(self.scene)


@dataclass
class Anchored:
    """The same scores at the anchors only; the library is drawn beforehand, once for a pose."""

    shot: Shot
    templates: int

    def __post_init__(self) -> None:
        scene = paper_scene(self.shot, self.templates)
        self.roi = smallest_roi(self.shot, scene)
        self.library = list(bezier_library(scene))
        self.drawn = self.draw()

    def draw(self) -> DrawnLibrary:
        """Curve points and drawing: what a new pose costs."""
        fresh = [Template(bezier_points(t.control, POINTS), t.control) for t in self.library]
        return draw_library(fresh, self.roi.box(self.shot.image.shape))

    def source(self):
        """Edges of the region of the undistorted picture."""
        left, top, right, bottom = self.roi.box(self.shot.image.shape)
        flat = undistort_image(self.shot.site.intrinsics, self.shot.image)
        return edges(flat[top:bottom, left:right], *PAPER.canny)

    def __call__(self) -> Match | None:
        """Search one picture."""
        return best_of(self.library, self.drawn, self.source(), PAPER.mode)

    def scores(self) -> list[float]:
        """Best score of each template, in the library's order; NaN for those that do not fit."""
        result = np.full(len(self.library), np.nan)
        scores = anchored_scores(self.source(), self.drawn, PAPER.mode)
        result[self.drawn.index] = scores.max(axis=(1, 2))
        return [float(v) for v in result]


def paper_scene(shot: Shot, templates: int) -> Scene:
    """What the paper knows of the first measured conductor; the camera as surveyed."""
    survey = next(c for c in shot.site.conductors if c.measured).survey
    sags = np.linspace(*survey.sag_range, templates)
    return Scene(shot.site.intrinsics.without_distortion(), shot.site.pose, survey.near, survey.far, sags)


def smallest_roi(shot: Shot, scene: Scene) -> Roi:
    """The fewest quadrants in which every template lies: to look farther would only make the paper slower."""
    curves = [scene.visible(scene.near, scene.far, float(s)) for s in (scene.sags[0], scene.sags[-1])]
    points = np.concatenate([c for c in curves if c is not None])
    height, width = shot.image.shape
    low = points.min(axis=0) >= np.array([width // 2, height // 2]) + 2
    high = points.max(axis=0) < np.array([width // 2, height // 2]) - 2
    columns, rows = ((int(a), 1 if b else 2) for a, b in zip(low, high, strict=True))
    return Roi(rows=rows, columns=columns)


@dataclass
class Own:
    """sagnode's whole way of a frame for one conductor, with a coarse search of about so many templates."""

    shot: Shot
    templates: int

    def __post_init__(self) -> None:
        self.site = self.shot.alone()
        self.settings = search_settings(self.site, self.shot, self.templates)

    @contextmanager
    def prepared(self) -> Iterator[None]:
        """Inside, the search has that size."""
        with _search_of(*self.settings):
            yield

    def __call__(self):
        """Measure one picture; use inside :meth:`prepared`."""
        return measure_frame(self.site, self.shot.image)

    def scored(self) -> int:
        """How many templates the search compares with the picture."""
        with self.prepared():
            return _scored(self.site, self.shot)


@contextmanager
def _search_of(most: int, step_px: float) -> Iterator[None]:
    with ExitStack() as stack:
        stack.enter_context(replaced(LIBRARY, "MAX_TEMPLATES", most))
        stack.enter_context(replaced(LIBRARY, "STEP_PX", step_px))
        yield


def search_settings(site: Site, shot: Shot, wanted: int) -> tuple[int, float]:
    """MAX_TEMPLATES and STEP_PX of the search that make it score about ``wanted`` templates.

    The steps shrink where it would take fewer by itself; the limit, which widens the steps as it does in the product,
    then meets the number.
    """
    step = 2 * float(bound(LIBRARY, "STEP_PX")[1])
    count = 0
    while count < wanted:
        step /= 2
        with _search_of(MOST, step):
            count = _scored(site, shot)
    low, high = 4, MOST
    while high - low > 1:
        middle = (low + high) // 2
        with _search_of(middle, step):
            low, high = (middle, high) if _scored(site, shot) < wanted else (low, middle)
    return high, step


class _Counted(Exception):
    """The search has said how many templates it has scored."""


def _scored(site: Site, shot: Shot) -> int:
    """Templates, curves of one sag and swing, that the first search of a frame scores; no more of it is measured."""
    counts: list[int] = []

    def count(ranked, *_others):
        counts.append(ranked.size)
        raise _Counted

    with replaced(SEARCH, "_peaks", count):
        try:
            measure_frame(site, shot.image)
        except _Counted:
            return counts[0]
    raise RuntimeError("the search scored no template: its grid no longer goes through sagnode.match.search._peaks")
