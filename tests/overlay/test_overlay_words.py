"""Words on a drawing give way to each other and to marks, and stay above the legend."""

from __future__ import annotations

import cv2
from hypothesis import given
from hypothesis import strategies as st

from sagnode.overlay import Words

SCALE = 0.5
Box = tuple[int, int, int, int]


def box(text: str, at: tuple[int, int]) -> Box:
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, SCALE, 1)
    return at[0], at[1] - height, at[0] + width, at[1]


def overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def test_a_word_that_has_room_stays_where_it_is_wanted() -> None:
    words = Words()
    assert words.place("L1 6.54 m", (100, 50), SCALE) == (100, 50)
    assert words.place("L2 6.51 m", (100, 150), SCALE) == (100, 150)


@given(st.lists(st.tuples(st.integers(0, 400), st.integers(100, 300)), min_size=1, max_size=12))
def test_words_cover_neither_each_other_nor_a_mark(wanted: list[tuple[int, int]]) -> None:
    words = Words()
    mark = (180, 180, 220, 220)
    words.take(*mark)
    boxes = [box("L1 6.54 m", words.place("L1 6.54 m", at, SCALE)) for at in wanted]
    assert not any(overlap(one, mark) for one in boxes)
    assert not any(overlap(one, other) for k, one in enumerate(boxes) for other in boxes[:k])


def test_where_there_is_no_room_below_a_word_goes_up() -> None:
    words = Words()
    places = [words.place("L1 6.54 m", (100, 195), SCALE, lowest=200) for _ in range(3)]
    assert places[0] == (100, 195)
    assert places[1][1] < 195 - 10
    assert places[2][1] < places[1][1] - 10
    assert words.place("far below", (300, 900), SCALE, lowest=200) == (300, 200)
