"""A plan for a screen and for a program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sagnode.message import Estimate
from sagnode.plan.camera import PlannedCamera
from sagnode.plan.foresee import Foreseen
from sagnode.plan.frame import Look
from sagnode.plan.neighbours import MERGED_PX, Neighbour
from sagnode.plan.study import Row, Study
from sagnode.quality import Validity

VERDICTS = {Validity.GOOD: "good", Validity.QUESTIONABLE: "doubtful", Validity.INVALID: "refused"}
"""What a reading would be, in words."""
_SMALL_GAIN = 0.01
_LEAST_SHARE = 0.02
_STEMS = ("sag", "clearance")


def study_text(study: Study, look: Look) -> str:
    """One camera in full."""
    site = study.site
    lines = [camera_text(study.camera)]
    if study.camera.turned_from is not None:
        lines.append(f"  {turned_text(study.camera.turned_from)}")
    marks = f"{len(site.landmark_ids)} landmarks in view" + (f" ({', '.join(site.landmark_ids)})" * bool(site.patches))
    lines.append(f"  {marks}")
    lines.append(f"  assumed: {look}")
    heads = ("conductor", "sag, m", "u, mm", "95 %, mm", "clearance, m", "u, mm", "95 %, mm")
    rows: list[tuple[str, ...]] = [(*heads, "in view", "seen", "wire, px", "expected")]
    rows += [_conductor_cells(name, one) for name, level in study.levels.items() for one in level]
    lines += ["", *_columns(rows), ""]
    lines += _remarks(study)
    lines += _most_from(study.weakest)
    lines += _first_of_all(study)
    lines += _improvements(study)
    return "\n".join(lines)


def table_text(rows: Sequence[Row]) -> str:
    """Many cameras, one line each."""
    heads = ("position", "lens", "field", "azimuth, elevation", "landmarks", "in view", "wire, px", "u(sag), mm")
    cells = [(*heads, "u(clearance), mm", "of", "expected", "mostly from")]
    for row in rows:
        one = row.worst
        camera = row.camera
        share = min(f.in_view for f in row.foreseen)
        thinnest = min((f.width_px[2] for f in row.foreseen if f.width_px is not None), default=None)
        cells.append(
            (
                _point(camera.position),
                _lens(camera),
                f"{camera.field_deg[0]:.0f}° x {camera.field_deg[1]:.0f}°",
                f"{camera.azimuth_deg:.1f}°, {camera.elevation_deg:.1f}°{' (turned)' * bool(camera.turned_from)}",
                str(row.landmarks),
                f"{100 * share:.0f} %",
                "-" if thinnest is None else f"{thinnest:.2f}",
                _mm(one.estimates.get("sag")),
                _mm(one.estimates.get("clearance")),
                one.conductor,
                _verdict(one),
                dominant(one, "sag") or "-",
            )
        )
    note = (
        "Every conductor in the middle of its possible sags; the line tells of the weakest conductor, the least share"
        " of a span in view and the thinnest end of a wire."
        + " Turned: another direction than the surveyed one, which shows less."
        * any(r.camera.turned_from for r in rows)
    )
    return "\n".join([*_columns(cells), note])


def camera_text(camera: PlannedCamera) -> str:
    """Place, direction and lens in one line."""
    lens = camera.intrinsics
    direction = _angles(camera.azimuth_deg, camera.elevation_deg)
    return (
        f"camera at {_point(camera.position)}, {direction};"
        f" {lens.width}x{lens.height} px, {_lens(camera)}, {camera.field_deg[0]:.0f}° x {camera.field_deg[1]:.0f}°"
    )


def turned_text(surveyed: tuple[float, float]) -> str:
    """That the camera was turned, from which azimuth and elevation in degrees."""
    return f"turned from the surveyed {_angles(*surveyed)}, which shows less"


def dominant(one: Foreseen, stem: str) -> str | None:
    """The greatest source of a quantity's uncertainty."""
    sources = one.budget.get(stem)
    return max(sources, key=lambda name: sources[name]) if sources else None


