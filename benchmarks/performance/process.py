"""What Linux says of a process: memory, CPU time, bytes written. ``/proc`` only; nothing is added to the process."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path

_CPUCLOCK_SCHED = 2


def resident_kb(pid: int) -> int:
    """Resident memory now, kB."""
    return _status(pid, "VmRSS")


def peak_kb(pid: int) -> int:
    """Most resident memory since the start (or since :func:`forget_peak`), kB."""
    return _status(pid, "VmHWM")


def forget_peak(pid: int) -> None:
    """Begin the peak anew at what is resident now."""
    Path(f"/proc/{pid}/clear_refs").write_text("5", encoding="ascii")


def cpu_s(pid: int) -> float:
    """CPU time of a process with all its threads, those that have ended too, s, to the nanosecond.

    ``stat`` has ticks, too coarse for an idle process. The process's own clock is named after its id
    (clock_getcpuclockid(3); CPUCLOCK_SCHED in linux/posix-timers.h).
    """
    return time.clock_gettime((~pid << 3) | _CPUCLOCK_SCHED)


def written_bytes(pid: int) -> int:
    """Bytes that the process has handed to the storage layer (``write_bytes``: dirtied pages, at their full size)."""
    return _field(Path(f"/proc/{pid}/io"), "write_bytes")


def _status(pid: int, name: str) -> int:
    return _field(Path(f"/proc/{pid}/status"), name)


def _field(file: Path, name: str) -> int:
    found = re.search(rf"^{name}:\s+(\d+)", file.read_text(encoding="ascii", errors="replace"), re.MULTILINE)
    if found is None:
        raise ValueError(f"{file} has no {name}")
    return int(found.group(1))


@dataclass(frozen=True)
class Slope:
    """A straight line through readings of something, by least squares."""

    per_thousand: float
    """Growth for every thousand steps."""
    u: float
    """Its standard uncertainty, from the scatter of blocks about the line."""
    settled: float
    """Mean of the first block."""
    middle: float
    last: float
    """Mean of the last block."""
    steps: int


def slope(steps: list[float], values: list[float], settled: float = 0.25, blocks: int = 20) -> Slope:
    """The slope after the first ``settled`` share of the steps, in which caches and pools fill up.

    Neighbours are alike: memory stays at a height for a while. So the line goes through the means of blocks, and its
    uncertainty comes from their scatter, not from that of the single readings, which would promise too much.

    Raises:
        ValueError: fewer than twelve values are left.
    """
    import numpy as np

    x, y = np.array(steps, dtype=float), np.array(values, dtype=float)
    late = x >= x[0] + settled * (x[-1] - x[0])
    x, y = x[late], y[late]
    if len(x) < 12:
        raise ValueError(f"{len(x)} readings are too few for a slope")
    parts = np.array_split(np.arange(len(x)), min(blocks, len(x) // 3))
    at, mean = (np.array([part[index].mean() for index in parts]) for part in (x, y))
    centred = at - at.mean()
    inclination = float(centred @ mean / (centred @ centred))
    rest = mean - mean.mean() - inclination * centred
    u = float(np.sqrt(rest @ rest / (len(at) - 2) / (centred @ centred)))
    middle = float(mean[len(mean) // 2])
    return Slope(1000 * inclination, 1000 * u, float(mean[0]), middle, float(mean[-1]), int(x[-1]))
