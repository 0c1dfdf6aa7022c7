import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sagnode.reference.bezier import bezier_points, handle, lowest_point, stationary_parameters

pixel = st.tuples(st.floats(-500, 4500), st.floats(-500, 3500))


@given(pixel, pixel, pixel)
def test_lowest_point_is_the_lowest_of_all_points(p0, p1, p2):
    control = np.array([p0, p1, p2])
    dense = bezier_points(control, np.linspace(0, 1, 20001))
    found = lowest_point(control)
    assert found[1] >= dense[:, 1].max() - 1e-9
    # the extreme of a parabola lies at most h²/8·|second difference| above the best of samples h apart
    second = 2 * abs(control[0, 1] - 2 * control[1, 1] + control[2, 1])
    assert found[1] <= dense[:, 1].max() + second / 8 / 20000**2 + 1e-9


def test_both_solutions_of_the_derivative_are_given_where_the_curve_turns_back_in_x_too():
    by_x, by_y = stationary_parameters(np.array([[0.0, 0.0], [10.0, 8.0], [4.0, 2.0]]))
    assert by_x == pytest.approx(10 / 16)
    assert by_y == pytest.approx(8 / 14)


def test_a_symmetric_curve_has_no_solution_by_x_and_its_lowest_point_in_the_middle():
    control = np.array([[100.0, 50.0], [400.0, 250.0], [700.0, 50.0]])
    assert stationary_parameters(control) == (None, 0.5)
    assert lowest_point(control) == pytest.approx([400.0, 150.0])


def test_a_curve_that_falls_all_the_way_is_lowest_at_its_end():
    assert lowest_point(np.array([[0.0, 0.0], [10.0, 10.0], [20.0, 40.0]])) == pytest.approx([20, 40])


def test_end_tangents_meet_in_the_handle():
    control = np.array([[0.0, 10.0], [70.0, 90.0], [200.0, -5.0]])
    assert handle(control[0], control[1] - control[0], control[2], control[2] - control[1]) == pytest.approx(control[1])
    assert handle(control[0], np.array([1.0, 0]), control[2], np.array([2.0, 0])) is None
