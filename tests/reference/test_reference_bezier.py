import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.reference.bezier import bezier_points, fitted_handle, lowest_point, stationary_parameters

pixel = st.tuples(st.floats(-500, 4500), st.floats(-500, 3500))


@settings(deadline=None)
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


def test_the_fitted_handle_gives_a_quadratic_curve_back():
    control = np.array([[0.0, 10.0], [70.0, 90.0], [200.0, -5.0]])
    # sampled so that equal steps are not equal parameters
    curve = bezier_points(control, np.linspace(0, 1, 500) ** 2)
    assert fitted_handle(curve) == pytest.approx(control[1], abs=0.05)


def test_the_fitted_curve_stays_close_to_a_curve_in_strong_perspective():
    s = np.linspace(0, 1, 2001)
    # a strong perspective: depth grows tenfold along the curve
    curve = np.stack([900 * s, 400 * s * (1 - s) + 100 * s], axis=1) / (1 + 9 * s)[:, None]
    fitted = bezier_points(np.stack([curve[0], fitted_handle(curve), curve[-1]]), s)
    nearest = np.min(np.hypot(*(curve[::10, None] - fitted[None, ::10]).transpose(2, 0, 1)), axis=1)
    assert float(np.sqrt(np.mean(nearest**2))) < 6.0
