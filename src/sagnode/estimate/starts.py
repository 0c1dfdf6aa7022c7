"""Where a wire under an uneven load may go on, by what is seen of it: curves under every kind of load at every swing.

The clear part of a wire fixes what a kind of load makes of the rest only along a line: swing, sag and share go
together. Curves along that line are compared with the picture; those that it shows most of are where to look closer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.joint import Solution, solve
from sagnode.estimate.matched import Matched
from sagnode.estimate.offsets import CurveObservations
from sagnode.estimate.refinement import STAGES
from sagnode.estimate.weigh import linear, stands
from sagnode.geometry.camera import FloatArray, project
from sagnode.geometry.conductor import gravity_direction, load_shapes, sag_profile
from sagnode.match.bundle import lines
from sagnode.match.ribbon import line_response, normals
from sagnode.match.track import mixed_samples
from sagnode.survey import LOAD, SAG, SWING, Survey

CLEAR_PX, CLEAR_GAP_PX, CLEAR_LEAST = 0.2, 100.0, 4
"""Blocks surer than this are the clear part of a wire, as far as no such gap divides them; so many at least."""
POSSIBLE = 10.0
"""Logarithm of the odds by which a kind of load may be less likely than the best and is still tried."""
BETWEEN = (-1 / 3, 0.0, 1 / 3)
"""Swings that are tried about each at which a solution stands, in shares of what lies between two."""
ASIDE = (-1.5, 0.0, 1.5)
"""What a kind of load leaves open at one swing is tried at these, in standard uncertainties."""
HELD = 0.1
"""How firmly the swing is held, in standard uncertainties of it."""
SAMPLES = 96
"""Samples along a curve at which it is compared with the picture."""
KEPT, COMPARED, APART_PX = 3, 200, 2.5
"""Starts that are kept, of so many curves that the picture shows most of, and how far apart they are somewhere."""


def starts(
    image: GreyImage, survey: Survey, seen: Matched, camera: CameraKnowledge, theta: FloatArray
) -> list[FloatArray]:
    """θ (28,) of the curves that the picture shows most of, none of which lies on one that comes before.

    Args:
        image: raw grey frame.
        survey: of the conductor under an uneven load.
        seen: what was seen of it under any.
        camera: what the landmarks say.
        theta: where to begin (28,).
    """
    clear = _clear(seen.offsets)
    if clear is None:
        return []
    broad = solve(survey, theta, camera, clear, STAGES[-1].iterations)
    if not broad.converged:
        return []
    tried = _tried(survey, stands(survey, broad, camera, clear, STAGES[-1].iterations))
    low, high = survey.sag_range
    tried = tried[(tried[:, SAG] > 0.8 * low) & (tried[:, SAG] < 1.2 * high)]
    if not len(tried):
        return []
    some = mixed_samples(seen.track, SAMPLES)
    curves = _curves(survey, tried, seen.track.t[some])
    place, side = lines(seen.track.members[:, some], seen.track.width[some])
    response = line_response(image, curves, normals(curves), place, side)
    # one more sample that shows nothing: a curve that is out of the frame is no good one
    scores = np.nansum(response, axis=1) / (np.isfinite(response).sum(axis=1) + 1)
    best = np.argsort(scores)[::-1][:COMPARED]
    kept: list[int] = []
    for k in best:
        apart = [
            np.abs(np.nan_to_num(np.sum((curves[k] - curves[o]) * normals(curves[o]), axis=1))).max() for o in kept
        ]
        if min(apart, default=APART_PX) >= APART_PX:
            kept.append(int(k))
        if len(kept) == KEPT:
            break
    return [tried[k] for k in kept]


def _tried(survey: Survey, found: Sequence[Solution]) -> FloatArray:
    """θ (N, 28) of the loads that are possible, by solutions at several swings, the first of which is free."""
    results, levels = [], []
    step = float(np.sqrt(found[0].covariance[SWING, SWING]))
    for one in found:
        for between in BETWEEN:
            # held firmly at a swing, so that what is left open there is what sag and load share
            own = replace(survey, swing_mean=float(one.theta[SWING]) + between * step, swing_u=HELD * step)
            logs, thetas, covariance = linear(own, one)
            # the swing's own prior in place of what held it there
            z = ((thetas[:, SWING] - survey.swing_mean) / survey.swing_u) ** 2
            held = ((thetas[:, SWING] - own.swing_mean) / own.swing_u) ** 2
            levels.append(logs + 0.5 * held - 0.5 * z)
            direction = covariance / np.sqrt(covariance[:, SAG, None])
            results.append(thetas[:, None] + np.array(ASIDE)[:, None] * direction[:, None])
    level = np.concatenate(levels)
    possible = np.concatenate(results)[level > level.max() - POSSIBLE]
    return np.asarray(possible.reshape(-1, possible.shape[-1]))


def _curves(survey: Survey, tried: FloatArray, t: FloatArray) -> FloatArray:
    """Pixels (N, T, 2) of curves θ (N, 28) at t (T,), the camera and the attachments as in the first."""
    shape = survey.shape(tried[0])
    chord = shape.far - shape.near
    span, rise = float(np.hypot(chord[0], chord[1])), float(chord[2])
    uneven = tried[:, LOAD] @ load_shapes(t, LOAD.stop - LOAD.start)
    depth = sag_profile(span, rise, tried[:, SAG], t) + tried[:, SAG, None] * uneven
    down = gravity_direction(shape.near, shape.far, tried[:, SWING])
    points = shape.near + t[:, None] * chord + depth[..., None] * down[:, None]
    return np.asarray(project(*survey.camera(tried[0]), points.reshape(-1, 3))[0].reshape(*points.shape[:2], 2))


def _clear(offsets: CurveObservations) -> CurveObservations | None:
    """The clear part of what was seen, from the near end on; None where there is hardly any."""
    use: NDArray[np.intp] = np.flatnonzero(offsets.sigma < CLEAR_PX)
    gap = np.flatnonzero(np.diff(offsets.arc[use]) > CLEAR_GAP_PX)
    use = use[: gap[0] + 1] if len(gap) else use
    if len(use) < CLEAR_LEAST:
        return None
    return replace(offsets.some(use), texture=None)
