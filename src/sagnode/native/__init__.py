"""Inner loops in C, where calling NumPy would cost more than the arithmetic (docs/decisions/0008).

Every function here has its equal in NumPy, in the room that calls it; that one says what it means, runs where the
extension is missing, and is what the tests hold this one against. ``SAGNODE_NATIVE=0`` in the environment leaves the
extension out, for comparisons.
"""

from __future__ import annotations

import os
from types import ModuleType

INTERFACE = 4
"""Of the compiled module that this version knows how to call; one that was built from other sources is left out."""


def _load() -> ModuleType | None:
    if os.environ.get("SAGNODE_NATIVE", "1") == "0":
        return None
    try:
        from sagnode.native import _kernels
    except ImportError:
        return None
    return _kernels if _kernels.INTERFACE == INTERFACE else None


kernels = _load()
"""The compiled functions (see ``_kernels.pyi``), or None where there are none."""
