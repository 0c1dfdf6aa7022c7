"""How likely a change of temperature is, against a reading that has nothing to do with the conductor.

Everything is in kelvin of equivalent temperature (:mod:`sagnode.trend.heat`). A conductor follows its equilibrium as
``T' = (T_eq - T) / τ``; τ is of the order of 5 to 20 minutes (IEEE Std 738, CIGRE TB 601), shorter in wind. Whatever
current, sun, rain and wind do, a change after Δt is therefore the fraction ``1 - exp(-Δt/τ)`` of what they would do in
the long run. Three kinds of change are told apart:

- ordinary: load, sun and gusts as they come, normally distributed;
- a step: the line is switched or its load jumps; rare, and bounded by what a current can do at all;
- none of these: the reading is a mistake and lies anywhere in the range that the survey allows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

TAU_S = 600.0
"""Thermal time constant of common conductors in light wind, s. Stronger wind shortens it to half, but then the same
current heats less: the product, which limits the rate, stays."""
ORDINARY_K = 6.0
"""Standard deviation of ordinary changes over times much longer than τ. The simulated days of ``benchmarks/trend.py``
have 0.4 K in 1 min, 1.5 K in 5 min, 4 K in 30 min, where this gives 0.6, 2.4 and 5.7 K."""
STEP_K = 20.0
"""The same of steps: the line is loaded, unloaded, rained upon."""
STEP_SHARE = 0.02
"""How often an interval of τ holds a step; longer ones hold more."""
STEP_MAX_K = 80.0
"""No change of the equilibrium is larger. With τ it allows 8 K/min at first; full rated current into a cold conductor
of 243-AL1/39-ST1A gives 5 K/min (I²R over its heat capacity)."""
MISTAKE_SHARE = 0.01
"""How often a reading that was judged good by itself is none of this conductor."""
FOLLOW_SHARE = 0.98
"""How often a change is one that the span's other conductors share: three phases carry one current in one wind."""
FOLLOW_K = 0.7
FOLLOW_REL = 0.15
"""Phases differ in their changes by so much, and by this share of the change: shelter, position, unequal load."""
WEIGHTS = (0.8, 0.15, 0.05)
"""Belief in the newest earlier reading and in those before it, which vouch when that one was a mistake itself."""


@dataclass(frozen=True)
class Change:
    """A change of equivalent temperature between two readings.

    Attributes:
        kelvin: later minus earlier.
        u: its standard uncertainty: both readings' and what wind adds, K.
        after_s: time between them.
    """

    kelvin: float
    u: float
    after_s: float


def reached(after_s: float) -> float:
    """Share of a change of the equilibrium that a conductor can have followed after this time."""
    return -math.expm1(-max(after_s, 0.0) / TAU_S)


def thermal_density(change: Change) -> float:
    """Probability density, 1/K, of this change in a conductor that heats and cools."""
    share = reached(change.after_s)
    stepping = -math.expm1(max(1.0, change.after_s / TAU_S) * math.log1p(-STEP_SHARE))
    possible = min(abs(change.kelvin), STEP_MAX_K * share)
    density = (1 - stepping) * normal(possible, math.hypot(ORDINARY_K * share, change.u))
    density += stepping * normal(possible, math.hypot(STEP_K * share, change.u))
    # beyond what heat can do, only the readings' own uncertainty explains the rest
    return density * math.exp(-0.5 * ((abs(change.kelvin) - possible) / change.u) ** 2)


def shared_density(change: Change, others: Sequence[Change]) -> float:
    """The same where the changes of the span's other conductors in that time are known; any of them may be followed."""
    own = thermal_density(change)
    if not others:
        return own
    following = 0.0
    for other in others:
        spread = math.hypot(FOLLOW_K, FOLLOW_REL * other.kelvin)
        following += normal(change.kelvin - other.kelvin, math.hypot(spread, math.hypot(change.u, other.u)))
    return (1 - FOLLOW_SHARE) * own + FOLLOW_SHARE * following / len(others)


def odds_of_mistake(since: Sequence[tuple[Change, Sequence[Change]]], range_k: float) -> float:
    """Odds that a reading is none of this conductor's, against a change that heat and wind explain.

    A change that all conductors share is judged by what heat can do, and one that they do not share by that as well.

    Args:
        since: changes since earlier readings of this conductor, newest first and at least one, each with the changes
            of the other conductors in the same time.
        range_k: width of the range in which a mistaken reading may lie, K.
    """
    weights = WEIGHTS[: len(since)]
    pairs = list(zip(weights, since, strict=False))
    own = sum(w * thermal_density(change) for w, (change, _) in pairs) / sum(weights)
    shared = sum(w * shared_density(change, others) for w, (change, others) in pairs) / sum(weights)
    mistaken = MISTAKE_SHARE / range_k
    return mistaken / max((1 - MISTAKE_SHARE) * min(own, shared), 1e-300)


def normal(x: float, sigma: float) -> float:
    """Density of the normal distribution of mean zero."""
    return math.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
