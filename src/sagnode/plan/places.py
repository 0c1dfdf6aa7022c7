"""Places for a camera, counted along a span, off it and above the ground."""

from __future__ import annotations

import numpy as np

from sagnode.config.span import Span
from sagnode.scene.spec import SpanFrame, ground_height


def grid_places(
    span: Span, along: list[float], right: list[float], up: list[float]
) -> list[tuple[float, float, float]]:
    """Places in the site frame for every combination.

    Args:
        span: the survey.
        along: distances from A of the first measured conductor along the span, m.
        right: distances to the right of its line, seen from A, m; off the line the ground is taken to be as high.
        up: heights above the ground, m.
    """
    frame = SpanFrame.of(span)
    places = np.array([(a, r, h) for a in along for r in right for h in up])
    places[:, 2] += ground_height(span, places[:, 0])
    return [(float(x), float(y), float(z)) for x, y, z in frame.to_site(places)]
