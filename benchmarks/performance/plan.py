"""How much is measured: the quick plan of ``make bench``, or the thorough one of a release."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path

ENVIRONMENT = "SAGNODE_PERFORMANCE_PLAN"
"""Carries the plan to the cases, which pytest collects in the same process."""


@dataclass(frozen=True)
class Plan:
    """Counts of everything; templates of the literal method are multiplied up to its 300."""

    folder: Path
    thorough: bool
    rounds: int
    slow_rounds: int
    literal_templates: dict[str, int]
    widths: tuple[int, ...]
    burst_frames: dict[str, tuple[int, ...]]
    daemon_readings: int
    """Of all conductors."""
    worker_readings: int
    soak_s: float
    """After so many seconds a soak ends with the readings that it has."""
    idle_interval_s: float
    """At least; longer where a reading takes long."""
    idle_readings: int
    written_readings: int
    worlds: int
    """Of each group of the scene suite."""


def quick(folder: Path) -> Plan:
    """A few minutes."""
    return Plan(
        folder=folder,
        thorough=False,
        rounds=15,
        slow_rounds=2,
        literal_templates={"lab": 75, "tower": 20, "field": 6},
        widths=(728, 1456, 2912),
        burst_frames={"lab": (1, 2, 4, 8), "tower": (1, 2, 4, 8), "field": (1, 8)},
        daemon_readings=1200,
        worker_readings=1200,
        soak_s=30.0,
        idle_interval_s=8.0,
        idle_readings=8,
        written_readings=120,
        worlds=1,
    )


def thorough(folder: Path) -> Plan:
    """The numbers of a release: an hour, half of which are the soaks."""
    return replace(
        quick(folder),
        thorough=True,
        rounds=15,
        slow_rounds=5,
        literal_templates={"lab": 300, "tower": 300, "field": 60},
        daemon_readings=10_000,
        worker_readings=10_000,
        soak_s=900.0,
        idle_interval_s=30.0,
        idle_readings=24,
        written_readings=600,
        worlds=4,
    )


def current() -> Plan:
    """The plan of this process.

    Raises:
        KeyError: there is none: the cases are run by ``benchmarks/performance/run.py`` only.
    """
    document = json.loads(os.environ[ENVIRONMENT])
    document["folder"] = Path(document["folder"])
    document["widths"] = tuple(document["widths"])
    document["burst_frames"] = {view: tuple(counts) for view, counts in document["burst_frames"].items()}
    return Plan(**document)


def announce(plan: Plan) -> None:
    """Make it the plan of this process."""
    os.environ[ENVIRONMENT] = json.dumps(asdict(plan), default=str)
