"""How likely landmarks agree on one movement of the camera by chance, in a picture that shows none of them.

A patch finds something like itself in most pictures, and with several such places for every landmark some sets of them
lie as one movement would have put them. What is expected of chance is the number of such sets: over all choices of k
landmarks out of n and of places for them, times the probability that the places fit. Two places fix a shift, turn and
scale, which must be one that a camera makes; each further one then falls into its circle by chance with the share that
the circle has of the window. Where that number is not small, an agreement proves nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import comb, exp, log, pi, sqrt

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import Intrinsics
from sagnode.match.patches import Patch, Peak, correlations
from sagnode.match.turning import ComplexArray, as_turns

LEAST_BASELINE_PX = 50.0
"""Distance of two landmarks below which they cannot tell turn and scale."""
MOST_SCALED, MOST_TURNED = 0.05, 0.15
"""Greatest change of scale, and turn (rad), of a camera that still looks at the same thing."""
CHANCE_MAX = 1e-4
"""Expected number of chance agreements from which one is not believed."""
LEAST_RADIUS_PX = 0.7
"""Places are whole pixels: two of them agree by no less than this."""
LEAST_CHANCE = 1e-3
"""A likeness counts no more than this: things of the same make are more alike than chance knows."""


def is_chance(
    frame: GreyImage,
    patches: Sequence[Patch | None],
    options: Sequence[Sequence[Peak]],
    chosen: Mapping[int, Peak],
    reach_px: float,
    lens: Intrinsics,
) -> bool:
    """Whether landmarks may agree as they do in a picture that shows none of them.

    Of fewer than three landmarks nobody can tell, and nothing is said against them.

    Args:
        frame: the picture.
        patches: of all landmarks.
        options: places that each of them might be at.
        chosen: the place of each of those that agree.
        reach_px: how far from their clicks they were searched.
        lens: of the camera.
    """
    if not chosen or sum(patch is not None for patch in patches) < 3:
        return False
    places = {i: own for i in chosen if (own := patches[i]) is not None}
    offered = {i: float(len(options[i])) for i in places}
    if expected_by_chance(patches, places, chosen, offered, reach_px, lens) <= CHANCE_MAX:
        return False
    # few agree: how many places as much alike would chance have offered?
    alike = {i: min(offered[i], chance_places(frame, patch, chosen[i], reach_px)) for i, patch in places.items()}
    return expected_by_chance(patches, places, chosen, alike, reach_px, lens) > CHANCE_MAX


def expected_by_chance(
    patches: Sequence[Patch | None],
    places: Mapping[int, Patch],
    chosen: Mapping[int, Peak],
    offered: Mapping[int, float],
    reach_px: float,
    lens: Intrinsics,
) -> float:
    """Expected number of sets of landmarks that agree as closely by chance.

    Args:
        patches: of all landmarks.
        places: those that agree, with their patches.
        chosen: where they are.
        offered: how many places chance offers each of them.
        reach_px: how far from their clicks they were searched.
        lens: of the camera.
    """
    apart = _apart(places)
    clicked = np.array([places[i].pixel for i in apart])
    moved = as_turns(lens, clicked, np.array([chosen[i][:2] for i in apart]))
    window = (2 * reach_px + 1) ** 2
    # what fits the others by less is pulled towards them by the fit
    radius = max(LEAST_RADIUS_PX, 2 * _misfit(*moved))
    longest = max(LEAST_BASELINE_PX, float(np.max(np.hypot(*(clicked[:, None] - clicked).transpose(2, 0, 1)))))
    likely_pair = min(1.0, 4 * MOST_SCALED * MOST_TURNED * longest**2 / window)
    fits = min(1.0, pi * radius**2 / window)
    total = sum(patch is not None for patch in patches)
    ways = log(comb(total, len(apart))) + sum(log(offered[i]) for i in apart)
    return exp(ways + (log(likely_pair) if len(apart) > 1 else 0.0) + max(0, len(apart) - 2) * log(fits))


def chance_places(frame: GreyImage, patch: Patch, peak: Peak, reach_px: float) -> float:
    """Expected number of places in a patch's window that are at least as much like it, in a random picture.

    Fisher's transform of a correlation is nearly Gaussian; how far it scatters over the window, and how fast it changes
    from one place to the next, is seen in the window itself. Above a high level u a Gaussian field of N places has
    about ``N √det Λ (2π)^(-3/2) u exp(-u²/2)`` summits, Λ being the covariance of its derivatives.
    """
    score = correlations(frame, patch, reach_px)[0]
    if min(score.shape) < 3:
        return 1.0
    field = np.arctanh(np.clip(score, -0.99, 0.99))
    # quartiles: the summit that is asked about must not make the field look rougher
    low, high = np.percentile(field, (25.0, 75.0))
    deviation = max(float(high - low) / 1.349, 1e-3)
    level = float(np.arctanh(min(peak[2], 0.99))) / deviation
    slopes = [float(np.mean(np.diff(field, axis=axis) ** 2)) / deviation**2 for axis in (0, 1)]
    summits = score.size * sqrt(slopes[0] * slopes[1]) * (2 * pi) ** -1.5 * max(level, 1.0) * exp(-0.5 * level**2)
    return float(max(summits, LEAST_CHANCE))


def _apart(places: Mapping[int, Patch]) -> list[int]:
    """Landmarks whose patches share no pixel: two that do are found by the same things, and agree for that alone."""
    kept: list[int] = []
    for i, patch in places.items():
        side = patch.image.shape[0]
        if all(float(np.max(np.abs(patch.pixel - places[k].pixel))) >= side for k in kept):
            kept.append(i)
    return kept


def _misfit(place: ComplexArray, turn: ComplexArray) -> float:
    """Greatest distance (px) of some places in the plane, turned so, from the similarity that fits all of them best."""
    start, end = place - place.mean(), place + turn
    end = end - end.mean()
    factor = np.vdot(start, end) / max(float(np.vdot(start, start).real), 1e-9)
    return float(np.max(np.abs(end - factor * start)))
