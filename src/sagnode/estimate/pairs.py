"""Two conductors that run a few pixels beside each other and that neither was found without the other.

Each of them is clutter to the other: it lies within the background that a block is compared with, so that the plainest
wire stands out from nothing. Together they are a pattern of two lines, as a bundle is, that stands out like any wire.
What the pattern finds is near enough for either to be taken out and the other one to be measured without it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.beside import CLEAR_SHARE, on_one_wire, without
from sagnode.estimate.even import candidates_of, start_of
from sagnode.estimate.joint import solve
from sagnode.estimate.matched import Matched, shown_share
from sagnode.estimate.refinement import MAX_BLOCKS, STAGES, mixed_response, offsets_of, survey_of, view_of
from sagnode.estimate.register import Registered
from sagnode.geometry.camera import FloatArray
from sagnode.match.library import Shelf
from sagnode.match.peel import aside
from sagnode.match.refine import observe
from sagnode.match.ribbon import normals
from sagnode.match.robust import median
from sagnode.match.templates import even_parameters
from sagnode.match.track import Track, trace
from sagnode.site import SiteConductor
from sagnode.survey import SAG, SWING

CANDIDATES = 4
"""Of each conductor that are paired with those of others."""
APART_PX = (2.0, 12.0)
"""Typical distance of two curves that are a pair: nearer ones are one line, farther ones are found one by one."""
BESIDE_SHARE = 0.8
"""Share of a curve beside which another must run to make a pattern with it."""
REACH_PX = 2 * APART_PX[1]
"""Distance within which another curve runs beside one."""
SAGS = 12
"""Of those that a conductor may have, that are tried for whether it could run beside another."""
SAMPLES = 60
"""Places along a curve at which the distance to another is worked out."""
ROUNDS, TRIES = 2, 6
"""Rounds of looking for each beside the other, and ways to pair candidates that are tried."""
NEARLY_CLEAR = 0.5
"""Share of the blocks that must show a pattern for it to be looked at once more."""
STILL_SHOWN = 0.75
"""Share of what two conductors showed when each was found by itself that they must show as a pair. It is not all: two
that were found on the plainer of two wires show that one twice."""

Place = tuple[SiteConductor, FloatArray, Track]
"""A conductor, its θ (28,) and its curve there."""
Start = tuple[float, FloatArray, Track]
"""Score of a candidate, its θ (28,) and its curve."""


def pair_up(
    image: GreyImage,
    conductors: Sequence[SiteConductor],
    registered: Registered,
    found: Mapping[str, Matched | None],
    shelf: Shelf | None = None,
) -> dict[str, Matched | None]:
    """The same, those that were not found clearly as pairs where they are such, the likeliest pairs first.

    Args:
        image: raw grey frame.
        conductors: all of the span.
        registered: the camera.
        found: each as it was found by itself.
        shelf: libraries that were drawn before.
    """
    told = dict(found)
    clear = {name: own for name, own in told.items() if own is not None and _is_clear(own)}
    on_one = {name for pair in combinations(clear, 2) if on_one_wire(*(clear[name] for name in pair)) for name in pair}
    clear = {name: own for name, own in clear.items() if name not in on_one}
    lost = [c for c in conductors if c.id not in clear]
    pairs = [pair for pair in combinations(lost, 2) if _may_run_beside(*pair, registered)]
    if not pairs:
        return told
    picture = without(image, None, list(clear.values())).image
    starts = {c.id: _starts(picture, c, registered, shelf) for pair in pairs for c in pair}
    ways = [
        (a[0] + b[0], one, other, a, b)
        for one, other in pairs
        for a, b in product(starts[one.id], starts[other.id])
        if APART_PX[0] <= _apart(a[2], b[2]) <= APART_PX[1]
    ]
    paired: set[str] = set()
    for _, one, other, a, b in sorted(ways, key=lambda way: -way[0])[:TRIES]:
        both = one.id, other.id
        if not paired.isdisjoint(both):
            continue
        pair = _found(picture, registered, (one, *a[1:]), (other, *b[1:]))
        if pair is not None and _shows(pair) >= STILL_SHOWN * _shows(found[name] for name in both):
            paired.update(both)
            told[one.id], told[other.id] = pair
    return told


def _shows(conductors: Iterable[Matched | None]) -> float:
    """What the curves of some conductors respond together, grey levels."""
    return sum(own.response for own in conductors if own is not None)


def _is_clear(own: Matched | None) -> bool:
    return own is not None and own.solution.converged and shown_share(own) >= CLEAR_SHARE


def _may_run_beside(one: SiteConductor, other: SiteConductor, registered: Registered) -> bool:
    """Whether a conductor, whatever its sag, could run beside another one's curve of middle sag."""
    theta = registered.theta
    views = [view_of(survey_of(c, registered), c, theta) for c in (one, other)]
    middle = float(np.mean(other.survey.sag_range))
    t = even_parameters(views[1], middle, 0.0, SAMPLES)
    if len(t) < 2:
        return False
    pixels, _ = views[1].pixels(middle, 0.0, t)
    across = normals(pixels)
    every = np.linspace(0.0, 1.0, SAMPLES)
    curves = (views[0].pixels(float(sag), 0.0, every)[0] for sag in np.linspace(*one.survey.sag_range, SAGS))
    curves = (curve[np.isfinite(curve).all(axis=1)] for curve in curves)
    return any(np.isfinite(aside(pixels, across, curve, REACH_PX)[0]).mean() > BESIDE_SHARE for curve in curves)


