"""Inner loops in C, where calling NumPy would cost more than the arithmetic (docs/decisions/0008).

Every function here has its equal in NumPy, in the room that calls it; that one says what it means, runs where the
extension is missing, and is what the tests hold this one against. ``SAGNODE_NATIVE=0`` in the environment leaves the
extension out, for comparisons.
"""

from __future__ import annotations

import importlib
import os
from types import ModuleType

INTERFACE = 16
"""Of the compiled module that this version knows how to call; one that was built from other sources is left out."""


def _load() -> tuple[ModuleType | None, str]:
    if os.environ.get("SAGNODE_NATIVE", "1") == "0":
        return None, "left out, as SAGNODE_NATIVE=0 says"
    try:
        built = importlib.import_module("sagnode.native._kernels")
    except ModuleNotFoundError:
        return None, "they were not built when sagnode was installed"
    except ImportError as error:
        return None, f"they cannot be loaded: {error}"
    if built.INTERFACE != INTERFACE:
        return None, "they were built from the sources of another version"
    return built, ""


kernels, why_not = _load()
"""The compiled functions (see ``_kernels.pyi``), or None where there are none, and then why."""
