"""Outcomes of measurements against the truth, and their statistics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from sagnode.measurement import FrameMeasurement
from sagnode.message import QUANTITIES, Estimate
from sagnode.quality import Validity

UNITS = {q.stem: q.unit for q in QUANTITIES}
IN_METRES = {"lowest_along", "clearance_along", "catenary_constant"}
"""Lengths too large for centimetres."""
MILLIMETRES_BELOW = 0.005
"""Shorter lengths are told in millimetres."""
RELATIVE = {
    "sag",
    "inplane_sag",
    "drop",
    "clearance",
    "midspan_sag",
    "midspan_clearance",
    "catenary_constant",
    "tension",
}
"""Quantities of which a per cent means something."""


@dataclass(frozen=True)
class Outcome:
    """One conductor in one reading, beside its truth."""

    group: str
    frame: str
    world: int
    conductor: str
    method: str
    validity: Validity
    reason: str
    estimates: dict[str, Estimate]
    truth: dict[str, float] = field(default_factory=dict)
    """Empty where the conductor is not there or cannot be seen."""

    def error(self, stem: str) -> float:
        """Estimate minus truth, in the quantity's unit."""
        return self.estimates[stem].value - self.truth[stem]

    def z(self, stem: str) -> float:
        """Error over stated standard uncertainty; without end where that is stated as zero and is not."""
        error, u = self.error(stem), self.estimates[stem].u
        return error / u if u > 0 else math.copysign(math.inf, error) if error else 0.0

    def covered(self, stem: str) -> bool:
        """Whether the stated 95 % interval holds the truth."""
        estimate = self.estimates[stem]
        return estimate.lo <= self.truth[stem] <= estimate.hi


def outcome(
    group: str, frame: str, world: int, measured: FrameMeasurement, truth: dict[str, float], method: str | None = None
) -> Outcome:
    """An outcome from what the pipeline told; ``method`` renames it where settings differ."""
    # the truth gives blow-out a side, a reading only its amount: the swing's sign has the side
    truth = {stem: abs(value) if stem == "blowout" else value for stem, value in truth.items()}
    return Outcome(
        group=group,
        frame=frame,
        world=world,
        conductor=measured.conductor,
        method=method or measured.method,
        validity=measured.validity,
        reason="; ".join(f"{r.cause}: {r.text}" for r in measured.reasons),
        estimates=dict(measured.estimates),
        truth=truth,
    )


@dataclass(frozen=True)
class Row:
    """Statistics of one quantity over outcomes."""

    stem: str
    good: int
    questionable: int
    invalid: int
    rmse: float
    bias: float
    rmse_rel: float
    bias_rel: float
    coverage: float
    half_width: float
    z_rms: float
    worst_z: float

    @property
    def told(self) -> int:
        """Readings with a number."""
        return self.good + self.questionable


def statistics(outcomes: Sequence[Outcome], stem: str) -> Row | None:
    """Statistics of one quantity; None if no outcome tells it. RMSE and coverage are over good and questionable."""
    told = [o for o in outcomes if stem in o.estimates and stem in o.truth]
    if not told:
        return None
    error = np.array([o.error(stem) for o in told])
    truth = np.array([o.truth[stem] for o in told])
    relative = error / truth if stem in RELATIVE else np.full(len(told), np.nan)
    z = np.array([o.z(stem) for o in told])
    half = np.array([(o.estimates[stem].hi - o.estimates[stem].lo) / 2 for o in told])
    return Row(
        stem=stem,
        good=sum(o.validity is Validity.GOOD for o in outcomes),
        questionable=sum(o.validity is Validity.QUESTIONABLE for o in outcomes),
        invalid=sum(o.validity is Validity.INVALID for o in outcomes),
        rmse=_rms(error),
        bias=float(error.mean()),
        rmse_rel=_rms(relative),
        bias_rel=float(relative.mean()),
        coverage=float(np.mean([o.covered(stem) for o in told])),
        half_width=float(half.mean()),
        z_rms=_rms(z),
        worst_z=float(np.max(np.abs(z))),
    )


def stems_of(outcomes: Iterable[Outcome]) -> list[str]:
    """Quantities that occur with their truth, in the messages' order."""
    present = {stem for o in outcomes for stem in o.estimates if stem in o.truth}
    return [q.stem for q in QUANTITIES if q.stem in present]


HEADER = (
    "| quantity | good / quest. / invalid | RMSE | bias | 95 % holds | half width | z rms | worst z |\n"
    "|---|---|---|---|---|---|---|---|"
)


def table_line(label: str, row: Row) -> str:
    """A line of a Markdown table under :data:`HEADER` with ``label`` for the quantity."""
    return (
        f"| {label} | {row.good} / {row.questionable} / {row.invalid} | {_amount(row.stem, row.rmse, row.rmse_rel)}"
        f" | {_amount(row.stem, row.bias, row.bias_rel, signed=True)} | {100 * row.coverage:.0f} %"
        f" | {_amount(row.stem, row.half_width)} | {row.z_rms:.2f} | {row.worst_z:.1f} |"
    )


def _amount(stem: str, value: float, relative: float = float("nan"), signed: bool = False) -> str:
    unit = UNITS[stem]
    sign = "+" if signed else ""
    if unit == "m" and stem not in IN_METRES:
        text = f"{100 * value:{sign}.1f} cm" if abs(value) >= MILLIMETRES_BELOW else f"{1000 * value:{sign}.2f} mm"
    elif unit == "deg":
        text = f"{value:{sign}.2f}°"
    else:
        text = f"{value:{sign}.1f} {unit.upper() if unit in {'n', 'c'} else unit}"
    return text if np.isnan(relative) else f"{text} ({100 * relative:{sign}.2f} %)"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
