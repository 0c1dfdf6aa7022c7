"""Readings for a screen and for a program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from sagnode import __version__
from sagnode.message import QUANTITIES, Estimate, QualityMessage, estimate_fields
from sagnode.quality import Validity

if TYPE_CHECKING:
    from sagnode.measurement import ConductorMeasurement


def reading_document(measurement: ConductorMeasurement, *, test: bool, budget: bool) -> dict[str, Any]:
    """A measurement as JSON-ready data: the fields of :class:`sagnode.message.Reading` that a picture alone has.

    All four fields of a quantity are there, null where it is unknown or the reading invalid.

    Args:
        measurement: one conductor.
        test: the unit is in commissioning.
        budget: add ``budget``: standard uncertainty by quantity stem and source.
    """
    document: dict[str, Any] = {
        "conductor": measurement.conductor,
        "phase": measurement.phase,
        "quality": QualityMessage.of(measurement.validity, measurement.reasons, test=test).model_dump(mode="json"),
        "frames_used": measurement.frames_used,
        "frames_rejected": measurement.frames_rejected,
        "visible_share": measurement.visible_share,
        "match_score": measurement.match_score,
        "pose_residual_px": measurement.pose_residual_px,
        "landmarks_used": measurement.landmarks_used,
        "landmarks_by_appearance": measurement.landmarks_by_appearance,
        "oldest_appearance_at": measurement.oldest_appearance_at,
        "method": measurement.method,
        "software_version": __version__,
    }
    for quantity in QUANTITIES:
        document |= dict.fromkeys(quantity.fields)
    if measurement.validity is not Validity.INVALID:
        document |= estimate_fields(measurement.estimates)
    if budget:
        document["budget"] = measurement.budget
    return document


def reading_table(name: str, measurements: Sequence[ConductorMeasurement], *, budget: bool) -> str:
    """The readings of one picture as lines: conductor, sag, clearance and its place, quality; reasons below each."""
    rows = [("conductor", "sag (95 %)", "clearance (95 %)", "quality")]
    rows += [
        (m.conductor, sag_text(m.estimates.get("sag")), clearance_text(m.estimates), str(m.validity))
        for m in measurements
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = [name]
    for row, measurement in zip(rows, (None, *measurements), strict=True):
        cells = "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
        lines.append(f"  {cells}".rstrip())
        if measurement is not None:
            lines += [f"      {reason.cause} ({reason.detail_qual}): {reason.text}" for reason in measurement.reasons]
            lines += _budget_lines(measurement) if budget else []
    return "\n".join(lines)


def sag_text(sag: Estimate | None) -> str:
    """``8.42 ± 0.03 m``, the half-width of the 95 % interval; ``-`` for none."""
    if sag is None:
        return "-"
    half = max(sag.hi - sag.value, sag.value - sag.lo)
    digits = sag.decimals
    return f"{sag.value:.{digits}f} ± {half:.{digits}f} m"


def clearance_text(estimates: dict[str, Estimate]) -> str:
    """``6.39 [6.31, 6.47] m at 134 m``; ``-`` for none."""
    clearance, along = estimates.get("clearance"), estimates.get("clearance_along")
    if clearance is None:
        return "-"
    digits = clearance.decimals
    text = f"{clearance.value:.{digits}f} [{clearance.lo:.{digits}f}, {clearance.hi:.{digits}f}] m"
    return f"{text} at {along.value:.{max(0, digits - 2)}f} m" if along else text


def _budget_lines(measurement: ConductorMeasurement) -> list[str]:
    """Standard uncertainty of sag and clearance by source, the greatest first."""
    from sagnode.plan.report import sources_text

    texts = {stem: sources_text(measurement.budget.get(stem, {})) for stem in ("sag", "clearance")}
    return [f"      u({stem}) by source, mm: {text}" for stem, text in texts.items() if text]
