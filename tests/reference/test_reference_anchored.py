"""The shortcut must be no approximation: its scores are those of cv2.matchTemplate, its winner is the literal one."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from sagnode.reference.anchored import anchored_scores, best_anchored, draw_library
from sagnode.reference.bezier import bezier_points
from sagnode.reference.matching import (
    MODES,
    TOP_QUADRANTS,
    WHOLE_FRAME,
    Template,
    best_match,
    draw_template,
    score_map,
)

T = np.linspace(0, 1, 401)
SIZE = (160, 400)
FULL = (0, 0, SIZE[1], SIZE[0])


def curve(depth, start=(40.0, 30.0), width=240.0):
    p0 = np.array(start)
    control = np.stack([p0, p0 + np.array([width / 2, 2 * depth]), p0 + np.array([width, 0.0])])
    return Template(bezier_points(control, T), control)


def edge_picture(seed, share=0.1, size=SIZE):
    return ((np.random.default_rng(seed).random(size) < share) * 255).astype(np.uint8)


@pytest.mark.parametrize("mode", MODES)
def test_scores_are_those_of_match_template_at_the_nine_places(mode):
    source, template = edge_picture(3), curve(60.0)
    drawn, (u, v) = draw_template(template.points)
    literal = score_map(source, drawn, mode)[v - 1 : v + 2, u - 1 : u + 2]
    scores = anchored_scores(source, draw_library([template], FULL), mode)[0]
    # the normalised scores lie within -1..1; the plain sums run up to 255² a template pixel
    size = 1.0 if mode.endswith("_NORMED") else 255.0**2 * np.count_nonzero(drawn)
    assert scores / size == pytest.approx(literal / size, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    share=st.floats(0.0, 0.6),
    depth=st.floats(0.0, 100.0),
    start=st.tuples(st.floats(-3.0, 60.0), st.floats(-3.0, 60.0)),
    width=st.floats(3.0, 380.0),
)
@example(seed=0, share=0.5, depth=0.0, start=(1.46875, 0.0), width=49.0)
def test_any_curve_in_any_edges_scores_as_match_template_does(seed, share, depth, start, width):
    """The score that the paper uses, wherever the box stands and whatever part of it hangs out of the picture."""
    source, template = edge_picture(seed, share), curve(depth, start, width)
    drawn, (u, v) = draw_template(template.points)
    # what fills its box, or misses it, has no contrast: OpenCV's answer for it depends on its width and the processor
    assume(0 < np.count_nonzero(drawn) < drawn.size)
    library = draw_library([template], FULL)
    scores = anchored_scores(source, library, "TM_CCOEFF_NORMED")
    if drawn.shape[0] > SIZE[0] or drawn.shape[1] > SIZE[1]:
        assert not np.isfinite(scores).any()
        return
    literal = score_map(source, drawn, "TM_CCOEFF_NORMED")
    for row, column in np.ndindex(3, 3):
        y, x = v + row - 1, u + column - 1
        inside = 0 <= y < literal.shape[0] and 0 <= x < literal.shape[1]
        if not len(library.index):
            assert not inside
        elif inside:
            # OpenCV sums in single precision, which a template that nearly fills its box makes the most of
            assert scores[0, row, column] == pytest.approx(literal[y, x], abs=1e-5)
        else:
            assert scores[0, row, column] == -np.inf


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("roi", [TOP_QUADRANTS, WHOLE_FRAME])
def test_the_winner_is_the_literal_searchs(mode, roi):
    image = np.full((320, 400), 200, np.uint8)
    wire = np.round(curve(61.0, (41.0, 30.0)).points).astype(np.int32)
    cv2.polylines(image, [wire.reshape(-1, 1, 2)], False, 40, 2, cv2.LINE_AA)
    library = [curve(d) for d in np.arange(21.0, 110.0, 4.0)]
    literal = best_match(image, library, roi, (50, 150), mode)
    sparse = best_anchored(image, library, roi, (50, 150), mode)
    assert sparse.index == literal.index
    assert sparse.score == pytest.approx(literal.score, rel=1e-5, abs=1e-6)
    assert sparse.template.points == pytest.approx(literal.template.points)


def test_nothing_is_found_without_edges_and_outside_the_region():
    blank = np.full((320, 400), 128, np.uint8)
    assert best_anchored(blank, [curve(60.0)], WHOLE_FRAME, (50, 150), "TM_CCOEFF_NORMED") is None
    library = draw_library([curve(60.0, (40.0, 140.0))], FULL)
    assert not len(library.index)
    assert anchored_scores(edge_picture(1), library, "TM_CCOEFF_NORMED").shape == (0, 3, 3)


def test_edges_of_another_size_are_refused():
    with pytest.raises(ValueError, match="library for"):
        anchored_scores(edge_picture(1, size=(10, 10)), draw_library([curve(20.0)], FULL), "TM_CCORR")


def test_a_template_of_which_nothing_is_drawn_is_left_out():
    library = draw_library([curve(0.0, (0.0, 1.484375), 3.0), curve(60.0)], FULL)
    assert list(library.index) == [1]
    assert np.isfinite(anchored_scores(edge_picture(3), library, "TM_CCOEFF_NORMED")[-1]).any()
