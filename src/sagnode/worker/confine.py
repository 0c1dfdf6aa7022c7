"""What the worker does to itself so that it can harm nobody: dies with its parent, keeps to its memory, dies first.

Linux only; each measure that the kernel refuses is skipped, because a worker without it is still worth more than none.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
from pathlib import Path

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_PAGE = os.sysconf("SC_PAGE_SIZE")


def die_with_parent(parent_pid: int) -> bool:
    """Have the kernel kill this process when its parent ends; False when the parent has gone already.

    The pipe's end-of-file tells an idle worker the same; this holds for one that hangs in a driver.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    return os.getppid() == parent_pid


def limit_growth(growth_mb: int) -> None:
    """Allow ``growth_mb`` more address space than is mapped now; beyond it allocations fail, in this process only.

    Growth and not a total: libraries map hundreds of megabytes that are never touched.
    """
    mapped = _statm()[0]
    with contextlib.suppress(ValueError, OSError):  # a lower hard limit is in force already
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = mapped + growth_mb * 1024 * 1024
        resource.setrlimit(resource.RLIMIT_AS, (limit if hard < 0 else min(limit, hard), hard))


def volunteer_for_oom() -> None:
    """When the machine runs out of memory, take this process and not the daemon."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("900")


def resident_mb() -> float:
    """Resident memory of this process, megabytes."""
    return _statm()[1] / 1e6


def _statm() -> tuple[int, int]:
    size, resident = Path("/proc/self/statm").read_text().split()[:2]
    return int(size) * _PAGE, int(resident) * _PAGE
