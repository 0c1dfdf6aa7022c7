"""The paper's printed arithmetic: where it holds, and where it does not."""

import pytest

from sagnode.reference.uncertainty import paper_uncertainty, root_sum_of_squares, world_sigma


def test_pixel_budget_of_section_4_3_3_comes_out_as_printed():
    assert root_sum_of_squares(0.5, 1.2, 0.18) == pytest.approx(1.3, abs=0.05)


def test_the_pixel_budget_is_0_18_percent_of_the_span_but_2_6_percent_of_the_clearance():
    budget = paper_uncertainty(0.18, d_cam=2.5, f=689.2)
    span_px = 2.7 * 689.2 / 2.5
    assert 0.0015 < budget.total_px / span_px <= 0.0018
    assert budget.total_m / 0.18 == pytest.approx(0.026, abs=0.001)


def test_typical_conditions_of_section_3_4_4_do_not_give_the_printed_0_18_percent():
    budget = paper_uncertainty(0.18, d_cam=2.5, f=689.2)
    assert budget.world_m / 0.18 > root_sum_of_squares(0.005, 0.003)
    assert budget.world_m / 0.18 > 3 * 0.0018
    assert budget.stated_m == pytest.approx(0.0018 * 0.18)


def test_world_sigma_is_the_law_of_propagation():
    d, f, offset, h = 2.5, 690.0, 260.0, 1e-6

    def world(offset: float, d: float, f: float) -> float:
        return d * offset / f

    by_u = (world(offset + h, d, f) - world(offset - h, d, f)) / (2 * h)
    by_d = (world(offset, d + h, f) - world(offset, d - h, f)) / (2 * h)
    by_f = (world(offset, d, f + h) - world(offset, d, f - h)) / (2 * h)
    expected = root_sum_of_squares(by_u * 0.3, by_d * 0.005 * d, by_f * 0.003 * f)
    assert world_sigma(offset, d, f, 0.3, 0.005, 0.003) == pytest.approx(expected, rel=1e-6)
