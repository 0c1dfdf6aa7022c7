"""What is followed of a wire seen along the line, and what counts as seen of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from demo_wire import HIDDEN_FROM, SAG_M, along_the_line
from numpy.typing import NDArray

from sagnode.estimate import refinement
from sagnode.estimate.joint import solve
from sagnode.estimate.matched import is_wire, share_standing_out, visible_share
from sagnode.estimate.refinement import completed
from sagnode.estimate.register import register
from sagnode.estimate.tell import propagate
from sagnode.match.sight import Sighting
from sagnode.survey import SAG


def test_a_wire_is_followed_where_the_rest_of_it_foretells_it() -> None:
    match = along_the_line().match
    before = match.unaided
    assert before is not None
    assert np.ptp(match.offsets.t) > np.ptp(before.offsets.t) + 0.1
    assert match.sag[1] < before.sag[1]
    for solution in (before.solution, match.solution):
        assert abs(solution.theta[SAG] - SAG_M) < 3 * np.sqrt(solution.covariance[SAG, SAG])


def test_a_place_that_may_be_texture_widens_the_numbers_by_what_it_would_move_them() -> None:
    site, conductor, match = along_the_line()
    solution, curve = match.solution, match.solution.curve
    far = int(np.argmax(curve.t))
    texture = np.where(np.arange(len(curve.t)) == far, 0.5, 0.0)

    def sag_u(texture: NDArray[np.float64]) -> float:
        told = replace(match, solution=replace(solution, curve=replace(curve, texture=texture)))
        return propagate(site, conductor, told)[0]["inplane_sag"].u

    by_texture = np.sqrt(sag_u(texture) ** 2 - sag_u(0.0 * texture) ** 2)
    # what the sag does when that place is measured elsewhere, for a little that robust weights take no notice of
    little = 0.01
    measured = curve.measured.copy()
    measured[far] += little * curve.normal[far]
    moved, still = (
        solve(match.survey, solution.theta, solution.camera, each, 20).theta[SAG]
        for each in (replace(curve, measured=measured), curve)
    )
    assert by_texture == pytest.approx(0.5 * abs(moved - still) / little, rel=0.2)
    assert by_texture > 0.001


def test_what_is_not_there_is_not_followed() -> None:
    match = along_the_line(hidden=True).match
    beyond = (match.observed.t > HIDDEN_FROM + 0.03) & match.observed.usable
    assert beyond.mean() < 0.1, "texture is no wire, though a place is foretold"
    assert abs(match.solution.theta[SAG] - SAG_M) < 3 * np.sqrt(match.solution.covariance[SAG, SAG])


@pytest.mark.parametrize(("moved", "taken"), [(1.0, True), (4.0, False)])
def test_what_moves_a_wire_from_where_it_was_foretold_is_something_else(
    monkeypatch: pytest.MonkeyPatch, moved: float, taken: bool
) -> None:
    site, conductor, match = along_the_line()
    before = match.unaided
    assert before is not None
    theta = before.solution.theta.copy()
    theta[SAG] += moved * before.sag[1]
    more = replace(match, solution=replace(match.solution, theta=theta))
    monkeypatch.setattr(refinement, "_foretold", lambda *_, **__: more)
    registered, _ = register(site, np.zeros((8, 8), dtype=np.uint8))
    after = completed(np.zeros((8, 8), dtype=np.uint8), conductor, registered, before, [])
    assert (after is more) is taken


def test_a_wire_is_proven_by_its_mean_or_by_the_odds() -> None:
    match = along_the_line().match
    most = np.ones(len(match.track.t), dtype=bool)
    few = np.arange(len(most)) < 0.2 * len(most)
    for score, chance, seen, proven in (
        (20.0, 1.0, most, True),
        (2.0, 1e-9, most, True),
        (2.0, 1e-3, most, False),
        (20.0, 1e-9, few, False),
    ):
        assert is_wire(replace(match, sighting=Sighting(score, seen, chance))) is proven


def test_seen_is_what_stands_out_or_was_measured() -> None:
    match = along_the_line().match
    nothing = replace(match, sighting=Sighting(0.0, np.zeros(len(match.track.t), dtype=bool)))
    assert share_standing_out(nothing) == 0
    measured = visible_share(nothing)
    assert 0.25 < measured <= visible_share(match) <= 1
    unsure = replace(nothing, observed=replace(match.observed, sigma=np.full(len(match.observed.t), 2.0)))
    assert visible_share(unsure) == 0
