"""Outcomes of measurements against the truth, and their statistics."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sagnode.measurement import FrameMeasurement
from sagnode.message import QUANTITIES, Estimate
from sagnode.quality import Validity

OWN = "rational-bezier"
UNITS = {q.stem: q.unit for q in QUANTITIES}
K95 = 1.96
SEEN_SHARE = 0.5
"""Share of the span that must be clear to see (three times the noise of a pixel) for a reading to be due."""
ABSURD_Z = 5.0
"""An error beyond so many of a reading's own standard uncertainties is no chance."""
JUDGED = ("sag", "clearance")
"""Quantities whose errors make a reading false."""


@dataclass(frozen=True)
class Outcome:
    """One conductor in one reading, beside its truth."""

    group: str
    world: int
    frame: int
    conductor: str
    method: str
    validity: Validity
    reasons: tuple[str, ...]
    """Causes, then their texts in ``why``."""
    estimates: Mapping[str, Estimate]
    truth: Mapping[str, float] = field(default_factory=dict)
    """Empty where the conductor is not there or cannot be seen."""
    limit: Mapping[str, float] = field(default_factory=dict)
    """Standard uncertainty that nobody can beat in this frame, by stem."""
    seen: Mapping[str, float] = field(default_factory=dict)
    """How the renderer saw the conductor: visible_share, clear_share, snr."""
    fair: bool = True
    kind: str = ""
    why: str = ""

    @property
    def told(self) -> bool:
        """Whether it has numbers."""
        return bool(self.estimates)

    @property
    def due(self) -> bool:
        """Whether a reading could be expected: half of the span clear to see, by day, camera in place."""
        return bool(self.truth) and self.fair and self.seen.get("clear_share", 0.0) >= SEEN_SHARE

    @property
    def false(self) -> bool:
        """A number where there is nothing to be seen, or one that is absurdly far from the truth."""
        if not self.truth:
            return self.told
        return any(abs(self.z(stem)) > ABSURD_Z for stem in JUDGED if stem in self.estimates)

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

    def half_width(self, stem: str) -> float:
        """Half of the stated interval."""
        estimate = self.estimates[stem]
        return (estimate.hi - estimate.lo) / 2


def outcome(
    measured: FrameMeasurement,
    *,
    group: str,
    world: int,
    frame: int,
    truth: Mapping[str, float],
    limit: Mapping[str, float],
    seen: Mapping[str, float],
    kind: str = "",
    method: str | None = None,
    fair: bool = True,
) -> Outcome:
    """An outcome from what the pipeline told; ``method`` renames it where settings differ."""
    return Outcome(
        group=group,
        world=world,
        frame=frame,
        conductor=measured.conductor,
        method=method or measured.method,
        validity=measured.validity,
        reasons=tuple(r.cause.value for r in measured.reasons),
        estimates=dict(measured.estimates),
        truth=truth,
        limit=limit,
        seen=seen,
        fair=fair,
        kind=kind,
        why="; ".join(r.text for r in measured.reasons),
    )


@dataclass(frozen=True)
class Row:
    """Statistics of one quantity over the readings that tell it; lengths m."""

    stem: str
    told: int
    rmse: float
    bias: float
    rmse_rel: float
    bias_rel: float
    coverage: float
    half_width: float
    worst_z: float
    worst: str
    """Which reading that is: group, world, frame and conductor."""
    to_limit: float
    """Root mean square of the errors over the limit of their own scene; NaN where there is none."""
    width_to_limit: float
    """Mean of half-widths over twice the limit of their own scene."""
    limit: float
    """Root mean square of the limits: the RMSE of a reader that is as good as can be; NaN where there is none."""
    limit_rel: float
    """The same, each over the true value."""
    stated_to_limit: float
    """Root mean square of the stated standard uncertainties over the limit of their own scene."""


