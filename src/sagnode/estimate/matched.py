"""A conductor as it was found in a frame, and what can be said of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.estimate.joint import Solution
from sagnode.estimate.load_kinds import any_single
from sagnode.estimate.offsets import CurveObservations
from sagnode.estimate.unexcluded import Loads
from sagnode.geometry.camera import FloatArray
from sagnode.match.refine import Observed
from sagnode.match.sight import Sighting, sight
from sagnode.match.standing import chance_of
from sagnode.match.templates import View
from sagnode.match.track import Track
from sagnode.survey import ATTACHMENTS, LOAD, SAG, SWING, Survey

SCORE_MIN = 8.0
"""Robust z-score over the shifted curves from which a wire is proven,"""
CHANCE_MAX = 1e-8
"""or this chance of so many windows standing out: one in ten thousand, though the search chose among as many curves. A
faint wire that crosses sky and trees stands out everywhere, but in their mean the trees drown it."""
LIKELY_CHANCE = 1e-4
"""The same chance of a curve that is worth taking for a wire until more is known: with others still in the picture, it
cannot stand out from all the curves beside it."""
SUPPORT_MIN = 0.30
"""Least share of the curve in view that must stand out; a window does so by chance once in twenty."""
MEASURED_PX = 0.8
"""A block that is surer than this, and lies nearer to the curve, shows the wire there."""
SURELY = 0.05
"""Chance that a block looked at texture below which it surely shows the wire, where a curve may bend to anything."""
NOT_LOOKED_AT = Sighting(0.0, np.zeros(0, dtype=bool))


@dataclass(frozen=True)
class Matched:
    """A conductor found in one frame."""

    survey: Survey
    solution: Solution
    view: View
    track: Track
    observed: Observed
    offsets: CurveObservations
    """The usable blocks of ``observed``, as they were solved for."""
    response: float
    """Mean response along the curve, half by length in the picture and half by length of the span, grey levels."""
    sighting: Sighting = NOT_LOOKED_AT
    rival: float = 0.0
    """Response of the best different curve over this one's where the two part; 0 if there is none."""
    unaided: Matched | None = None
    """What was measured before the wire itself foretold where to look: that cannot have leant on the load that was
    assumed."""
    other: Matched | None = None
    """The conductor under the other load, even or uneven, where the picture leaves open which of them it is: what is
    told holds both."""
    other_weight: float = 0.0
    """How much of the way towards the other load the intervals reach, 0..1: less where that one is hardly likely."""
    unexcluded: Loads | None = None
    """Uneven loads that hardly anything speaks for, but that the picture does not exclude either."""
    doubtful_load: bool = False
    """The wire hangs unevenly by its misfit, and no uneven load was found that explains it better."""
    without_lone: Solution | None = None
    """Under an uneven load, what is left without blocks that may be texture and decide much."""
    crowded: bool = False
    """On a wire, but others run so near it all along that nothing of it can be measured by itself."""
    or_of: str = ""
    """Another conductor that may as well hang on this wire, while this one hangs on its or on one not found."""
    unlike_others: bool = False
    """Under this uneven load it would have to have a wind of its own."""

    @property
    def sag(self) -> tuple[float, float]:
        """In-plane sag and its standard uncertainty, m."""
        return float(self.solution.theta[SAG]), float(np.sqrt(self.solution.covariance[SAG, SAG]))

    @property
    def swing(self) -> tuple[float, float]:
        """Swing and its standard uncertainty, rad."""
        return float(self.solution.theta[SWING]), float(np.sqrt(self.solution.covariance[SWING, SWING]))


def looked_at(image: GreyImage, match: Matched) -> Matched:
    """The same, with the shifted-curve test of its curve."""
    return replace(match, sighting=sight(image, match.track))


def on_curve(solution: Solution, observed: Observed) -> NDArray[np.bool_]:
    """Which blocks (M,) show the wire on the solved curve."""
    result = np.zeros(len(observed.t), dtype=bool)
    limit = np.maximum(1.0, 3 * observed.sigma[observed.usable])
    result[observed.usable] = np.abs(solution.residual) < limit
    return result


