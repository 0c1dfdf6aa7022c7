"""Whether two conductors could have changed places: each may hang on the wire that was taken for the other's.

Seen from the side, conductors beside each other are pictured as lines a few pixels apart, and a little more sag of the
one makes up for a little less of the other. What tells them apart are the attachments, and the sags that are possible;
where neither does, there are two answers, and none of them may be told. That one conductor is not found at all makes no
difference: its wire may be the one that the other was found on. If of that one hardly anything shows, it may even have
been followed along both, and what misfits say of it proves nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sagnode.estimate.joint import solve
from sagnode.estimate.matched import Matched, is_wire, shown_share, visible_share
from sagnode.estimate.offsets import CurveObservations
from sagnode.estimate.refinement import survey_of, view_of
from sagnode.estimate.register import Registered
from sagnode.geometry.camera import FloatArray
from sagnode.match.robust import median
from sagnode.match.templates import SAMPLES, View, even_parameters
from sagnode.match.track import Track, trace
from sagnode.site import SiteConductor
from sagnode.survey import ATTACHMENTS, LOAD, SAG, SWING, Survey

WORSE = 25.0
"""By how much more the misfit of two conductors in each other's places must be for that to be excluded: odds of
exp(25/2), or one in 270 000, if offsets erred as they say."""
CERTAIN_SHARE = 0.5
"""Share of a span that must be seen of a conductor for its wire not to be another's: with less it may lie across
several, and each of them be free for others."""
HARDLY_SHOWN = 0.5
"""Share of the blocks below which what shows of a conductor proves nothing against one that could be there as well and
was not found: it may have been followed along both, here the one and there the other."""
TRIES = 4
"""Steps by which a conductor's curve approaches another wire."""
FAR_PX, NEAR_PX = 40.0, 6.0
"""A typical distance from the wire beyond which no curve of a conductor lies on it: as its first step foretells, and
after the last. Attachments and swing, which are not tried here, move curves by less."""
STEP = 0.02
"""Of sag, by which that step is found, relative."""
COMPARED = 12
"""Offsets that are compared until a curve is near."""
ROUNDS, ITERATIONS = 3, 8


def exchangeable(
    conductors: Sequence[SiteConductor], registered: Registered, found: Mapping[str, Matched | None]
) -> dict[str, str]:
    """Which measured conductors could as well be others, and the others they could be, by id.

    Of ``found`` what lies on no wire is taken for not found. One of which little was measured may have been followed
    along anything, and to be on some wire is no proof that it is not on another's.
    """
    seen = {c.id: each for c in conductors for each in [found.get(c.id)] if each is not None and _shows(each)}
    settled = {name for name, each in seen.items() if _certain(each)}
    surveys = {c.id: survey_of(c, registered) for c in conductors}
    misfits: dict[tuple[str, str], float] = {}

    def misfit(conductor: SiteConductor, wire: str) -> float:
        key = (conductor.id, wire)
        if key not in misfits:
            misfits[key] = _misfit_on(conductor, surveys[conductor.id], registered, seen[wire])
        return misfits[key]

    result: dict[str, str] = {}
    for own, other in permutations(conductors, 2):
        if not own.measured or own.id not in seen or own.id in result:
            continue
        # the other one on this one's wire, and this one on the other's or on a wire that nobody has found
        wires = [(other, own)] + [(own, other)] * (other.id in settled)
        if all(misfit(one, there.id) < np.inf for one, there in wires):
            worse = sum(misfit(one, there.id) - misfit(there, there.id) for one, there in wires)
            hardly = other.id not in seen and shown_share(seen[own.id]) < HARDLY_SHOWN
            if hardly or worse < WORSE:
                result[own.id] = other.id
    return result


def _shows(match: Matched) -> bool:
    return match.solution.converged and (is_wire(match) or not len(match.sighting.seen))


def _certain(match: Matched) -> bool:
    """Whether enough of a conductor was measured to say on which wire it hangs."""
    return not len(match.sighting.seen) or visible_share(match) >= CERTAIN_SHARE


def _misfit_on(conductor: SiteConductor, survey: Survey, registered: Registered, wire: Matched) -> float:
    """Misfit of a conductor under an even load on the offsets of a wire; infinite where it cannot come near it."""
    theta = registered.theta.copy()
    theta[ATTACHMENTS], theta[LOAD] = 0.0, 0.0
    theta[SAG], theta[SWING] = np.clip(wire.solution.theta[SAG], *survey.sag_range), wire.solution.theta[SWING]
    if not _approach(conductor, survey, theta, wire.offsets):
        return np.inf
    misfit, u = np.inf, 0.0
    for _ in range(ROUNDS):
        track = trace(view_of(survey, conductor, theta), float(theta[SAG]), float(theta[SWING]))
        if track is None:
            return np.inf
        solution = solve(survey, theta, registered.camera, _offsets_from(track, wire.offsets), ITERATIONS)
        theta, misfit, u = solution.theta, solution.misfit, float(np.sqrt(solution.covariance[SAG, SAG]))
    low, high = survey.sag_range
    return misfit if low - 3 * u <= theta[SAG] <= high + 3 * u else np.inf


