"""What is told of a wire under an uneven load: over all loads, and without a block that may be texture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from demo_wire import Found, along_the_line, demo_picture
from numpy.typing import NDArray

from sagnode.estimate import load, refinement
from sagnode.estimate.evidence import Unevenness
from sagnode.estimate.load import Doubt
from sagnode.estimate.load_kinds import LOAD_U, any_single
from sagnode.estimate.lone import TEXTURE_LIKELY, without_lone
from sagnode.estimate.matched import Matched, texture_chance
from sagnode.estimate.refinement import completed, offsets_of
from sagnode.estimate.register import Registered, register
from sagnode.estimate.swings import explanation
from sagnode.estimate.tell import propagate
from sagnode.estimate.weigh import solve_loads
from sagnode.survey import SAG


@pytest.mark.parametrize(("hidden", "followed"), [(False, True), (True, False)])
def test_a_loaded_wire_tells_its_swing_by_what_was_seen_following_it_or_by_the_heaviest_load(
    hidden: bool, followed: bool
) -> None:
    _, conductor, match = along_the_line(hidden=hidden)
    own = Doubt(conductor, match.survey, match, [], [])
    by_step = [explanation(0.0, swing, 0.02, own.swing_u) for swing in (0.1, 0.9)]
    expected = [explanation(0.0, *match.swing, own.swing_u)] if followed else by_step[-1:]
    assert own.swing_loaded(match, by_step) == expected
    assert own.swing_loaded(None, by_step) == by_step[-1:]
    unsettled = replace(match, solution=replace(match.solution, converged=False))
    assert own.swing_loaded(unsettled, by_step) == by_step[-1:]


def test_offsets_that_no_even_curve_comes_near_explain_nothing_by_numbers_that_are_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A step that leads nowhere leaves a misfit that is infinite and weights that are no numbers."""
    _, conductor, match = along_the_line()
    registered, _ = register(along_the_line().site, demo_picture())
    lost = replace(match.solution, misfit=np.inf, converged=False, white=np.full(len(match.offsets.t), np.nan))
    monkeypatch.setattr(load, "settled", lambda *_: None)
    monkeypatch.setattr(load, "solve", lambda *_: lost)
    strained = Doubt(conductor, match.survey, replace(match, response=0.1), [Unevenness(9.0, 4.0, match.swing)], [])
    explained = load._as_uneven(registered, strained, match)
    assert explained
    assert np.isfinite(np.array(explained)).all()


ALONE, STREAK = (0.5,), (0.29, 0.38, 0.53)


def with_far_blocks(
    aside_px: float, *, texture: bool, places: tuple[float, ...] = ALONE, sigma_px: float = 0.2
) -> tuple[Found, Registered, Matched]:
    """A wire under an uneven load of which the near part is seen and blocks farther on; and what is seen near."""
    found = along_the_line()
    registered, _ = register(found.site, demo_picture())
    survey = replace(found.match.survey, load_u=LOAD_U, load_prior=any_single())
    observed = found.match.observed
    near = observed.usable & (observed.t < 0.12)
    far = [int(np.argmin(np.abs(observed.t - place))) for place in places]
    assert observed.usable[far].all()
    offset, sigma, noise = observed.offset.copy(), observed.sigma.copy(), observed.noise.copy()
    offset[far] += aside_px
    sigma[far] = sigma_px
    noise[far] = 0.05 if texture else sigma_px
    both = near.copy()
    both[far] = True
    several = replace(observed, offset=offset, sigma=sigma, noise=noise, texture=0 * observed.texture)

    def solved_with(usable: NDArray[np.bool_]) -> Matched:
        seen = replace(several, usable=usable)
        offsets = offsets_of(seen, bent=True)
        solution = solve_loads(survey, found.match.solution.theta, registered.camera, offsets, 24)
        return replace(found.match, survey=survey, observed=seen, offsets=offsets, solution=solution)

    return Found(found.site, found.conductor, solved_with(both)), registered, solved_with(near)


