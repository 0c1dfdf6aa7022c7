"""Figure 4: the six matching modes on the same edges, and what becomes of the search when nothing is anchored."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from paper.scenes import Trial
from sagnode.calibrate.undistort import undistort_image
from sagnode.config.node import Measure
from sagnode.geometry.camera import FloatArray
from sagnode.pipeline import load_site
from sagnode.reference.anchored import anchored_scores, draw_library
from sagnode.reference.library import Scene, bezier_library
from sagnode.reference.matching import MODES, TOP_QUADRANTS, Mode, Template, draw_template, edges, score_map
from sagnode.reference.measure import PAPER

ON_A_NEIGHBOUR_PX = 20.0
"""The upper wire starts some 60 px above the lower one."""


@dataclass(frozen=True)
class Prepared:
    """A trial's edges and its drawn templates."""

    trial: Trial
    scene: Scene
    library: list[Template]
    source: np.ndarray
    box: tuple[int, int, int, int]

    @classmethod
    def of(cls, trial: Trial, templates: int) -> Prepared:
        """Undistort, find edges, make the library of Bézier curves for the target."""
        site = load_site(trial.span, Measure(method="paper-bezier"))
        survey = next(c for c in site.conductors if c.id == trial.conductor).survey
        sags = np.linspace(*survey.sag_range, templates)
        scene = Scene(site.intrinsics.without_distortion(), site.pose, survey.near, survey.far, sags)
        box = TOP_QUADRANTS.box(trial.image.shape)
        left, top, right, bottom = box
        source = edges(undistort_image(site.intrinsics, trial.image)[top:bottom, left:right], *PAPER.canny)
        return cls(trial, scene, list(bezier_library(scene)), source, box)

    def curve(self, mode: Mode) -> tuple[FloatArray, FloatArray]:
        """Sags (M,) of the templates that fit, and each one's best score at its anchor (M,)."""
        drawn = draw_library(self.library, self.box)
        return self.scene.sags[drawn.index], anchored_scores(self.source, drawn, mode).max(axis=(1, 2))

    def error_cm(self, sag: float) -> float:
        """Of a sag, against the trial's."""
        return 100 * (sag - self.trial.truth["midspan_sag"])


@dataclass(frozen=True)
class ModeRow:
    """One matching mode over several pictures: errors of the chosen template, cm."""

    mode: Mode
    mean_abs_cm: float
    worst_cm: float
    near: int
    """Pictures in which the chosen template is within 1 cm of the truth."""
    pictures: int


def compare_modes(prepared: list[Prepared]) -> list[ModeRow]:
    """The six modes."""
    rows = []
    for mode in MODES:
        found = []
        for one in prepared:
            sags, scores = one.curve(mode)
            found.append(abs(one.error_cm(float(sags[int(np.argmax(scores))]))))
        rows.append(ModeRow(mode, float(np.mean(found)), max(found), sum(e < 1 for e in found), len(found)))
    return rows


def free_sweep(prepared: Iterable[Prepared], templates: int) -> tuple[int, int, list[float]]:
    """Search without the anchor: the best place of every template anywhere in the region.

    Returns:
        How many of the best matches start on another wire than the target, of how many, and how far from the anchor
        each of them starts, px.
    """
    away = []
    for one in prepared:
        left, top = one.box[:2]
        best, distance = -np.inf, 0.0
        every = max(1, len(one.library) // templates)
        for template in one.library[::every]:
            drawn, origin = draw_template(template.points)
            if drawn.shape[0] > one.source.shape[0] or drawn.shape[1] > one.source.shape[1]:
                continue
            scores = score_map(one.source, drawn, PAPER.mode)
            row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
            if scores[row, column] > best:
                best = float(scores[row, column])
                distance = float(np.hypot(*(np.array([column, row]) - (origin - np.array([left, top])))))
        away.append(distance)
    return sum(d > ON_A_NEIGHBOUR_PX for d in away), len(away), away