def study_document(study: Study) -> dict[str, Any]:
    """One camera in full, ready for JSON; lengths m, angles degrees."""
    return {
        "camera": camera_document(study.camera),
        "landmarks_in_view": list(study.site.landmark_ids),
        "conductors": [
            foreseen_document(one) | {"level": name} for name, level in study.levels.items() for one in level
        ],
        "weakest": study.weakest.conductor,
        "improvements": [
            {
                "what": gain.what,
                "sag_u": gain.sag_u,
                "clearance_u": gain.clearance_u,
                "sag_gain": gain.sag_share,
                "clearance_gain": gain.clearance_share,
            }
            for gain in study.improvements
        ],
    }


def row_document(row: Row) -> dict[str, Any]:
    """One line of the table, ready for JSON."""
    return {
        "camera": camera_document(row.camera),
        "landmarks_in_view": row.landmarks,
        "conductors": [foreseen_document(one) | {"level": "middle"} for one in row.foreseen],
        "weakest": row.worst.conductor,
    }


def camera_document(camera: PlannedCamera) -> dict[str, Any]:
    """A camera, ready for JSON."""
    lens = camera.intrinsics
    width, height = camera.field_deg
    turned = camera.turned_from
    return {
        "position": list(camera.position),
        "azimuth_deg": camera.azimuth_deg,
        "elevation_deg": camera.elevation_deg,
        "roll_deg": camera.roll_deg,
        "turned_from": None if turned is None else {"azimuth_deg": turned[0], "elevation_deg": turned[1]},
        "width_px": lens.width,
        "height_px": lens.height,
        "focal_px": lens.fx,
        "focal_mm": camera.focal_mm,
        "field_deg": [width, height],
    }


def foreseen_document(one: Foreseen) -> dict[str, Any]:
    """One conductor at one sag, ready for JSON."""
    document: dict[str, Any] = {
        "conductor": one.conductor,
        "expected": VERDICTS[one.validity],
        "reasons": [{"cause": str(r.cause), "text": r.text} for r in one.reasons],
        "sag_m": one.sag_m,
        "clearance_m": one.clearance_m,
        "in_view_share": one.in_view,
        "seen_share": one.stands_out,
        "wire_px": None if one.width_px is None else dict(zip(("near", "middle", "far"), one.width_px, strict=True)),
        "neighbours": [
            {
                "conductor": n.conductor,
                "closest_px": n.closest_px,
                "at_share": n.at_share,
                "merged_share": n.merged_share,
                "crosses": n.crosses,
            }
            for n in one.neighbours
        ],
    }
    for stem in _STEMS:
        estimate = one.estimates.get(stem)
        document[f"{stem}_u"] = None if estimate is None else estimate.u
        document[f"{stem}_half_width"] = None if estimate is None else half_width(estimate)
        document[f"{stem}_mostly_from"] = dominant(one, stem)
        document[f"{stem}_budget"] = one.budget.get(stem, {})
    return document


def half_width(estimate: Estimate) -> float:
    """Of the 95 % interval, m."""
    return 0.5 * (estimate.hi - estimate.lo)


def _conductor_cells(level: str, one: Foreseen) -> tuple[str, ...]:
    sag, clearance = (one.estimates.get(stem) for stem in _STEMS)
    width = "-" if one.width_px is None else " ".join(f"{w:.2f}" for w in one.width_px)
    return (
        one.conductor,
        f"{metres(one, one.sag_m)} ({level})",
        _mm(sag),
        "-" if sag is None else f"± {millimetres(half_width(sag))}",
        metres(one, one.clearance_m),
        _mm(clearance),
        "-" if clearance is None else f"± {millimetres(half_width(clearance))}",
        f"{100 * one.in_view:.0f} %",
        f"{100 * one.stands_out:.0f} %",
        width,
        _verdict(one),
    )