def _approach(conductor: SiteConductor, survey: Survey, theta: FloatArray, wire: CurveObservations) -> bool:
    """Bring the sag in ``theta`` to where the conductor's curve lies on a wire; whether there is such a place."""
    low, high = survey.sag_range
    view, swing = view_of(survey, conductor, theta), float(theta[SWING])
    some = np.unique(np.linspace(0, len(wire.t) - 1, COMPARED).astype(np.intp))
    about = _About.of(wire.measured[some], wire.normal[some])
    for number in range(TRIES):
        before = float(theta[SAG])
        here, there = (_aside(view, sag, swing, about) for sag in (before, (1 + STEP) * before))
        both = np.isfinite(here) & np.isfinite(there)
        if np.mean(both) < 0.5:
            return False
        here, slope = here[both], (there - here)[both] / (STEP * theta[SAG])
        wanted = theta[SAG] - float(slope @ here) / max(float(slope @ slope), 1e-12)
        left = np.abs(here + slope * (wanted - theta[SAG]))
        if number == 0 and median(left) > FAR_PX:
            return False
        theta[SAG] = min(max(wanted, 0.9 * low), 1.1 * high)
        if theta[SAG] == before:
            # where it does not move, it stays
            break
    left = np.abs(_aside(view, float(theta[SAG]), swing, about))
    return bool(np.mean(left < NEAR_PX) > 0.5)


class _About(NamedTuple):
    """Some points of the picture.

    Attributes:
        axes: normals and tangents there (2, M, 2).
        places: the points along those (2, M, 1), px.
    """

    axes: FloatArray
    places: FloatArray

    @classmethod
    def of(cls, points: FloatArray, normal: FloatArray) -> _About:
        """Points (M, 2) and the normals there (M, 2)."""
        axes = np.stack([normal, normal[:, ::-1] * (1.0, -1.0)])
        return cls(axes, np.sum(axes * points, axis=2, keepdims=True))


def _aside(view: View, sag: float, swing: float, about: _About) -> FloatArray:
    """How far a curve lies aside of some points, px along their normals (M,); NaN where it does not reach."""
    t = even_parameters(view, sag, swing, SAMPLES)
    if len(t) < 2:
        return np.full(about.axes.shape[1], np.nan)
    across, along = about.axes @ view.pixels(sag, swing, t)[0].T - about.places
    # where the curve crosses the normal nearest to the point
    crossing = np.where(along[:, 1:] * along[:, :-1] <= 0, np.abs(across[:, 1:]), np.inf)
    first = np.argmin(crossing, axis=1)
    rows = np.arange(len(first))
    before, after = along[rows, first], along[rows, first + 1]
    share = before / np.where(before == after, 1.0, before - after)
    aside = (1 - share) * across[rows, first] + share * across[rows, first + 1]
    return np.where(np.isfinite(crossing[rows, first]), aside, np.nan)


def _nearest(track: Track, points: FloatArray) -> NDArray[np.intp]:
    """Samples of a track nearest to some points (M, 2)."""
    coarse = max(1, len(track.t) // 200)
    some = track.pixels[::coarse]
    first = np.argmin(((some[None] - points[:, None]) ** 2).sum(axis=2), axis=1) * coarse
    around = np.clip(first[:, None] + np.arange(-coarse, coarse + 1), 0, len(track.t) - 1)
    distance = ((track.pixels[around] - points[:, None]) ** 2).sum(axis=2)
    nearest: NDArray[np.intp] = around[np.arange(len(points)), np.argmin(distance, axis=1)]
    return nearest


def _offsets_from(track: Track, wire: CurveObservations) -> CurveObservations:
    """A wire's offsets as those from another curve."""
    nearest = _nearest(track, wire.measured)
    order = np.argsort(track.arc[nearest], kind="stable")
    nearest = nearest[order]
    turned = np.sign(np.sum(track.normal[nearest] * wire.normal[order], axis=1, keepdims=True))
    return CurveObservations(
        t=track.t[nearest],
        arc=track.arc[nearest],
        normal=track.normal[nearest],
        measured=wire.measured[order],
        sigma=wire.sigma[order],
        shading=None if wire.shading is None else turned * wire.shading[order],
    )
