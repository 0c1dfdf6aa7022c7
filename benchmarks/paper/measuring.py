"""What every method says of a trial: errors of the clearance at mid-span, cm."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from paper.methods import HELPED, PRINTED, registered
from paper.scenes import Trial
from sagnode.config.node import Measure, Method
from sagnode.measurement import FrameMeasurement
from sagnode.pipeline import load_site, measure_frame
from sagnode.reference.measure import Settings, measure_by_reference

PAPER_METHODS: dict[str, Method] = {
    "Method 1": "cosh",
    "Method 2": "cosh-perspective",
    "Bézier": "paper-bezier",
}
OWN = "sagnode"
ON_THE_LINE = replace(PRINTED, fictive_line=True)
"""Figure 7: the Bézier curve too is cut by the mid-span line."""
EVERYWHERE = HELPED
"""The same in the whole frame: the field's conductor does not lie in the top quadrants alone."""


@dataclass(frozen=True)
class Result:
    """What one method told of one trial; error in cm, NaN where it told nothing."""

    method: str
    trial: str
    error_cm: float
    clearance_m: float
    validity: str
    held: bool
    """Whether the stated 95 % interval holds the truth."""


def measure(
    trials: Iterable[Trial],
    settings: Settings = ON_THE_LINE,
    *,
    help_them: bool = False,
    undistort: bool = True,
    methods: Iterable[str] = tuple(PAPER_METHODS),
) -> list[Result]:
    """Every method on every trial.

    Args:
        trials: pictures.
        settings: of the paper's methods.
        help_them: give the paper's methods the camera as sagnode's landmarks show it, and the whole frame.
        undistort: whether the lens' distortion is undone.
        methods: of the paper's, which; sagnode's is always among them.
    """
    results = []
    for trial in trials:
        for name, method in ((name, PAPER_METHODS[name]) for name in methods):
            site = load_site(trial.span, Measure(method=method, undistort=undistort))
            site = replace(site, conductors=tuple(c for c in site.conductors if c.id == trial.conductor))
            if help_them:
                own = registered(site, trial.image)
                measured = measure_by_reference(own, trial.image, HELPED)
            else:
                measured = measure_by_reference(site, trial.image, settings)
            results.append(_result(name, trial, measured))
        site = load_site(trial.span, Measure(undistort=undistort))
        results.append(_result(OWN, trial, measure_frame(site, trial.image)))
    return results


def _result(method: str, trial: Trial, measured: Sequence[FrameMeasurement]) -> Result:
    one = next(m for m in measured if m.conductor == trial.conductor)
    estimate = one.estimates.get("midspan_clearance")
    if estimate is None:
        return Result(method, trial.name, math.nan, math.nan, one.validity.value, False)
    truth = trial.truth["midspan_clearance"]
    held = estimate.lo <= truth <= estimate.hi
    return Result(method, trial.name, 100 * (estimate.value - truth), estimate.value, one.validity.value, held)


@dataclass(frozen=True)
class Errors:
    """Statistics of one method's errors, cm."""

    told: int
    of: int
    mean_abs: float
    rms: float
    bias: float
    sd: float
    """Standard deviation of the absolute errors, as the paper's table 5 has it beside their mean."""
    mean_abs_u: float
    """Standard uncertainty of the mean absolute error."""
    held: float
    """Share of the stated 95 % intervals that hold the truth."""


def errors(results: Iterable[Result], method: str) -> Errors:
    """Of one method's results; NaN where it told nothing."""
    own = [r for r in results if r.method == method]
    told = [r for r in own if math.isfinite(r.error_cm)]
    if not told:
        return Errors(0, len(own), *[math.nan] * 6)
    values = np.array([r.error_cm for r in told])
    size = np.abs(values)
    sd = float(size.std(ddof=1)) if len(size) > 1 else math.nan
    return Errors(
        told=len(told),
        of=len(own),
        mean_abs=float(size.mean()),
        rms=float(np.sqrt(np.mean(values**2))),
        bias=float(values.mean()),
        sd=sd,
        mean_abs_u=sd / math.sqrt(len(size)),
        held=float(np.mean([r.held for r in told])),
    )


def difference(results: Sequence[Result], one: str, other: str) -> tuple[float, float, int]:
    """Mean of ``|error of one| - |error of other|`` on the same pictures, cm, its uncertainty, their number."""
    by = {name: {r.trial: abs(r.error_cm) for r in results if r.method == name} for name in (one, other)}
    pairs = [(by[one][t], by[other][t]) for t in by[one] if t in by[other]]
    gaps = np.array([a - b for a, b in pairs if math.isfinite(a) and math.isfinite(b)])
    if len(gaps) < 2:
        return math.nan, math.nan, len(gaps)
    return float(gaps.mean()), float(gaps.std(ddof=1) / math.sqrt(len(gaps))), len(gaps)
