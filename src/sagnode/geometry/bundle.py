r"""Bundles: where the sub-conductors run about the centre line that is measured, and that its attachments mean.

::

    2:  o---o     3:  o---o     4:  o---o      seen from A along the chord; the spacing is the side of the figure
                       \ /          |   |      and a fitting keeps it upright, whatever the wind does
                        o           o---o
"""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray


def sub_conductor_offsets(near: FloatArray, far: FloatArray, count: int, spacing: float) -> FloatArray:
    """Places (count, 3) of a bundle's sub-conductors about its centre line, m, site frame; perpendicular to the chord.

    Args:
        near: attachment A of the centre line (3,).
        far: attachment B (3,).
        count: sub-conductors, 1 to 4; a single wire is its own centre line.
        spacing: side of the bundle, m.
    """
    half, below = 0.5 * spacing, spacing / np.sqrt(12.0)
    layouts: dict[int, list[tuple[float, float]]] = {
        1: [(0.0, 0.0)],
        2: [(-half, 0.0), (half, 0.0)],
        3: [(-half, below), (half, below), (0.0, -2 * below)],
        4: [(-half, half), (half, half), (-half, -half), (half, -half)],
    }
    chord = (far - near) / np.linalg.norm(far - near)
    right = np.array([chord[1], -chord[0], 0.0])
    right /= max(float(np.linalg.norm(right)), 1e-12)
    up = np.cross(right, chord)
    return np.asarray(np.array(layouts[count]) @ np.stack([right, up]))
