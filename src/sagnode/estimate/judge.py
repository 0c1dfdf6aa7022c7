"""Judgement: whether a measurement may be told, and with what reasons."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.matched import (
    SCORE_MIN,
    SUPPORT_MIN,
    Matched,
    attachment_z,
    is_wire,
    load_z,
    shown_share,
    support,
    surely_visible_share,
    visible_share,
)
from sagnode.measurement import FrameMeasurement
from sagnode.message import Estimate
from sagnode.quality import Cause, Reason, Validity
from sagnode.site import Site, SiteConductor
from sagnode.survey import LOAD

Budget = Mapping[str, Mapping[str, float]]
"""Standard uncertainty of every quantity by source, in the quantity's unit."""
NOT_EXCLUDED = "load not excluded"
"""The part of it that is for loads which the picture does not exclude."""
DARK_LEVEL = 12.0
"""Grey level below which even the brightest hundredth of the picture shows nothing."""
OVEREXPOSED_SHARE = 0.6
"""Share of saturated pixels above which wires are burnt away."""
FLAT_DEVIATION = 2.5
"""Standard deviation of grey levels of a picture in which nothing is to be seen: covered lens, dense fog."""
VISIBLE_MIN = 0.33
"""Share of the span that must be seen: with less, a weight or ice on the rest goes unnoticed, and few wires of which
half could be seen are lost by that."""
SHOWN_MIN, SCATTER_MAX = 0.5, 1.2
"""Share of the blocks that must show a wire where they scatter by more than so many times what they say: wires do the
one where much is in their way, or the other where they are very sharp; bars of towers that a curve meets do both."""
UNEVEN_VISIBLE_MIN = 0.5
"""The same under an uneven load, of what can be nothing but the wire: nobody knows how it goes on where it is not seen,
and a curve that is lost bends to texture. With less, errors were up to twice as large as stated; from here on as
stated."""
UNEVEN_SHOWN_MIN = 0.7
"""Share of the curve that must stand out, and of its blocks that must show a wire, under an uneven load: a wire shows
nearly all along, while ten terms bend a curve from one leg of a tower, or another line's wire, to the next."""
UNEVEN_BLOCKS_MIN = 20
"""Blocks that must show a wire there: fewer leave little that could contradict the twelve unknowns of its shape."""
UNEVEN_LANDMARKS_MIN = 0.6
"""Share of the landmarks that must be recognised there: in another scene, or a mirrored one, half may fit by chance."""
SAG_U_MAX, SPAN_U_MAX = 0.04, 0.0015
"""Standard uncertainty of sag above which linear propagation no longer holds, as a share of the sag, and as a share of
the span: a flat wire is no harder to see at a height than one that sags by a twenty-fifth of its span."""
PRIOR_Z_MAX = 5.0
"""Corrections to the survey beyond this many of its own standard uncertainties mean another wire or a wrong survey."""
LOAD_Z_MAX = 3.5
"""So do loads this many standard deviations from what one weight or one stretch of ice makes: wires that hang under one
lie nearer than three, other lines' wires mostly farther than this."""
NOT_SEEN, HARDLY_SEEN = (Cause.NO_CONDUCTOR, Cause.AMBIGUOUS, Cause.OUTSIDE_LIMITS), 0.25
"""Why a conductor that was refused bears no other one out, and the share of its span below which it does not either."""
RIVAL_MAX = 0.8
"""A different curve that responds this strongly where it parts from the best leaves open which one is meant."""


