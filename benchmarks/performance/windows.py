"""What something costs at rest and what each of some events adds, from samples around the events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Share:
    """Rates and costs with their standard uncertainties, from the scatter between the windows."""

    rest_per_s: float
    rest_u: float
    each: float
    """Of one event, what the same time would have cost at rest taken off."""
    each_u: float
    windows: int


Mark = tuple[float, float]
"""A moment and what had been spent by then."""


def share(before: Sequence[Mark], after: Sequence[Mark]) -> Share:
    """The parts of rest and events in a sum that only grows.

    Args:
        before: at the beginning of each event's window, and once more after the last stretch of rest.
        after: at the end of each event's window.

    Raises:
        ValueError: fewer than three events, from which no scatter can be told.
    """
    count = len(after)
    if count < 3 or len(before) != count + 1:
        raise ValueError(f"{count} events between {len(before)} beginnings are too few")
    rests = [(b[1] - a[1], b[0] - a[0]) for a, b in zip(after, before[1:], strict=True)]
    rate = sum(spent for spent, _ in rests) / sum(seconds for _, seconds in rests)
    rate_u = _deviation([spent / seconds for spent, seconds in rests]) / math.sqrt(count)
    events = [(a[1] - b[1], a[0] - b[0]) for b, a in zip(before, after, strict=False)]
    costs = [spent - rate * seconds for spent, seconds in events]
    length = sum(seconds for _, seconds in events) / count
    each_u = math.hypot(_deviation(costs) / math.sqrt(count), rate_u * length)
    return Share(rate, rate_u, sum(costs) / count, each_u, count)


def _deviation(values: Sequence[float]) -> float:
    mean = sum(values) / len(values)
    return math.sqrt(sum((v - mean) ** 2 for v in values) / (len(values) - 1))