def _remarks(study: Study) -> list[str]:
    """Reasons of doubt and refusal, and wires that come together in the picture."""
    lines = []
    for level, foreseen in study.levels.items():
        for one in foreseen:
            place = f"{one.conductor} ({level})"
            lines += [f"  {place}: {reason.cause}: {reason.text}" for reason in one.reasons]
            lines += [f"  {place}: {_beside(other)}" for other in one.neighbours if other.crosses or other.merged_share]
    return [*lines, ""] if lines else []


def _beside(other: Neighbour) -> str:
    how = "crosses" if other.crosses else "touches"
    text = f"{other.conductor} {how} it in the picture at {100 * other.at_share:.0f} % of the span"
    if other.merged_share < 0.005:
        return text
    lost = f"{100 * other.merged_share:.0f} % of what is in view"
    return f"{text}; nearer than {MERGED_PX:g} px, where both are one line, over {lost}"


def _most_from(one: Foreseen) -> list[str]:
    lines = []
    for stem in _STEMS:
        text = sources_text(one.budget.get(stem, {}))
        if text:
            lines.append(f"u({stem}) of {one.conductor} (middle) by source, mm: {text}")
    return lines


def sources_text(budget: Mapping[str, float]) -> str:
    """A standard uncertainty by source, m: in mm, the greatest first; what is less than 2 % of that is left out.

    >>> sources_text({"ground": 0.0005, "landmarks": 0.0021, "intrinsics": 0.00004})
    'landmarks 2.1, ground 0.50'
    """
    sources = sorted(budget.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {millimetres(u)}" for name, u in sources if u > _LEAST_SHARE * sources[0][1])


def _first_of_all(study: Study) -> list[str]:
    """What comes before every other improvement: without landmarks no reading notices that the camera has moved."""
    if study.site.landmark_ids:
        return []
    return ["", "First of all: survey landmarks that this camera sees; four at least, eight are good, near and far."]


def _improvements(study: Study) -> list[str]:
    useful = [gain for gain in study.improvements if gain.best >= _SMALL_GAIN]
    if not useful:
        return []
    rows = [("what would help", "u(sag), mm", "", "u(clearance), mm", "")]
    rows += [
        (
            gain.what,
            millimetres(gain.sag_u),
            _change(gain.sag_share),
            millimetres(gain.clearance_u),
            _change(gain.clearance_share),
        )
        for gain in useful
    ]
    rest = [gain.what for gain in study.improvements if gain.best < _SMALL_GAIN]
    lines = ["", f"Of {study.weakest.conductor} (middle), one change at a time:", *_columns(rows)]
    return [*lines, f"  gain less than 1 %, or none: {'; '.join(rest)}"] if rest else lines


def _change(share: float) -> str:
    return f"{-100 * share:+.0f} %" if abs(share) >= 0.005 else "0 %"


def _verdict(one: Foreseen) -> str:
    causes = ", ".join(str(reason.cause) for reason in one.reasons)
    return f"{VERDICTS[one.validity]} ({causes})" if causes else VERDICTS[one.validity]


def _mm(estimate: Estimate | None) -> str:
    return "-" if estimate is None else millimetres(estimate.u)


def metres(one: Foreseen, length_m: float) -> str:
    """A length that is planned for, such as the conductor's sag; to 0.1 mm in a model."""
    return f"{length_m:.{4 if one.sag_m < 1 else 2}f}"


def millimetres(length_m: float) -> str:
    """A length in mm with two or three digits.

    >>> millimetres(0.0217), millimetres(0.0042), millimetres(0.00039)
    ('22', '4.2', '0.39')
    """
    value = 1000 * length_m
    return f"{value:.{2 if value < 1 else 1 if value < 9.95 else 0}f}"


def _point(position: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in position) + ")"


def _angles(azimuth_deg: float, elevation_deg: float) -> str:
    return f"azimuth {azimuth_deg:.1f}°, elevation {elevation_deg:.1f}°"


def _lens(camera: PlannedCamera) -> str:
    pixels = f"f = {camera.intrinsics.fx:.0f} px"
    return f"{camera.focal_mm:g} mm, {pixels}" if camera.focal_mm is not None else pixels


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        ("  " + "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))).rstrip() for row in rows
    ]