def look(site: Site, image: GreyImage) -> list[Reason]:
    """Why a frame cannot be measured at all: wrong size, dark, burnt out, flat. Looks at every eighth pixel only."""
    wanted = (site.intrinsics.height, site.intrinsics.width)
    if image.shape != wanted:
        text = (
            f"the frame is {image.shape[1]}x{image.shape[0]}, the calibration is for {wanted[1]}x{wanted[0]};"
            " capture in the calibrated mode, or calibrate this one"
        )
        return [Reason(Cause.BAD_CALIBRATION, text)]
    counts = cv2.calcHist([np.ascontiguousarray(image[::8, ::8])], [0], None, [256], [0, 256]).ravel()
    share = counts / counts.sum()
    bright = float(np.searchsorted(np.cumsum(share), 0.99))
    if bright < DARK_LEVEL:
        return [Reason(Cause.DARK, f"the picture is dark (99 % of it at or below grey level {bright:.0f} of 255)")]
    saturated = float(share[254:].sum())
    if saturated > OVEREXPOSED_SHARE:
        return [Reason(Cause.OVEREXPOSED, f"{100 * saturated:.0f} % of the picture is saturated; shorten the exposure")]
    levels = np.arange(256.0)
    deviation = float(np.sqrt(share @ (levels - share @ levels) ** 2))
    if deviation < FLAT_DEVIATION:
        text = (
            f"the picture is flat (standard deviation {deviation:.1f} grey levels): fog, or something covers the lens"
        )
        return [Reason(Cause.LOW_CONTRAST, text)]
    return []


def judge(
    site: Site,
    conductor: SiteConductor,
    found: Matched | None,
    estimates: dict[str, Estimate],
    landmarks: float | None = None,
    budget: Budget | None = None,
) -> tuple[Validity, list[Reason]]:
    """Validity and reasons of one conductor's estimate; an invalid one carries no numbers.

    ``landmarks`` is the share of those that the reference picture shows which were recognised, where there is one, and
    ``budget`` the standard uncertainty of every quantity by source.
    """
    budget = {} if budget is None else budget
    if found is None:
        return Validity.INVALID, [Reason(Cause.NO_CONDUCTOR, "no curve of this conductor lies on anything like a wire")]
    if found.crowded:
        text = (
            "other wires run within a few pixels of this one all along, and nothing of it can be measured by itself: a"
            " longer lens, or a camera that looks from higher up or along the line, draws them apart"
        )
        return Validity.INVALID, [Reason(Cause.AMBIGUOUS, text)]
    invalid = [
        *_not_a_wire(found),
        *_not_this_conductor(conductor, found, estimates["inplane_sag"]),
        *_not_certain(found, estimates["sag"], budget),
        *_not_this_scene(found, landmarks),
    ]
    if invalid:
        # several of them name the load
        return Validity.INVALID, list(dict.fromkeys(invalid))
    doubtful = [*_doubts(site, found), *_exceeded(site, estimates, budget)]
    return (Validity.QUESTIONABLE, doubtful) if doubtful else (Validity.GOOD, [])


def borne_out(measured: Sequence[FrameMeasurement]) -> list[FrameMeasurement]:
    """The measurements of a frame; what may hang unevenly is refused where no other conductor of the span is seen.

    Another line's wire, in a span that is not to be seen, is told by nothing but that it hangs otherwise.
    """
    return [_alone(m) if _on_its_own_word(m, measured) else m for m in measured]


def _on_its_own_word(own: FrameMeasurement, measured: Sequence[FrameMeasurement]) -> bool:
    others = [m for m in measured if m is not own]
    told = own.validity is not Validity.INVALID
    uneven = any(reason.cause is Cause.ICE_SUSPECT for reason in own.reasons)
    return told and uneven and bool(others) and not any(_is_seen(m) for m in others)


def _is_seen(other: FrameMeasurement) -> bool:
    shown = other.visible_share is None or other.visible_share >= HARDLY_SEEN
    return shown and not any(reason.cause in NOT_SEEN for reason in other.reasons)


def _alone(own: FrameMeasurement) -> FrameMeasurement:
    text = (
        "it hangs, or may hang, as under an uneven load, and no other conductor of the span is found: so would a wire"
        " of another line"
    )
    reasons = (Reason(Cause.AMBIGUOUS, text), *own.reasons)
    return replace(own, validity=Validity.INVALID, reasons=reasons, estimates={}, budget={})


