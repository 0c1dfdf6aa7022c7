"""Lines on a picture, as the overlay of a reading and the picture of a plan draw them."""

from __future__ import annotations

import numpy as np

from sagnode.overlay import draw_runs

RED = (0, 0, 255)


def drawn(pixels: list[tuple[float, float]], shown: list[bool]) -> np.ndarray:
    canvas = np.zeros((40, 60, 3), np.uint8)
    draw_runs(canvas, np.array(pixels, dtype=float), np.array(shown), RED)
    return canvas[:, :, 2]


def test_a_line_is_broken_where_it_is_not_shown() -> None:
    nowhere = (np.nan, np.nan)
    red = drawn([(5, 20), (15, 20), nowhere, (35, 20), (45, 20)], [True, True, False, True, True])
    assert (red[20, 6:15] > 200).all()
    assert not red[:, 17:34].any()
    assert (red[20, 36:45] > 200).all()


def test_a_point_alone_is_no_line() -> None:
    assert not drawn([(5, 20), (15, 20), (25, 20)], [False, True, False]).any()
    assert not drawn([(5, 20), (15, 20)], [False, False]).any()


def test_a_line_runs_between_pixels_as_well() -> None:
    red = drawn([(5, 20.5), (45, 20.5)], [True, True])
    assert abs(int(red[20, 25]) - int(red[21, 25])) < 10 < red[20, 25]
