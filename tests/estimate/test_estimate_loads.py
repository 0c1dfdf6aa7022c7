"""Kinds of uneven loads, offsets that slide along a curve, and what all loads together leave of a wire partly seen."""

from dataclasses import replace

import numpy as np
import pytest

from sagnode.estimate.camera import NOTHING_KNOWN
from sagnode.estimate.joint import solve
from sagnode.estimate.load_kinds import LOAD_U, TERMS, any_single, kinds
from sagnode.estimate.offsets import FINEST_LOAD, CurveObservations, curve_residual, slid
from sagnode.estimate.weigh import solve_loads
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, project, rotation_from_angles
from sagnode.geometry.conductor import finer_load_shapes
from sagnode.geometry.single_load import single_load_terms
from sagnode.scene.catenary import Load, PartialLoad, PointLoad, WireState, wire_points
from sagnode.survey import LOAD, SAG, SWING, Survey

LOADS = [PointLoad(0.35, 0.08, 0.0), PointLoad(0.7, 0.12, 0.0), PartialLoad(0.3, 0.7, 0.8), PartialLoad(0.55, 0.9, 0.5)]


def survey_along_the_line() -> Survey:
    """From a tower, a little below and beside the wire, along a span of 300 m."""
    return Survey(
        Intrinsics(1456, 1088, 2050.0, 2050.0, 728.0, 544.0),
        Pose(rotation_from_angles(0.0, -4.0, 0.0), np.array([0.0, -2.0, 22.0])),
        np.array([3.0, 0.0, 27.0]),
        np.array([3.0, 300.0, 27.0]),
        orientation_u=1e-4,
        position_u=0.005,
        focal_u_rel=1e-4,
        principal_point_u=0.1,
        distortion_u=1e-4,
        attachment_u=0.01,
        sag_range=(5.0, 12.0),
        swing_u=np.radians(8.0),
        load_u=LOAD_U,
        load_prior=any_single(),
    )


def offsets_of(survey: Survey, state: WireState, t: FloatArray) -> CurveObservations:
    """Offsets of a truly loaded wire at some places, as a curve that lies on it would have measured them."""
    points = wire_points(survey.near, survey.far, state, np.concatenate([t, t + 1e-4]))
    here, ahead = np.split(project(survey.intrinsics, survey.pose, points)[0], 2)
    along = (ahead - here) / np.hypot(*(ahead - here).T)[:, None]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(here, axis=0).T))])
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    return CurveObservations(t, arc, normal, here, np.full(len(t), 0.05))


def start_of(survey: Survey) -> FloatArray:
    theta = survey.prior_mean()
    theta[SAG] = 8.0
    return theta


def test_kinds_of_loads_are_a_whole_and_hold_what_a_load_can_be() -> None:
    assert sum(kind.probability for kind in kinds()) == pytest.approx(1.0)
    for prior in [any_single(), *(kind.prior for kind in kinds())]:
        assert np.linalg.eigvalsh(prior.covariance).min() > 0
        assert np.linalg.eigvalsh(prior.finer).min() > -1e-9

    def distance(terms: FloatArray) -> float:
        apart = [terms - kind.prior.mean for kind in kinds()[:-1]]
        return min(float(each @ kind.prior.information @ each) for each, kind in zip(apart, kinds()[:-1], strict=True))

    for load in [(0.09, 0.3, 0.01), (0.12, 0.85, 0.01), (0.2, 0.4, 0.3), (0.4, 0.6, 0.55)]:
        assert distance(single_load_terms(*load, TERMS)) < 3 * TERMS
    # two weights are no single one
    two = single_load_terms(0.1, 0.2, 0.01, TERMS) + single_load_terms(0.1, 0.8, 0.01, TERMS)
    assert distance(two) > 10 * TERMS


def test_offsets_slide_to_where_a_curve_is_nearest() -> None:
    survey = survey_along_the_line()
    theta = start_of(survey)
    theta[LOAD] = 0.0
    t = np.linspace(0.06, 0.94, 50)
    places = survey.shape(theta).points(t)
    pixels, _ = project(*survey.camera(theta), places)
    wrong = CurveObservations(
        np.clip(t + 0.02 * np.sin(9 * t), 0.05, 0.95),
        np.arange(50.0),
        np.tile([0.0, 1.0], (50, 1)),
        pixels,
        np.ones(50),
    )
    assert np.abs(curve_residual(survey, theta, wrong)).max() > 0.5
    right = slid(survey, theta, wrong)
    assert np.abs(curve_residual(survey, theta, right)).max() < 1e-3
    np.testing.assert_allclose(right.t, t, atol=2e-3)
    assert right.measured is wrong.measured


@pytest.mark.parametrize("load", LOADS)
def test_what_is_seen_of_a_wire_foretells_the_rest(load: Load) -> None:
    survey = survey_along_the_line()
    state = WireState(8.0, 4.0, (load,))
    seen = offsets_of(survey, state, np.concatenate([np.linspace(0.05, 0.2, 20), np.linspace(0.22, 0.6, 8)]))
    together = solve_loads(survey, start_of(survey), NOTHING_KNOWN, seen, 12)
    swing, swing_u = together.theta[SWING], float(np.sqrt(together.covariance[SWING, SWING]))
    assert abs(np.degrees(swing) - 4.0) < 3 * np.degrees(swing_u)
    places = np.array([0.4, 0.6, 0.8])
    true = wire_points(survey.near, survey.far, state, places)
    own = survey.shape(together.theta).points(places)
    assert np.abs(own - true).max() < 1.5
    # any ten terms know less
    free = solve(replace(survey, load_prior=None), start_of(survey), NOTHING_KNOWN, seen, 12)
    assert swing_u < np.sqrt(free.covariance[SWING, SWING])


def test_the_budget_of_all_loads_is_their_covariance() -> None:
    survey = survey_along_the_line()
    seen = offsets_of(survey, WireState(8.0, 4.0, (LOADS[0],)), np.linspace(0.05, 0.5, 30))
    together = solve_loads(survey, start_of(survey), NOTHING_KNOWN, seen, 12)
    pieces = together.information(survey)
    assert "which load" in pieces
    np.testing.assert_allclose(sum(pieces.values()), together.covariance, atol=1e-6 * together.covariance[SAG, SAG])


def test_a_curve_that_leads_behind_the_camera_is_no_solution() -> None:
    survey = survey_along_the_line()
    state = WireState(8.0, 4.0, (LOADS[0],))
    seen = offsets_of(survey, state, np.linspace(0.05, 0.6, 30))
    behind = replace(survey, pose=Pose(survey.pose.rotation, np.array([0.0, 60.0, 22.0])))
    assert not solve(behind, start_of(behind), NOTHING_KNOWN, seen, 12).converged
    assert not solve_loads(behind, start_of(behind), NOTHING_KNOWN, seen, 12).converged


def test_shapes_of_finer_terms_are_kept_closely_enough() -> None:
    t = np.concatenate([[0.0, 1.0], np.random.default_rng(2).uniform(0, 1, 200)])
    at = CurveObservations(t, t, np.zeros((len(t), 2)), np.zeros((len(t), 2)), np.ones(len(t)))
    np.testing.assert_allclose(at.finer_load_shapes, finer_load_shapes(t, TERMS + 1, FINEST_LOAD), atol=1e-6)