def _not_a_wire(found: Matched) -> list[Reason]:
    if not is_wire(found):
        text = (
            f"no wire stands out where the conductor should be: score {found.sighting.score:.1f} (needs {SCORE_MIN:g},"
            f" or nearly all of the curve), {100 * support(found):.0f} % of the curve in view on it"
            f" (needs {100 * SUPPORT_MIN:g} %)"
        )
        return [Reason(Cause.NO_CONDUCTOR, text)]
    visible = visible_share(found)
    if visible < VISIBLE_MIN:
        text = f"only {100 * visible:.0f} % of the span is visible (needs {100 * VISIBLE_MIN:g} %)"
        return [Reason(Cause.TOO_LITTLE_VISIBLE, text), *_ice(found)]
    # what is not seen hangs as what is seen only under an even load
    if found.survey.load_u and (surely := surely_visible_share(found)) < UNEVEN_VISIBLE_MIN:
        text = (
            f"only {100 * surely:.0f} % of the span is visible where nothing else could be taken for the wire, and an"
            f" uneven load can bend to that (needs {100 * UNEVEN_VISIBLE_MIN:g} %)"
        )
        return [Reason(Cause.TOO_LITTLE_VISIBLE, text), *_ice(found)]
    if found.survey.load_u or found.other_weight >= 1:
        return _hardly_shown(found)
    return _contradicted(found)


def _contradicted(found: Matched) -> list[Reason]:
    """A few stretches of something that an even curve meets, as bars of towers: no wire runs through them all."""
    shown, scatter = shown_share(found), math.sqrt(found.solution.inflation)
    if shown >= SHOWN_MIN or scatter <= SCATTER_MAX:
        return []
    text = (
        f"the curve shows something like a wire in {100 * shown:.0f} % of it (needs {100 * SHOWN_MIN:g} %), and that"
        f" lies {scatter:.1f} times as far from one curve as it could (at most {SCATTER_MAX:g})"
    )
    return [Reason(Cause.NO_CONDUCTOR, text)]


def _hardly_shown(found: Matched) -> list[Reason]:
    """What an uneven load bends to, or may have to, where that is hardly a wire."""
    blocks = len(found.solution.residual)
    if blocks < UNEVEN_BLOCKS_MIN and found.survey.load_u:
        text = f"the wire hangs as under an uneven load, and only {blocks} places show it (needs {UNEVEN_BLOCKS_MIN})"
        return [Reason(Cause.TOO_LITTLE_VISIBLE, text), *_ice(found)]
    shown = min(support(found), shown_share(found))
    if shown < UNEVEN_SHOWN_MIN:
        text = (
            "only a curve that an uneven load bends, or may bend, lies on anything like a wire, and that shows one in"
            f" {100 * shown:.0f} % of it (needs {100 * UNEVEN_SHOWN_MIN:g} %)"
        )
        return [Reason(Cause.NO_CONDUCTOR, text), *_ice(found)]
    return []


def _not_this_conductor(conductor: SiteConductor, found: Matched, sag: Estimate) -> list[Reason]:
    reasons = []
    if found.rival > RIVAL_MAX:
        text = f"another curve lies on a wire {100 * found.rival:.0f} % as clear; which one is meant?"
        reasons.append(Reason(Cause.AMBIGUOUS, text))
    if found.or_of:
        text = (
            f"conductor {found.or_of} may hang on this wire as well, and this one on another; from here nothing tells"
            " them apart: let the camera see their attachments, or look from higher up or along the line"
        )
        reasons.append(Reason(Cause.AMBIGUOUS, text))
    contradiction = attachment_z(found)
    if contradiction > PRIOR_Z_MAX:
        text = (
            f"the picture contradicts the surveyed attachments by {contradiction:.1f} of their standard uncertainty;"
            " another wire, or a wrong survey"
        )
        reasons.append(Reason(Cause.AMBIGUOUS, text))
    strange = load_z(found) if found.survey.load_u else 0.0
    if strange > LOAD_Z_MAX:
        text = (
            f"the curve lies on a wire under a load alone that is {strange:.1f} standard deviations from what a weight"
            " or ice on a part of the span makes; another wire, or a wrong survey"
        )
        reasons += [Reason(Cause.AMBIGUOUS, text), *_ice(found)]
    if found.unlike_others:
        text = (
            f"under an uneven load it would be swung by {np.degrees(found.swing[0]):.0f}°, unlike any other conductor"
            " of the span, and one wind swings all: another load, or another wire"
        )
        reasons += [Reason(Cause.AMBIGUOUS, text), *_ice(found)]
    low, high = conductor.survey.sag_range
    if not low - 2 * sag.u <= sag.value <= high + 2 * sag.u:
        text = f"sag {sag.value:.{sag.decimals}f} m is outside the possible {low:g} to {high:g} m of the survey"
        reasons.append(Reason(Cause.OUTSIDE_LIMITS, text))
    return reasons


