import cv2
import numpy as np
import pytest

from sagnode.reference.bezier import bezier_points
from sagnode.reference.matching import (
    MODES,
    TOP_QUADRANTS,
    WHOLE_FRAME,
    Roi,
    Template,
    best_match,
    draw_template,
)

T = np.linspace(0, 1, 401)


def curves(depths, start=(40.0, 30.0), width=240.0):
    for depth in depths:
        p0 = np.array(start)
        control = np.stack([p0, p0 + np.array([width / 2, 2 * depth]), p0 + np.array([width, 0.0])])
        yield Template(bezier_points(control, T), control)


def wire_picture(depth, start=(40.0, 30.0)):
    image = np.full((320, 400), 200, np.uint8)
    curve = next(iter(curves([depth], start)))
    cv2.polylines(image, [np.round(curve.points).astype(np.int32).reshape(-1, 1, 2)], False, 40, 2, cv2.LINE_AA)
    return image


def test_regions_are_quadrants():
    assert TOP_QUADRANTS.box((541, 960)) == (0, 0, 960, 270)
    assert WHOLE_FRAME.box((541, 960)) == (0, 0, 960, 541)
    assert Roi(rows=(1, 2), columns=(0, 1)).box((540, 960)) == (0, 270, 480, 540)


def test_template_is_one_pixel_wide_and_fills_its_box():
    template = next(iter(curves([50.0])))
    drawn, origin = draw_template(template.points)
    assert set(np.unique(drawn)) == {0, 255}
    assert list(origin) == [40, 30]
    assert drawn.shape == (51, 241)
    assert drawn[0, 0] == 255
    assert drawn[0, -1] == 255
    # on the flat part one pixel a column
    assert np.all((drawn[:, 100:140] > 0).sum(axis=0) == 1)


@pytest.mark.parametrize("mode", ["TM_CCOEFF_NORMED", "TM_CCORR_NORMED"])
def test_normalised_correlation_finds_the_drawn_curve(mode):
    match = best_match(wire_picture(60.0), curves(np.arange(40.0, 81.0)), TOP_QUADRANTS, (50, 150), mode)
    assert match is not None
    assert 40.0 + match.index == pytest.approx(60.0, abs=3.0)


@pytest.mark.parametrize("mode", MODES)
def test_all_six_modes_of_figure_4_choose_a_template_that_starts_at_the_anchor(mode):
    """Only the normalised correlations are fit for thin edges.

    The plain sums favour templates with few (squared difference) or many (correlation) pixels, and OpenCV cuts the
    normalised squared difference off at 1, which every sparse pair of edge pictures exceeds.
    """
    match = best_match(wire_picture(60.0), curves(np.arange(40.0, 81.0)), TOP_QUADRANTS, (50, 150), mode)
    assert match is not None
    assert match.template.points[0] == pytest.approx([40.0, 30.0], abs=1.01)


def test_a_wire_that_starts_elsewhere_is_not_taken():
    """Section 3.5: only templates whose start is met to a pixel count, so the upper line is not taken for the lower."""
    two = np.minimum(wire_picture(60.0, (40.0, 30.0)), wire_picture(40.0, (40.0, 42.0)))
    match = best_match(two, curves(np.arange(20.0, 81.0), (40.0, 42.0)), TOP_QUADRANTS, (50, 150), "TM_CCOEFF_NORMED")
    assert match is not None
    assert match.template.points[0] == pytest.approx([40.0, 42.0], abs=1.01)
    assert 20.0 + match.index == pytest.approx(40.0, abs=2.0)


def test_a_shift_of_a_pixel_is_found():
    match = best_match(wire_picture(60.0), curves([60.0], (39.0, 31.0)), TOP_QUADRANTS, (50, 150), "TM_CCOEFF_NORMED")
    assert match is not None
    assert match.template.points[0, 0] == pytest.approx(40.0)


def test_nothing_matches_outside_the_region_or_without_edges():
    mode = "TM_CCOEFF_NORMED"
    low = wire_picture(60.0, (40.0, 200.0))
    assert best_match(low, curves(np.arange(40.0, 81.0), (40.0, 200.0)), TOP_QUADRANTS, (50, 150), mode) is None
    assert best_match(low, curves(np.arange(40.0, 81.0), (40.0, 200.0)), WHOLE_FRAME, (50, 150), mode) is not None
    blank = np.full((320, 400), 128, np.uint8)
    assert best_match(blank, curves([50.0, 60.0]), WHOLE_FRAME, (50, 150), mode) is None
