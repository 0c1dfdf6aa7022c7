"""The same frames with and without the compiled kernels, each way in processes of its own.

Whether the kernels are used is decided when :mod:`sagnode.native` is imported; ``SAGNODE_NATIVE=0`` leaves them out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from performance.frames import NAMES, shot
from performance.node import write_node
from performance.plan import Plan
from sagnode import native

CHILD = Path(__file__).with_name("child.py")
TURNS = 2
"""Processes of each kind, by turns, so that what else the machine does falls on both."""


def measure(plan: Plan) -> dict[str, Any]:
    """By view: both times and how far the numbers are apart; ``compiled``: whether this process has kernels at all.

    Raises:
        RuntimeError: new processes have them where this one has not, or the other way round.
    """
    views = {name: _both(plan, name) for name in NAMES}
    compiled = native.kernels is not None
    if any(row["compiled"] != compiled for row in views.values()):
        raise RuntimeError("the source or its compiled part has changed since this run began: run it again")
    return {"compiled": compiled, "views": views}


def _both(plan: Plan, name: str) -> dict[str, Any]:
    node = write_node(shot(name, plan.folder), plan.folder / f"node-{name}").path
    with_, without = [], []
    for _ in range(TURNS):
        with_.append(_run(node, "1"))
        without.append(_run(node, "0"))
    assert not any(run["compiled"] for run in without)
    return {
        "compiled": with_[0]["compiled"],
        "with_s": min(run["cpu_s"] for run in with_),
        "without_s": min(run["cpu_s"] for run in without),
        "apart": apart(with_[0]["sags"], without[0]["sags"]),
    }


def _run(node: Path, native: str) -> dict[str, Any]:
    words = [sys.executable, str(CHILD), "timed", str(node)]
    environment = os.environ | {"SAGNODE_NATIVE": native}
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True, text=True, env=environment)
    return dict(json.loads(done.stdout))


def apart(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Largest difference of a sag, in its standard uncertainty.

    Args:
        one: by conductor, value and standard uncertainty in m; None where none is told.
        other: the same, of the other way.

    Raises:
        RuntimeError: one of them tells a sag where the other does not.
    """
    if {name: told is None for name, told in one.items()} != {name: told is None for name, told in other.items()}:
        raise RuntimeError("with and without the compiled kernels different conductors are measured")
    return max((abs(a[0] - other[name][0]) / a[1] for name, a in one.items() if a is not None), default=0.0)
