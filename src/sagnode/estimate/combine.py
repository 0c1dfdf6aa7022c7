"""Combining the frames of a burst: each is measured by itself, then the robust mean and what their scatter says."""

from __future__ import annotations

import numpy as np

from sagnode.digits import decimals
from sagnode.estimate.tell import K95
from sagnode.measurement import ConductorMeasurement, FrameMeasurement
from sagnode.message import Estimate
from sagnode.quality import Cause, Reason, Validity

DISAGREE_Z = 4.0
"""Frames that scatter more than this many of their random uncertainties, and 3 cm, disagree: wind, or a mistake."""
OUTLIER_Z = 4.5
"""Frames farther than this many of their usual scatter from the median are left out."""


def combine_burst(frames: list[list[FrameMeasurement]]) -> list[ConductorMeasurement]:
    """One measurement a conductor from the frames' measurements (outer list: frames)."""
    return [_combine(list(of_conductor)) for of_conductor in zip(*frames, strict=True)]


def _combine(frames: list[FrameMeasurement]) -> ConductorMeasurement:
    told = [f for f in frames if f.validity is not Validity.INVALID]
    if not told or 2 * len(told) < len(frames):
        # the most frequent reason speaks for all
        invalid = [f for f in frames if f.validity is Validity.INVALID]
        causes = [f.reasons[0].cause for f in invalid]
        worst = invalid[causes.index(max(set(causes), key=causes.count))]
        return _measurement(worst, Validity.INVALID, worst.reasons, {}, 0, len(frames))
    sags = np.array([f.estimates["sag"].value for f in told])
    centre = float(np.median(sags))
    spread = 1.4826 * float(np.median(np.abs(sags - centre)))
    # few frames may agree by chance far better than their noise lets them
    noise = float(np.median([f.budget["sag"].get("pixel noise", 0.0) for f in told]))
    usual = max(spread, noise, 0.005)
    kept = [f for f, sag in zip(told, sags, strict=True) if abs(sag - centre) <= OUTLIER_Z * usual]
    nearest = min(kept, key=lambda f: abs(f.estimates["sag"].value - centre))
    validity = max((f.validity for f in kept), key=lambda v: v is Validity.QUESTIONABLE)
    reasons = tuple({r.cause: r for f in kept for r in f.reasons}.values())
    # what only some of the frames tell, as that a load is uneven, is not what the burst tells
    common = [stem for stem in nearest.estimates if all(stem in f.estimates for f in kept)]
    estimates = {stem: _mean([f.estimates[stem] for f in kept]) for stem in common}
    scatter = float(np.std(sags, ddof=1)) if len(sags) > 1 else 0.0
    random = nearest.budget["sag"].get("pixel noise", 0.0)
    if scatter > max(DISAGREE_Z * random, 0.03) and scatter > nearest.estimates["sag"].u:
        validity = Validity.QUESTIONABLE
        text = f"sag differs by {scatter:.{decimals(scatter)}f} m (standard deviation) between the frames of the burst"
        reasons = (*reasons, Reason(Cause.FRAMES_DISAGREE, text))
    return _measurement(nearest, validity, reasons, estimates, len(kept), len(frames) - len(kept))


def _mean(estimates: list[Estimate]) -> Estimate:
    """Mean of a quantity over frames: the survey's errors are common to all frames, the scatter averages out."""
    values = np.array([e.value for e in estimates])
    value = float(values.mean())
    u = float(np.mean([e.u for e in estimates]))
    if len(values) > 1:
        u = float(np.hypot(u, np.std(values, ddof=1) / np.sqrt(len(values))))
    return Estimate(value, u, value - K95 * u, value + K95 * u)


def _measurement(
    frame: FrameMeasurement,
    validity: Validity,
    reasons: tuple[Reason, ...],
    estimates: dict[str, Estimate],
    used: int,
    rejected: int,
) -> ConductorMeasurement:
    return ConductorMeasurement(
        conductor=frame.conductor,
        phase=frame.phase,
        validity=validity,
        reasons=reasons,
        method=frame.method,
        estimates=estimates,
        budget=frame.budget if estimates else {},
        visible_share=frame.visible_share,
        match_score=frame.match_score,
        pose_residual_px=frame.pose_residual_px,
        landmarks_used=frame.landmarks_used,
        landmarks_by_appearance=frame.landmarks_by_appearance,
        oldest_appearance_at=frame.oldest_appearance_at,
        drawing=frame.drawing,
        frames_used=used,
        frames_rejected=rejected,
    )
