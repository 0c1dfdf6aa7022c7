"""With how many digits lengths are written. Imports nothing that takes time: ``sagnode status`` writes lengths too."""

from __future__ import annotations

import math


def decimals(width: float) -> int:
    """Decimals of a metre that give an interval's width two significant digits: at least centimetres, at most 0.1 mm.

    >>> decimals(0.03), decimals(1.5), decimals(0.0), decimals(math.inf)
    (3, 2, 4, 2)
    """
    if not math.isfinite(width):
        return 2
    return 4 if width <= 0 else min(4, max(2, 1 - math.floor(math.log10(width))))