def _not_certain(found: Matched, sag: Estimate, budget: Budget) -> list[Reason]:
    reasons = []
    if not found.solution.converged:
        reasons.append(Reason(Cause.NOT_CONVERGED, "the joint estimate of camera and conductor did not settle"))
    if found.doubtful_load:
        text = "the wire hangs as under an uneven load, ice or a weight on a part of the span, that cannot be followed"
        reasons.append(Reason(Cause.ICE_SUSPECT, text))
    # what is allowed for a load says nothing against the even one's propagation
    sources = dict(budget.get("sag", {}))
    u = math.sqrt(max(sag.u**2 - sources.pop(NOT_EXCLUDED, 0.0) ** 2, 0.0))
    if u > most_sag_u(found, sag.value):
        share = u / max(sag.value, 1e-9)
        text = (
            f"standard uncertainty of sag is {100 * share:.1f} % of it{_mostly(sources)}; the view or the"
            " survey is too weak"
        )
        reasons += [Reason(Cause.UNCERTAIN, text), *_ice(found)]
    return reasons


def _mostly(sources: Mapping[str, float]) -> str:
    """The greatest source of an uncertainty, as words to go on with; none where no budget is known."""
    return f", most of all by {max(sources, key=lambda name: sources[name])!r}" if sources else ""


def most_sag_u(found: Matched, sag: float) -> float:
    """Greatest standard uncertainty of a sag, m, with which a conductor is told."""
    span = float(np.linalg.norm(np.subtract(found.survey.far, found.survey.near)))
    return max(SAG_U_MAX * sag, SPAN_U_MAX * span)


def _not_this_scene(found: Matched, landmarks: float | None) -> list[Reason]:
    if not found.survey.load_u or landmarks is None or landmarks >= UNEVEN_LANDMARKS_MIN:
        return []
    text = (
        f"only {100 * landmarks:.0f} % of the landmarks are recognised, and the wire lies on its place under an uneven"
        f" load alone, whose terms can bend to what is there (needs {100 * UNEVEN_LANDMARKS_MIN:g} %)"
    )
    return [Reason(Cause.LANDMARKS_LOST, text), *_ice(found)]


def _ice(found: Matched) -> list[Reason]:
    if not found.survey.load_u:
        text = "the load may be uneven, ice or a weight on a part of the span; the intervals hold that as well"
        return [] if found.other_weight < 1 else [Reason(Cause.ICE_SUSPECT, text)]
    skew, u = float(found.solution.theta[LOAD.start]), float(np.sqrt(found.solution.covariance[LOAD.start, LOAD.start]))
    text = (
        "the wire hangs, or may hang, as under an uneven load, ice or a weight on a part of the span:"
        f" load skew {skew:+.2f} ± {2 * u:.2f} (0 is even)"
    )
    return [Reason(Cause.ICE_SUSPECT, text)]


def _doubts(site: Site, found: Matched) -> list[Reason]:
    reasons = []
    if site.patches is None and site.landmark_ids:
        text = "no reference picture, so nobody sees whether the camera has moved; set camera.reference_image"
        reasons.append(Reason(Cause.LANDMARKS_LOST, text))
    reasons += _ice(found)
    swing, swing_u = found.swing
    if abs(swing) - 2 * swing_u > site.swing_questionable:
        reasons.append(Reason(Cause.WIND_SWING, f"the conductor is swung by {np.degrees(swing):.0f}°"))
    return reasons


def _exceeded(site: Site, estimates: dict[str, Estimate], budget: Budget) -> list[Reason]:
    """The configured limits of uncertainty that an estimate exceeds: told, but questionable."""
    reasons = []
    for stem, limit in (("sag", site.limits.sag_u_max_m), ("clearance", site.limits.clearance_u_max_m)):
        if limit is not None and stem in estimates and estimates[stem].u > limit:
            text = (
                f"standard uncertainty of {stem} {estimates[stem].u:.3f} m{_mostly(budget.get(stem, {}))}, exceeds the"
                f" configured {limit:g} m"
            )
            reasons.append(Reason(Cause.UNCERTAIN, text))
    return reasons
