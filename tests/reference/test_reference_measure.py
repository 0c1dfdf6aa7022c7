"""The paper's methods in the paper's laboratory: its camera matrix, 2.7 m of span seen from 2.5 m."""

from dataclasses import replace

import numpy as np
import pytest
from reference_laboratory import (
    CAMERA_HEIGHT,
    DEPTH,
    GROUND,
    HEIGHT,
    SAG,
    K,
    catenary_pixels,
    picture,
    site,
    with_distortion,
)

from sagnode.geometry.camera import distort
from sagnode.quality import Cause, Validity
from sagnode.reference.matching import WHOLE_FRAME
from sagnode.reference.measure import PAPER, Settings, measure_by_reference

QUICK = Settings(whole_map=False)
METHODS = ["paper-bezier", "cosh", "cosh-perspective"]


@pytest.fixture(scope="module")
def frontal():
    return picture(catenary_pixels(SAG))


@pytest.mark.parametrize("method", METHODS)
def test_sag_of_the_laboratory_is_found_within_a_few_per_cent(tmp_path, frontal, method):
    [result] = measure_by_reference(site(tmp_path, method), frontal, QUICK)
    assert result.method == method
    assert result.estimates["sag"].value == pytest.approx(SAG, rel=0.03)
    assert result.estimates["lowest_height"].value == pytest.approx(HEIGHT - SAG, abs=0.01)
    assert result.estimates["drop"].value == pytest.approx(SAG, rel=0.03)
    assert result.estimates["clearance"].value == pytest.approx(HEIGHT - SAG - GROUND, abs=0.01)


def test_the_whole_correlation_map_gives_the_same_result(tmp_path, frontal):
    place = site(tmp_path, "paper-bezier")
    [literal] = measure_by_reference(place, frontal, PAPER)
    [quick] = measure_by_reference(place, frontal, QUICK)
    assert quick.estimates == literal.estimates
    assert quick.match_score == pytest.approx(literal.match_score, abs=1e-5)


def test_what_is_found_is_questionable_and_says_whose_uncertainty_it_is(tmp_path, frontal):
    [result] = measure_by_reference(site(tmp_path, "paper-bezier"), frontal, QUICK)
    assert result.validity is Validity.QUESTIONABLE
    assert [r.cause for r in result.reasons] == [Cause.UNCERTAIN]
    assert "for comparison only" in result.reasons[0].text
    sag = result.estimates["sag"]
    assert sag.u == pytest.approx(0.0018 * sag.value)
    assert result.budget["sag"] == {"stated by the paper": sag.u}
    assert (sag.lo, sag.hi) == pytest.approx((sag.value - 1.96 * sag.u, sag.value + 1.96 * sag.u))


@pytest.mark.parametrize("method", METHODS)
def test_an_empty_picture_gives_no_number(tmp_path, method):
    empty = np.full((K.height, K.width), 180, np.uint8)
    [result] = measure_by_reference(site(tmp_path, method), empty, QUICK)
    assert result.validity is Validity.INVALID
    assert result.reasons[0].cause is Cause.NO_CONDUCTOR
    assert not result.estimates


def test_a_conductor_below_the_top_quadrants_is_found_only_in_the_whole_frame(tmp_path):
    lowered = catenary_pixels(SAG) + np.array([0.0, 240.0])
    image = picture(lowered)
    place = site(tmp_path, "paper-bezier")
    raised = replace(place.pose, position=place.pose.position + np.array([0.0, 0.0, 240.0 * DEPTH / K.fy]))
    place = replace(place, pose=raised)
    [literal] = measure_by_reference(place, image, QUICK)
    assert literal.validity is Validity.INVALID
    [whole] = measure_by_reference(place, image, replace(QUICK, roi=WHOLE_FRAME))
    assert whole.estimates["sag"].value == pytest.approx(SAG, rel=0.03)


def test_unequal_heights_are_beyond_the_hyperbolic_cosine(tmp_path):
    """Section 4.6: a symmetric cosine misses the far attachment of an inclined span; the Bézier curve does not."""
    rise = 0.16
    image = picture(catenary_pixels(SAG, rise))
    lowest = float(np.max(catenary_pixels(SAG, rise)[:, 1]))
    lowest_height = CAMERA_HEIGHT - (lowest - K.cy) * DEPTH / K.fy
    errors = {}
    for method in METHODS:
        [result] = measure_by_reference(site(tmp_path, method, rise), image, QUICK)
        errors[method] = abs(result.estimates["lowest_height"].value - lowest_height)
    assert errors["paper-bezier"] < 0.012
    assert errors["paper-bezier"] < errors["cosh"]


def test_the_lens_is_undone_before_matching_unless_switched_off(tmp_path):
    lens = with_distortion()
    pixels = catenary_pixels(SAG)
    x, y = distort(lens, (pixels[:, 0] - K.cx) / K.fx, (pixels[:, 1] - K.cy) / K.fy)
    image = picture(np.stack([K.fx * x + K.cx, K.fy * y + K.cy], axis=1))
    [with_lens] = measure_by_reference(site(tmp_path, "paper-bezier", intrinsics=lens), image, QUICK)
    off = site(tmp_path, "paper-bezier", intrinsics=lens, undistort=False)
    [without] = measure_by_reference(off, image, QUICK)
    assert with_lens.estimates["sag"].value == pytest.approx(SAG, rel=0.03)
    assert with_lens.match_score > 1.5 * without.match_score


def test_fictive_line_and_derivative_agree_in_the_frontal_view(tmp_path, frontal):
    place = site(tmp_path, "paper-bezier")
    [by_derivative] = measure_by_reference(place, frontal, QUICK)
    [by_line] = measure_by_reference(place, frontal, replace(QUICK, fictive_line=True))
    assert by_line.estimates["sag"].value == pytest.approx(by_derivative.estimates["sag"].value, rel=0.005)


def test_a_curve_for_an_overlay_lies_on_the_wire(tmp_path, frontal):
    [result] = measure_by_reference(site(tmp_path, "paper-bezier"), frontal, QUICK)
    assert result.drawing is not None
    true = catenary_pixels(SAG)
    gap = np.abs(np.interp(result.drawing.curve[:, 0], true[:, 0], true[:, 1]) - result.drawing.curve[:, 1])
    assert float(np.median(gap)) < 1.5
