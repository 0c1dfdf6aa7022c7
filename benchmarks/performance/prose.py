"""Sentences of the report."""

from __future__ import annotations

import math


def flow(text: str) -> str:
    """One line out of a text that is broken and indented as the source has it.

    >>> flow('''a
    ...     b''')
    'a b'
    """
    return " ".join(text.split())


def told(value: float, u: float) -> str:
    """A quantity that cannot be negative with its standard uncertainty; a bound where it does not show.

    >>> told(2.566, 0.148), told(9.594, 0.08), told(0.0, 0.0), told(0.01, 0.02), told(-0.3, 0.1)
    ('2.57 ± 0.15', '9.59 ± 0.08', '0', 'under 0.05', 'under 0.20')
    """
    if value <= 0 and u == 0:
        return "0"
    if value < 2 * u:
        # zero is within reach: all that is known is how much it is not
        most = max(value, 0.0) + 2 * u
        return f"under {most:.{places(most)}f}"
    return f"{value:.{places(u)}f} ± {u:.{places(u)}f}"


def places(u: float) -> int:
    """Decimals that a number with this uncertainty deserves: two digits of it, and no more than two."""
    return 2 if u <= 0 else max(0, min(2, 1 - math.floor(math.log10(u))))
