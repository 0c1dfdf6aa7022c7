"""A clock on the stages of the pipeline, put around the functions from outside: the product carries none of it.

The functions are found by name where their callers look them up. A name that is gone ends the benchmark with a message:
a stage that silently vanished from the table would look like a stage that costs nothing.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any


@dataclass(frozen=True)
class Stage:
    """A stage and the function that carries it out."""

    name: str
    module: str
    """Where the caller looks the function up."""
    function: str
    within: str | None = None
    """The stage that it is a part of."""


STAGES = (
    Stage("look", "sagnode.pipeline", "look"),
    Stage("register", "sagnode.pipeline", "register"),
    Stage("locate", "sagnode.pipeline", "locate"),
    Stage("library", "sagnode.match.library", "draw_library", "locate"),
    Stage("search", "sagnode.estimate.even", "search", "locate"),
    Stage("refine", "sagnode.estimate.refinement", "observe", "locate"),
    Stage("solve", "sagnode.estimate.refinement", "solve", "locate"),
    Stage("tell", "sagnode.pipeline", "tell"),
    Stage("judge", "sagnode.estimate.tell", "judge", "tell"),
)
"""In the order of the way of a frame."""


class NameGone(Exception):
    """A function that the benchmark measures is no longer where it was."""


def bound(module: str, name: str) -> tuple[ModuleType, Any]:
    """A module and what it calls ``name``.

    Raises:
        NameGone: it has no such name any more.
    """
    found = importlib.import_module(module)
    if not hasattr(found, name):
        raise NameGone(f"{module}.{name} is gone; say in benchmarks/performance/ where that stage is now")
    return found, getattr(found, name)


@contextmanager
def replaced(module: str, name: str, value: Any) -> Iterator[Any]:
    """Put ``value`` in the place of a module's name for a while; gives what was there."""
    owner, original = bound(module, name)
    setattr(owner, name, value)
    try:
        yield original
    finally:
        setattr(owner, name, original)


@dataclass
class Spent:
    """Seconds of CPU and calls, by stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    calls: dict[str, int] = field(default_factory=dict)

    def rest(self, total_s: float) -> float:
        """What lies in no stage."""
        return total_s - sum(self.seconds.get(s.name, 0.0) for s in STAGES if s.within is None)


@contextmanager
def clocked() -> Iterator[Spent]:
    """Measure the CPU time of every stage while inside."""
    spent = Spent()
    originals = []
    for stage in STAGES:
        module, function = bound(stage.module, stage.function)
        originals.append((module, stage.function, function))
        setattr(module, stage.function, _timed(function, stage.name, spent))
    try:
        yield spent
    finally:
        for module, name, function in originals:
            setattr(module, name, function)


def _timed(function, name: str, spent: Spent):
    def timed(*args, **kwargs):
        began = time.process_time()
        try:
            return function(*args, **kwargs)
        finally:
            spent.seconds[name] = spent.seconds.get(name, 0.0) + time.process_time() - began
            spent.calls[name] = spent.calls.get(name, 0) + 1

    return timed
