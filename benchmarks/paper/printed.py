"""What the paper prints: tables 3 to 9 and the sentences that rest on them."""

from __future__ import annotations

CLEARANCE_CM = 18.0
"""Section 4.1, right line; the left one has 21 cm. Its percentages are of these."""

TABLE_3 = (
    ("left", "Method 1", 1.30, 6.2),
    ("right", "Method 1", 1.10, 6.1),
    ("left", "Method 2", 0.128, 0.6),
    ("right", "Method 2", 0.445, 2.5),
)
"""Target, method, error cm, error % of the clearance."""
TABLE_4 = (("right", "Bézier", 0.37, 2.0), ("left", "Bézier", 0.04, 0.2))
TABLE_5 = {"mean": 0.21, "sd": 0.09, "rmse": 0.23, "interval": (0.17, 0.25)}
"""cm, over 30 experiments."""
TABLE_6 = {
    "curve points": (50.0, 20.0),
    "perspective": (70.0, 0.0),
    "matching": (413.0, 313.0),
}
"""ms for a template, hyperbolic cosine and Bézier, on a Raspberry Pi 5."""
FASTER = 1.5
"""Times that Bézier templates are said to be faster, at least."""
TABLE_8 = (("right", 5.33, 2.00), ("left", 1.98, 0.20), ("average", 3.65, 1.10))
"""% of the clearance, distorted and corrected picture."""
TABLE_9 = {"Bézier": (6.12, 6.39), "Method 2": (6.98, 6.39)}
"""Clearance as measured and true, m."""
FIGURE_4_BEST = "TM_CCOEFF_NORMED"
