"""A block that decides alone: what leaving it out would do, held against leaving it out."""

from dataclasses import replace

import numpy as np
import pytest
from solving import question

from sagnode.estimate.joint import Solution, solve
from sagnode.estimate.lone import lone_block
from sagnode.estimate.offsets import CurveObservations
from sagnode.geometry.camera import project
from sagnode.survey import SAG, Survey


def solved(t: np.ndarray, aside: np.ndarray, seed: int = 2) -> tuple[Survey, Solution]:
    """A camera that looks along the line, offsets of 0.05 px at ``t`` and ``aside`` of a true curve."""
    survey, theta, camera, _ = question(seed, "perfect", count=12)
    survey = replace(survey, load_u=0.0)
    theta = survey.prior_mean()
    intrinsics, pose = survey.camera(theta)
    pixels, _ = project(intrinsics, pose, survey.shape(theta).points(t))
    ahead, _ = project(intrinsics, pose, survey.shape(theta).points(t + 1e-4))
    along = (ahead - pixels) / np.hypot(*(ahead - pixels).T)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))])
    curve = CurveObservations(t, arc, normal, pixels + aside[:, None] * normal, np.full(len(t), 0.05))
    return survey, solve(survey, theta, replace(camera, vector=0 * camera.vector), curve)


NEAR = np.linspace(0.03, 0.1, 20)


@pytest.mark.parametrize("far_aside", [0.0, -4.0, 4.0])
def test_a_lone_block_widens_to_what_is_known_without_it_and_as_far_as_it_moves(far_aside: float) -> None:
    near_aside = np.random.default_rng(1).normal(0, 0.03, len(NEAR))
    _, whole = solved(np.append(NEAR, 0.5), np.append(near_aside, far_aside))
    _, without = solved(NEAR, near_aside)
    assert without.covariance[SAG, SAG] > 4 * whole.covariance[SAG, SAG], "the far block decides"
    moved = without.theta[SAG] - whole.theta[SAG]
    expected = without.covariance[SAG, SAG] - whole.covariance[SAG, SAG] + moved**2
    assert lone_block(whole)[SAG, SAG] == pytest.approx(expected, rel=0.1)


def test_where_several_blocks_show_the_far_half_none_of_them_counts_alone() -> None:
    t = np.concatenate([NEAR, [0.4, 0.5, 0.6, 0.7]])
    _, whole = solved(t, np.random.default_rng(1).normal(0, 0.03, len(t)))
    assert not lone_block(whole).any()


def test_the_tip_of_a_fold_may_decide_alone() -> None:
    _, whole = solved(np.append(NEAR, 0.5), np.zeros(len(NEAR) + 1))
    assert lone_block(whole)[SAG, SAG] > whole.covariance[SAG, SAG]
    assert not lone_block(whole, len(NEAR)).any()