def statistics(outcomes: Sequence[Outcome], stem: str) -> Row | None:
    """Statistics of one quantity over good and questionable readings; None if no outcome tells it."""
    told = [o for o in outcomes if stem in o.estimates and stem in o.truth]
    if not told:
        return None
    error = np.array([o.error(stem) for o in told])
    truth = np.array([o.truth[stem] for o in told])
    half = np.array([o.half_width(stem) for o in told])
    stated = np.array([o.estimates[stem].u for o in told])
    bound = np.array([o.limit.get(stem, np.nan) for o in told])
    # the worst quantities (a swing's, a skew's truth may be zero) have no ratio
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(truth != 0, error / truth, np.nan)
        bound = np.where(bound > 0, bound, np.nan)
        bound_relative = np.where(truth != 0, bound / truth, np.nan)
    worst = max(told, key=lambda o: abs(o.z(stem)))
    return Row(
        stem=stem,
        told=len(told),
        rmse=_rms(error),
        bias=float(error.mean()),
        rmse_rel=_rms(relative),
        bias_rel=float(relative.mean()),
        coverage=float(np.mean([o.covered(stem) for o in told])),
        half_width=float(half.mean()),
        worst_z=abs(worst.z(stem)),
        worst=f"{worst.group} {worst.world}.{worst.frame} {worst.conductor}",
        to_limit=_rms(error / bound),
        width_to_limit=float(np.mean(half / (2 * bound))),
        limit=_rms(bound),
        limit_rel=_rms(bound_relative),
        stated_to_limit=_rms(stated / bound),
    )


@dataclass(frozen=True)
class Answers:
    """How often was told what."""

    good: int
    questionable: int
    invalid: int
    false: int
    due: int
    missed: int
    """Readings that were due and are invalid."""
    refusals: Counter[str]
    """First causes of the invalid ones."""
    missed_because: Counter[str]
    """First causes of the missed ones."""


def answers(outcomes: Sequence[Outcome]) -> Answers:
    """Validities, false readings, missed readings."""
    validity = Counter(o.validity for o in outcomes)
    invalid = [o for o in outcomes if o.validity is Validity.INVALID]
    return Answers(
        good=validity[Validity.GOOD],
        questionable=validity[Validity.QUESTIONABLE],
        invalid=len(invalid),
        false=sum(o.false for o in outcomes),
        due=sum(o.due for o in outcomes),
        missed=sum(o.due for o in invalid),
        refusals=_first_causes(invalid),
        missed_because=_first_causes([o for o in invalid if o.due]),
    )


def _first_causes(outcomes: Iterable[Outcome]) -> Counter[str]:
    return Counter(o.reasons[0] if o.reasons else "no reason" for o in outcomes)


@dataclass(frozen=True)
class Changes:
    """How well readings of one camera agree with each other, whatever the survey's errors are."""

    readings: int
    worlds: int
    scatter: float
    """Standard deviation of the errors about each conductor's own mean, m."""
    scatter_rel: float
    """The same over the sag."""
    step: float
    """Root mean square error of the change from one frame to the next, m."""


def changes(outcomes: Sequence[Outcome], stem: str = "sag") -> Changes | None:
    """Agreement within sequences; None where no conductor was read twice."""
    series: dict[tuple[int, str], list[Outcome]] = {}
    for o in outcomes:
        if stem in o.estimates and stem in o.truth:
            series.setdefault((o.world, o.conductor), []).append(o)
    long = {key: sorted(s, key=lambda o: o.frame) for key, s in series.items() if len(s) > 1}
    if not long:
        return None
    about, relative, steps, freedom = [], [], [], 0
    for one in long.values():
        errors = np.array([o.error(stem) for o in one])
        about.append(errors - errors.mean())
        relative.append(about[-1] / np.mean([o.truth[stem] for o in one]))
        steps.append(np.diff(errors))
        freedom += len(errors) - 1
    return Changes(
        readings=sum(len(s) for s in long.values()),
        worlds=len({world for world, _ in long}),
        scatter=float(np.sqrt(np.sum(np.concatenate(about) ** 2) / freedom)),
        scatter_rel=float(np.sqrt(np.sum(np.concatenate(relative) ** 2) / freedom)),
        step=_rms(np.concatenate(steps)),
    )


def stems_of(outcomes: Iterable[Outcome]) -> list[str]:
    """Quantities that occur with their truth, in the messages' order."""
    present = {stem for o in outcomes for stem in o.estimates if stem in o.truth}
    return [q.stem for q in QUANTITIES if q.stem in present]


def coverage_by_chance(worlds: int) -> float:
    """Half-width of the 95 % interval in which a true coverage of 95 % comes out over so many independent draws."""
    return K95 * math.sqrt(0.95 * 0.05 / max(worlds, 1))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