@pytest.mark.parametrize(
    ("aside_px", "places", "sigma_px"), [(0.0, ALONE, 0.2), (-3.0, ALONE, 0.2), (-3.0, STREAK, 1.0)]
)
def test_under_an_uneven_load_the_interval_holds_what_is_left_without_blocks_that_may_be_texture(
    aside_px: float, places: tuple[float, ...], sigma_px: float
) -> None:
    (site, conductor, match), registered, near = with_far_blocks(
        aside_px, texture=True, places=places, sigma_px=sigma_px
    )
    left = without_lone(match, registered, 24)
    assert left is not None
    assert len(left.residual) == len(near.solution.residual)
    assert left.theta[SAG] == pytest.approx(near.solution.theta[SAG], abs=near.sag[1])
    told = replace(match, without_lone=left)
    before, after, alone = (
        propagate(site, conductor, m)[0]["sag"] for m in (match, told, replace(match, solution=left))
    )
    assert np.hypot(alone.u, alone.value - before.value) > 2 * before.u, "the far blocks decide"
    assert after.value == before.value
    assert after.u == pytest.approx(np.hypot(alone.u, alone.value - before.value), rel=1e-6)


def test_a_quantity_under_an_uneven_load_is_its_mean_over_all_loads_and_varies_within_and_between_them() -> None:
    (site, conductor, match), _, _ = with_far_blocks(0.0, texture=True)
    told, budget = propagate(site, conductor, match)
    weight = np.array([share for share, _, _ in match.solution.loads])
    assert len(weight) > 3
    assert weight.sum() == pytest.approx(1.0, abs=0.02)
    weight /= weight.sum()
    each = [
        propagate(site, conductor, replace(match, survey=survey, solution=solution))[0]
        for _, survey, solution in match.solution.loads
    ]
    for stem in ("sag", "clearance", "lowest_height", "drop"):
        value, u = (np.array([one[stem][k] for one in each]) for k in (0, 1))
        mean = weight @ value
        assert told[stem].value == pytest.approx(mean)
        assert told[stem].u ** 2 == pytest.approx(weight @ (u**2 + (value - mean) ** 2))
        assert np.sqrt(np.sum(np.square(list(budget[stem].values())))) == pytest.approx(told[stem].u)


def test_what_is_seen_of_an_uneven_load_at_once_is_weighed_by_all_loads_too(monkeypatch: pytest.MonkeyPatch) -> None:
    (_, conductor, match), registered, _ = with_far_blocks(0.0, texture=False)
    everything = replace(along_the_line().match, survey=match.survey)
    assert not everything.solution.loads
    monkeypatch.setattr(refinement, "FORETOLD_ENOUGH", 0.0)
    assert completed(demo_picture(), conductor, registered, everything, []).solution.loads


def test_under_an_uneven_load_a_block_that_is_surely_the_wire_may_decide() -> None:
    (_, _, match), registered, _ = with_far_blocks(0.0, texture=False)
    assert without_lone(match, registered, 24) is None


def test_of_blocks_that_may_all_be_texture_the_surest_stays() -> None:
    (_, _, match), registered, _ = with_far_blocks(0.0, texture=True)
    observed, half_range = match.observed, match.observed.half_range[match.observed.usable]
    quiet = replace(observed, noise=np.full(len(observed.t), 0.01), scatter=0 * observed.scatter)
    doubtful = replace(match, observed=quiet, offsets=replace(match.offsets, sigma=0.3 * half_range))
    chance = texture_chance(doubtful)
    assert (chance > TEXTURE_LIKELY).all()
    left = without_lone(doubtful, registered, 24)
    assert left is not None
    assert left.curve.sigma == pytest.approx(doubtful.offsets.sigma[[np.argmin(chance)]])
    assert left.curve.t == pytest.approx(match.offsets.t[[np.argmin(chance)]], abs=1e-3)