def _starts(picture: GreyImage, conductor: SiteConductor, registered: Registered, shelf: Shelf | None) -> list[Start]:
    survey = survey_of(conductor, registered)
    view = view_of(survey, conductor, registered.theta)
    starts = []
    for candidate in candidates_of(picture, conductor, survey, view, shelf, CANDIDATES):
        track = trace(view, candidate.sag, candidate.swing)
        if track is not None:
            starts.append((candidate.score, start_of(registered, candidate), track))
    return starts


def _apart(one: Track, other: Track) -> float:
    """Typical distance of two curves, px; infinite where they hardly run beside each other."""
    _, distance = _beside(one, other)
    known = np.isfinite(distance)
    return median(np.abs(distance[known])) if known.mean() > BESIDE_SHARE else np.inf


def _beside(one: Track, other: Track) -> tuple[FloatArray, FloatArray]:
    """Places along a track (K,), px, and how far aside of it another one is there, px; NaN where that is too far."""
    some = np.unique(np.linspace(0, len(one.t) - 1, SAMPLES).astype(np.intp))
    return one.arc[some], aside(one.pixels[some], one.normal[some], other.pixels, REACH_PX)[0]


def _found(picture: GreyImage, registered: Registered, one: Place, other: Place) -> tuple[Matched, Matched] | None:
    """Two conductors near some places, each by the pattern that it makes with the other; None without a pattern."""
    pair, found = [one, other], list[Matched]()
    for k in ROUNDS * (0, 1):
        again = _in_pattern(picture, registered, pair[k], pair[1 - k][2])
        if again is None or shown_share(again) < NEARLY_CLEAR:
            return None
        pair[k] = pair[k][0], again.solution.theta, again.track
        found.append(again)
    first, second = found[-2:]
    clear = _is_clear(first) and _is_clear(second) and _apart(first.track, second.track) >= APART_PX[0]
    return (first, second) if clear else None


def _in_pattern(image: GreyImage, registered: Registered, place: Place, other: Track) -> Matched | None:
    """A conductor near a place by the last stage of a refinement, looked for together with a curve beside it."""
    conductor, theta, own = place
    stage, survey = STAGES[-1], survey_of(conductor, registered)
    places, distance = _beside(own, other)
    known = np.isfinite(distance)
    if not known.mean() > BESIDE_SHARE:
        return None
    distance = np.interp(own.arc, places[known], distance[known])
    # the wires of a bundle lie about its middle, nearly alike all along
    wires = [distance + float(np.mean(offset)) for offset in other.members]
    pattern = replace(own, members=np.concatenate([own.members, wires]))
    block_px = max(stage.block_px, float(own.arc[-1]) / MAX_BLOCKS)
    observed = observe(image, pattern, stage.half_range_px, [], block_px, stage.shifts, stage.run)
    if int(observed.usable.sum()) < 4:
        return None
    offsets = offsets_of(observed, bent=False)
    solution = solve(survey, theta, registered.camera, offsets, stage.iterations)
    view = view_of(survey, conductor, solution.theta)
    track = trace(view, float(solution.theta[SAG]), float(solution.theta[SWING]))
    if track is None:
        return None
    return Matched(survey, solution, view, track, observed, offsets, mixed_response(image, track))
