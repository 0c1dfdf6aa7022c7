"""One conductor between two points of any photograph: nothing is known of camera, span or survey.

The way of a fit: arcs between the two points are scored on a map of oriented lines (``search``), the best are
followed from coarse to fine (``follow``), judged against their own neighbourhood (``judge``), and refined to
sub-pixel (``refine``); where the best of them is neither surely a wire nor surely none, so are arcs between points a
little aside. The best is the answer if it can be seen along enough of its length; what does not stand out, is hidden
for the most part, or has an equal elsewhere is refused with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.fit.curve import Curve, apart
from sagnode.fit.follow import LEVEL_PX, Picture, follow, pyramid
from sagnode.fit.judge import Verdict, judge
from sagnode.fit.refine import Refined, refine, seen_share
from sagnode.fit.search import Candidate as Arc
from sagnode.fit.search import search
from sagnode.geometry.camera import FloatArray
from sagnode.quality import Cause, Reason

SLACK_PX = 2.0
"""Standard uncertainty of a point clicked on a wire, px."""
SHORTEST_PX = 40.0
"""A chord shorter than this holds too few blocks to tell a wire from chance."""
FEWEST_POINTS = 60
CANDIDATES = 5
FEWEST = 3
JUDGED = 3
"""How many arcs are taken over from the map, how many at least are followed, and how many are judged."""
CLEAR_SHARE = 0.8
"""An arc along which so much of a wire is seen ends the search for others, once the fewest were followed."""
HOPELESS, CLEAR = -6.0, 3.0
"""Log-odds of the best curve between which the map is searched again: for arcs through points"""
ASIDE = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))
"""so many standard uncertainties aside of the first and the second one given. A fine wire a few pixels off those, or
one that no arc follows, can be missed from one pair of points and found from another."""
LIKELY_SHARE = 0.5
"""An arc along which so much is seen is tried again in parallel through the points, if it misses them."""
LONGEST_END = 0.3
"""Greatest share at either end in which no wire is seen: beyond it the curve is a guess."""
CLOSE = 3.0
"""Log-odds by which a curve may fail and still be called a conductor of which too little is seen."""
EQUAL = 0.7
"""Difference of log-odds below which two curves are equally good."""
USUAL_WEIGHT = 1.1
APART_PX = 3.0
"""Distance at which two curves are two wires and not one."""
DARK_GREY = 12
FLAT_GREY = 3
SEEN_IF_THERE = 0.92
"""Probability that a block with an unhidden wire is sure of it; from rendered wires on sky, clouds and trees."""
CHANGE = 0.05
"""Probability that the wire vanishes or comes back from one block to the next."""


@dataclass(frozen=True)
class FitResult:
    """A curve in the picture, or why there is none.

    Attributes:
        found: whether there is a curve; without one the arrays are empty.
        reasons: why not; empty if found.
        control_points: of the rational quadratic Bézier (3, 2), px.
        weights: of the control points (3,), the outer two 1.
        points: equally spaced along the curve, ends included (>= 50, 2), px. Where ``kind`` says so they depart slowly
            from the Bézier, as the wire does; they are then the better description.
        confidence: probability that the wire can be seen at each point, 0..1, shape of ``points`` (N,).
        score: robust z of the curve among the same curve shifted aside; 0 without a candidate.
        residual_px: root mean square distance of the wire from the curve where it is seen.
        visible_share: share of the curve along which the wire is seen.
        kind: "rational-quadratic-bezier", or with "+departure".
    """

    found: bool
    reasons: tuple[Reason, ...]
    control_points: FloatArray
    weights: FloatArray
    points: FloatArray
    confidence: FloatArray
    score: float
    residual_px: float
    visible_share: float
    kind: str = "rational-quadratic-bezier"


@dataclass(frozen=True)
class Candidate:
    """One arc, followed, refined and judged; its curve in pixels of the frame."""

    curve: Curve
    refined: Refined
    verdict: Verdict
    off_anchors: float
    """Distance of its ends from the points given, in standard uncertainties of these."""

    @property
    def share(self) -> float:
        """Share of its blocks that show the wire."""
        return float(self.refined.sure.mean())

    @property
    def odds(self) -> float:
        """Logarithm of the odds that this is the wire meant and not a chain of chances; 0 where it is believed.

        A logistic regression over curves found between the ends of wires and between random points of pictures, sky,
        trees, hills and buildings; coefficients rounded, those of the weight eased for cameras on the line itself.
        """
        refined, sure = self.refined, np.append(self.refined.fraction[self.refined.sure], 0.5)
        unseen = max(sure.min(), 1 - sure.max()) if refined.sure.any() else 0.5
        odd = math.log(self.curve.weight / USUAL_WEIGHT)
        return (
            12.0 * (float(refined.alone.mean()) - 0.67)
            - 5.0 * (min(refined.residual_px, 1.0) - 0.25)
            - (5.0 * odd if odd > 0 else -8.0 * odd)
            + 1.7 * math.log(max(self.verdict.score, 0.5) / 8.0)
            + 1.5 * math.log(min(len(refined.sure), 60) / 50.0)
            - 0.8 * max(self.off_anchors - 1.5, 0.0)
            - 5.0 * max(float(unseen) - 0.1, 0.0)
        )


def fit_between(
    image: GreyImage, start: tuple[float, float], end: tuple[float, float], slack_px: float = SLACK_PX
) -> FitResult:
    """Fit one curve to the conductor that passes near two pixels.

    Args:
        image: 8-bit grey picture (height, width).
        start: pixel (u, v) near one end of the stretch; may lie a little outside the picture.
        end: pixel (u, v) near the other end.
        slack_px: standard uncertainty of the two points.

    Returns:
        The curve, or a refusal with its reasons.
    """
    anchors = np.array([start, end], dtype=np.float64)
    chord = float(np.hypot(*(anchors[1] - anchors[0])))
    if not chord >= SHORTEST_PX:
        text = f"the two points are {chord:.0f} px apart; give points at least {SHORTEST_PX:.0f} px apart"
        return refusal(Reason(Cause.TOO_LITTLE_VISIBLE, text))
    ranked = candidates(image, anchors, slack_px)
    if not ranked:
        return refusal(_nothing(image, anchors))
    best = ranked[0]
    reason = _doubt(image, anchors, best) or _rival(best, ranked[1:])
    if reason is not None:
        return refusal(reason, best.verdict.score, best.share)
    count = max(FEWEST_POINTS, min(400, math.ceil(best.curve.length() / 8)))
    _, points = best.curve.evenly(count)
    seen = visibility(best.refined.sure, best.refined.by_chance)
    return FitResult(
        found=True,
        reasons=(),
        control_points=best.curve.control,
        weights=np.array([1.0, best.curve.weight, 1.0]),
        points=points,
        confidence=np.interp(np.linspace(0, 1, count), best.refined.fraction, seen),
        score=best.verdict.score,
        residual_px=best.refined.residual_px,
        visible_share=best.share,
        kind="rational-quadratic-bezier" + ("+departure" if len(best.curve.departure) else ""),
    )


def refusal(reason: Reason, score: float = 0.0, share: float = 0.0) -> FitResult:
    """A result without a curve."""
    none = np.empty((0, 2))
    empty = np.empty(0)
    return FitResult(False, (reason,), none, empty, none, empty, score, math.inf, share)


def candidates(image: GreyImage, anchors: FloatArray, slack: float) -> list[Candidate]:
    """The best few arcs near the anchors (2, 2), followed, judged and refined; best first."""
    found = _followed(image, anchors, slack, search(image, anchors[0], anchors[1], slack, CANDIDATES))
    across = (anchors[1] - anchors[0])[::-1] * (-1.0, 1.0)
    across *= slack / float(np.linalg.norm(across))
    for first, last in ASIDE:
        if not found or not HOPELESS < found[0].odds < CLEAR:
            break
        near = anchors + np.array([[first], [last]]) * across
        found += _followed(image, anchors, slack, search(image, near[0], near[1], slack, CANDIDATES))
        found.sort(key=lambda one: -one.odds)
    return found


def _followed(image: GreyImage, anchors: FloatArray, slack: float, arcs: Sequence[Arc]) -> list[Candidate]:
    """Some arcs of a search, the best first, followed, judged and refined; best first."""
    if not arcs:
        return []
    chord = float(np.linalg.norm(anchors[1] - anchors[0]))
    pictures = pyramid(image, [arc.curve for arc in arcs], max(1.0, chord / LEVEL_PX))
    followed: list[tuple[Curve, float]] = []
    for number, arc in enumerate(arcs):
        curve = follow(pictures[0], arc.curve, anchors, slack, 0)
        followed.append((curve, seen_share(pictures[0], curve)))
        if number + 1 >= FEWEST and max(share for _, share in followed) > CLEAR_SHARE:
            break
    followed += _parallels(pictures[0], followed, anchors, slack)
    finest = pictures[-1]
    found = []
    for coarse in _worth(followed, anchors, slack):
        curve = coarse
        for level, picture in enumerate(pictures[1:], start=1):
            curve = follow(picture, curve, anchors, slack, level)
        here = curve.moved(finest.origin)
        verdict = judge(finest.grey, here)
        refined = refine(finest.grey, here, verdict.kernels, anchors - finest.origin, slack)
        final = refined.curve.moved(-finest.origin)
        off = float(np.linalg.norm(final.evenly(2)[1] - anchors) / slack)
        found.append(Candidate(final, refined, verdict, off))
    return sorted(found, key=lambda one: -one.odds)


def _worth(followed: list[tuple[Curve, float]], anchors: FloatArray, slack: float) -> list[Curve]:
    """The few followed curves that are worth judging: those that show much of a wire near to the points."""

    def missed(curve: Curve) -> float:
        return float(np.linalg.norm(curve.control[[0, 2]] - anchors)) / slack

    weighed = [(curve, share - 0.05 * max(missed(curve) - 1.5, 0.0)) for curve, share in followed]
    return [curve for curve, _ in _distinct(weighed, 1.0)[:JUDGED]]


def _parallels(
    picture: Picture, followed: list[tuple[Curve, float]], anchors: FloatArray, slack: float
) -> list[tuple[Curve, float]]:
    """The curves that parallel a good one which misses the points: its neighbour may be the wire that was meant."""
    good = _distinct(followed, 1.0)[:2]
    found = []
    for curve, share in good:
        miss = anchors - curve.control[[0, 2]]
        if share > LIKELY_SHARE and np.abs(miss).max() > slack:
            moved = curve.control + np.stack([miss[0], miss.mean(axis=0), miss[1]])
            neighbour = follow(picture, replace(curve, control=moved), anchors, slack, 0)
            found.append((neighbour, seen_share(picture, neighbour)))
    return found


def _distinct(curves: list[tuple[Curve, float]], apart_px: float) -> list[tuple[Curve, float]]:
    """Curves with their totals, best first, without those that lie on a better one."""
    kept: list[tuple[Curve, float]] = []
    for curve, total in sorted(curves, key=lambda one: -one[1]):
        if all(apart(curve, other) > apart_px for other, _ in kept):
            kept.append((curve, total))
    return kept


def visibility(sure: NDArray[np.bool_], by_chance: float) -> FloatArray:
    """Probability (M,) that the wire can be seen in each block, from which blocks are sure of it.

    Two states, seen and hidden, that rarely change from block to block: the forward-backward recursion.
    """
    chance = float(np.clip(by_chance, 0.05, 0.5))
    likelihood = np.where(sure[:, None], [SEEN_IF_THERE, chance], [1 - SEEN_IF_THERE, 1 - chance])
    move = np.array([[1 - CHANGE, CHANGE], [CHANGE, 1 - CHANGE]])
    forward = np.empty_like(likelihood)
    backward = np.ones_like(likelihood)
    state = np.array([0.5, 0.5])
    for index, here in enumerate(likelihood):
        state = (state if index == 0 else state @ move) * here
        state = state / state.sum()
        forward[index] = state
    for index in range(len(likelihood) - 2, -1, -1):
        state = move @ (likelihood[index + 1] * backward[index + 1])
        backward[index] = state / state.sum()
    both = forward * backward
    return np.asarray(both[:, 0] / both.sum(axis=1))


def _doubt(image: GreyImage, anchors: FloatArray, best: Candidate) -> Reason | None:
    """Why the best candidate is no conductor, or too little of one."""
    where = best.refined.fraction[best.refined.sure]
    if len(where) and best.odds > -CLOSE:
        for name, missing in (("first", where[0]), ("second", 1 - where[-1])):
            if missing > LONGEST_END:
                text = f"no line is seen along the {missing:.0%} next to the {name} point; move it to where one is"
                return Reason(Cause.TOO_LITTLE_VISIBLE, text)
    if best.odds > 0:
        return None
    if best.odds > -CLOSE and best.share > 0.5:
        text = f"a line is seen along {best.share:.0%} of the curve, too little to be sure of it; choose clearer points"
        return Reason(Cause.TOO_LITTLE_VISIBLE, text)
    return _nothing(image, anchors, best.share)


def _rival(best: Candidate, others: list[Candidate]) -> Reason | None:
    """Another curve that keeps apart from the best, is as near to the points, and as well seen where it is apart."""
    for other in others:
        between = best.curve.evenly(65)[1][None] - other.curve.evenly(65)[1][:, None]
        distance = np.sqrt((between**2).sum(axis=2)).min(axis=1)
        apart = np.interp(other.refined.fraction, np.linspace(0, 1, 65), distance) > APART_PX
        there = np.interp(best.refined.fraction, other.refined.fraction, apart.astype(float)) > 0.5
        if apart.mean() < 0.4 or not there.any() or other.odds < max(0.0, best.odds - EQUAL):
            continue
        if other.refined.sure[apart].mean() > best.refined.sure[there].mean() - 0.05:
            text = f"two lines {np.median(distance):.0f} px apart fit the two points equally well"
            return Reason(Cause.AMBIGUOUS, f"{text}; set the points onto one of them")
    return None


def _nothing(image: GreyImage, anchors: FloatArray, share: float = 0.0) -> Reason:
    """No line: because the picture is too dark or flat there, or because there is none."""
    height, width = image.shape
    low = np.clip(np.floor(anchors.min(axis=0)) - 20, 0, (width - 2, height - 2)).astype(int)
    high = np.clip(np.ceil(anchors.max(axis=0)) + 20, low + 2, (width, height)).astype(int)
    darkest, brightest = np.percentile(image[low[1] : high[1], low[0] : high[0]], [1, 99])
    if brightest < DARK_GREY:
        return Reason(Cause.DARK, f"the picture is dark between the points ({brightest:.0f} of 255); expose longer")
    if brightest - darkest < FLAT_GREY:
        text = f"the picture is flat between the points ({darkest:.0f} to {brightest:.0f} of 255); nothing can be seen"
        return Reason(Cause.LOW_CONTRAST, text)
    seen = f"the best line is seen along {share:.0%} of its length" if share else "no line leads from one to the other"
    return Reason(Cause.NO_CONDUCTOR, f"no conductor stands out between the points: {seen}; check the two points")


def draw_fit(image: GreyImage, result: FitResult) -> NDArray[np.uint8]:
    """The picture (height, width, 3; BGR) with the curve beside which one can see the wire.

    Two thin lines run a few pixels either side of the wire, green where it is seen and fading to red where not; rings
    mark the ends. A key stands at the top, or the reason where nothing was found.
    """
    canvas = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    scale = max(0.5, image.shape[1] / 1600)
    if not result.found:
        words = "; ".join(f"{reason.cause}: {reason.text}" for reason in result.reasons)
        _write(canvas, words, scale)
        return canvas
    tangent = np.gradient(result.points, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    gap, line = 6.0 * scale, max(1, round(scale))
    for side in (-gap, gap):
        track = np.round((result.points + side * normal) * 16).astype(np.int32)
        for index in range(len(track) - 1):
            sure = float(result.confidence[index : index + 2].mean())
            colour = (40, round(60 + 180 * sure), round(240 - 200 * sure))
            cv2.line(canvas, track[index].tolist(), track[index + 1].tolist(), colour, line, cv2.LINE_AA, 4)
    for point in (result.points[0], result.points[-1]):
        at = np.round(point * 16).astype(np.int32).tolist()
        cv2.circle(canvas, at, round(16 * 9 * scale), (0, 220, 255), line, cv2.LINE_AA, 4)
    key = "the wire is between the two lines; green: seen   red: not seen   rings: its ends"
    _write(canvas, f"visible {result.visible_share:.0%}, residual {result.residual_px:.2f} px", scale)
    _write(canvas, key, scale, row=2)
    return canvas


def _write(canvas: NDArray[np.uint8], words: str, scale: float, row: int = 1) -> None:
    """One row of text from the top, never smaller than can be read."""
    size = max(0.45, 0.5 * scale)
    line = round(42 * size)
    for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), max(1, round(1.2 * size)))):
        cv2.putText(
            canvas, words, (round(20 * size), row * line), cv2.FONT_HERSHEY_SIMPLEX, size, colour, thick, cv2.LINE_AA
        )
