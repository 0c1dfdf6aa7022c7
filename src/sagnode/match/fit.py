"""One conductor between two points of any photograph: nothing is known of camera, span or survey.

The way of a fit: arcs between the two points are scored on a map of oriented lines (``fit_search``), the best are
followed from coarse to fine (``fit_follow``), judged against their own neighbourhood (``fit_judge``), and the best of
them is refined to sub-pixel (``fit_refine``). What does not stand out, is hidden for the most part, or has an equal
elsewhere is refused with its reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.fit_curve import Curve
from sagnode.match.fit_follow import LEVEL_PX, follow, pyramid
from sagnode.match.fit_judge import Verdict, gaps, judge
from sagnode.match.fit_refine import Refined, refine
from sagnode.match.fit_search import search
from sagnode.quality import Cause, Reason

SLACK_PX = 2.0
CANDIDATES = 10
JUDGED = 3


@dataclass(frozen=True)
class Fit:
    """One candidate, followed, refined and judged (pixels of the frame)."""

    curve: Curve
    refined: Refined
    verdict: Verdict
    total: float


def candidates(image: GreyImage, anchors: FloatArray, slack: float) -> list[Fit]:
    """The best few arcs, followed, refined and judged; best first."""
    chord = float(np.linalg.norm(anchors[1] - anchors[0]))
    arcs = search(image, anchors[0], anchors[1], CANDIDATES)
    arcs = [arc for arc in arcs if arc.score > 0.6 * arcs[0].score]
    if not arcs:
        return []
    pictures = pyramid(image, [arc.curve for arc in arcs], max(1.0, chord / LEVEL_PX))
    followed: list[tuple[float, Curve]] = []
    for arc in arcs:
        curve, total = arc.curve, 0.0
        for level, picture in enumerate(pictures):
            curve, total = follow(picture, curve, anchors, slack, level)
        if all(_apart(curve, other) > 1.0 for _, other in followed):
            followed.append((total, curve))
    followed.sort(key=lambda one: -one[0])
    finest = pictures[-1]
    fits = []
    for total, curve in followed[:JUDGED]:
        here = curve.moved(finest.origin)
        verdict = judge(finest.grey, here)
        refined = refine(finest.grey, here, verdict.kernels, anchors - finest.origin, slack)
        fits.append(Fit(refined.curve.moved(-finest.origin), refined, verdict, total))
    return sorted(fits, key=lambda fit: -fit.verdict.strength)


def _apart(one: Curve, other: Curve) -> float:
    """Root mean square distance of two curves between the same points, px."""
    difference = one.evenly(17)[1] - other.evenly(17)[1]
    return float(np.sqrt((difference**2).sum(axis=1).mean()))