def support(matched: Matched) -> float:
    """Share of the curve in the frame, by its length in the picture, on which a wire stands out."""
    return float(np.mean(matched.sighting.seen))


def is_wire(matched: Matched) -> bool:
    """Whether anything like a wire lies on the curve at all."""
    proven = matched.sighting.score >= SCORE_MIN or matched.sighting.chance <= CHANCE_MAX
    return proven and support(matched) >= SUPPORT_MIN


def may_be_wire(matched: Matched) -> bool:
    """Whether enough lies on the curve to reckon with a wire: less than what it takes to tell it."""
    return matched.sighting.chance <= LIKELY_CHANCE


def share_standing_out(matched: Matched) -> float:
    """Share of the span's horizontal length over which a wire stands out on the curve."""
    return _share(matched.track, matched.sighting.seen)


def visible_share(matched: Matched) -> float:
    """Share of the span's horizontal length over which the wire is seen: it stands out, or was measured on the curve.

    A window stands out by its mean; the blocks in it, compared with the profile of a wire, may still show it.
    """
    return _share(matched.track, matched.sighting.seen | _measured_at(matched))


def surely_visible_share(matched: Matched) -> float:
    """The same without blocks that may have been measured on texture, which a curve under an uneven load bends to."""
    return _share(matched.track, matched.sighting.seen | _measured_at(matched, texture_chance(matched) < SURELY))


def texture_chance(matched: Matched) -> FloatArray:
    """Chance (M,) that a usable block looked at texture, by how much more uncertain that makes it than noise does."""
    observed, use = matched.observed, matched.observed.usable
    own = observed.noise[use] ** 2 + observed.scatter[use] ** 2
    return chance_of(np.sqrt(np.maximum(matched.offsets.sigma**2 - own, 0.0)), observed.half_range[use])


def measured_share(matched: Matched) -> float:
    """Share of the span's horizontal length over which blocks show the wire on the curve."""
    return _share(matched.track, _measured_at(matched))


def shown_share(matched: Matched) -> float:
    """Share of the blocks that nothing hides in which a wire was found near the curve."""
    clear = ~matched.observed.masked
    return float(matched.observed.usable[clear].mean()) if clear.any() else 0.0


def _measured_at(matched: Matched, some: NDArray[np.bool_] | bool = True) -> NDArray[np.bool_]:
    """At which samples (N,) of the track one of ``some`` usable blocks (M,) shows the wire on the curve."""
    use = matched.observed.usable
    shown = np.zeros(len(use), dtype=bool)
    off = np.maximum(np.abs(matched.solution.residual), matched.observed.sigma[use])
    shown[use] = (off < MEASURED_PX) & some
    return of_blocks(matched.observed, shown, matched.track.t)


def tip_of(matched: Matched) -> int | None:
    """Which of a conductor's offsets is the tip of a fold; None where none is."""
    observed = matched.observed
    return None if observed.tip is None else int(np.count_nonzero(observed.usable[: observed.tip]))


def of_blocks(observed: Observed, value: NDArray[np.bool_], t: FloatArray) -> NDArray[np.bool_]:
    """What is said of blocks (M,), said of places (N,) along the curve: each goes with the nearest block."""
    return np.asarray(value[np.searchsorted(0.5 * (observed.t[1:] + observed.t[:-1]), t)])


def _share(track: Track, some: NDArray[np.bool_]) -> float:
    return min(max(float(track.pace[some].sum()), 0.0), 1.0)


def attachment_z(matched: Matched) -> float:
    """Largest correction to the surveyed attachments, in units of their standard uncertainty."""
    return float(np.max(np.abs(matched.solution.theta[ATTACHMENTS])) / max(matched.survey.attachment_u, 1e-6))


def load_z(matched: Matched) -> float:
    """How far an uneven load lies from what one weight or one stretch of ice makes, in standard deviations of those."""
    prior = any_single()
    apart = matched.solution.theta[LOAD] - prior.mean
    return float(np.sqrt(apart @ prior.information @ apart))
