"""What is followed of a wire seen along the line, what counts as seen of it, and what may be told."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.config.load import load_span
from sagnode.estimate import refinement
from sagnode.estimate.even import find_even
from sagnode.estimate.joint import solve
from sagnode.estimate.judge import borne_out, judge
from sagnode.estimate.load import Doubt
from sagnode.estimate.load_kinds import LOAD_U, any_single
from sagnode.estimate.lone import without_lone
from sagnode.estimate.matched import Matched, is_wire, looked_at, share_standing_out, visible_share
from sagnode.estimate.refinement import completed, offsets_of, survey_of
from sagnode.estimate.register import Registered, register
from sagnode.estimate.swings import explanation
from sagnode.estimate.tell import propagate
from sagnode.estimate.weigh import solve_loads
from sagnode.geometry.single_load import single_load_terms
from sagnode.match.sight import Sighting
from sagnode.match.standing import spread_by
from sagnode.measurement import FrameMeasurement
from sagnode.message import Estimate
from sagnode.pipeline import load_site
from sagnode.quality import Cause, Reason, Validity
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.site import demo_site, site_directory
from sagnode.scene.spec import Moment
from sagnode.site import Site, SiteConductor
from sagnode.survey import LOAD, SAG

HIDDEN_FROM = 0.2
"""Share of the span beyond which the wire is painted over."""
SAG_M = 8.0


class Found(NamedTuple):
    site: Site
    conductor: SiteConductor
    match: Matched


@cache
def demo_picture() -> NDArray[np.uint8]:
    """The demonstration's span."""
    scene = demo_site().scene
    wires = {c.id: WireState(SAG_M, 0.0) for c in scene.surveyed.conductors}
    return render(scene, Moment(wires, seed=8)).image


@cache
def along_the_line(*, hidden: bool = False) -> Found:
    """The demonstration's conductor L2 as it is found, the far part of it painted over with what is behind it."""
    scene = demo_site().scene
    wires = {c.id: WireState(SAG_M, 0.0) for c in scene.surveyed.conductors}
    site = load_site(load_span(site_directory() / "span.toml").span)
    conductor = next(c for c in site.conductors if c.id == "L2")
    image = demo_picture()
    if hidden:
        without = render(scene, Moment({n: w for n, w in wires.items() if n != conductor.id}, seed=8)).image
        match = along_the_line().match
        far = match.track.pixels[match.track.t > HIDDEN_FROM]
        image = painted(image, without, far)
    registered, reasons = register(site, image)
    assert not reasons, reasons
    before = find_even(image, conductor, survey_of(conductor, registered), registered)
    assert before is not None
    match = replace(completed(image, conductor, registered, before, []), unaided=before)
    return Found(site, conductor, looked_at(image, match))


def painted(image: NDArray[np.uint8], other: NDArray[np.uint8], places: NDArray[np.float64]) -> NDArray[np.uint8]:
    result = image.copy()
    for u, v in places.astype(int):
        result[max(v - 8, 0) : v + 9, max(u - 8, 0) : u + 9] = other[max(v - 8, 0) : v + 9, max(u - 8, 0) : u + 9]
    return result


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


@pytest.mark.parametrize(("span_share", "told"), [(0.0014, True), (0.0016, False)])
def test_the_sag_of_a_flat_wire_may_be_as_uncertain_as_that_of_one_that_hangs_lower(
    span_share: float, told: bool
) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    span = float(np.linalg.norm(conductor.survey.far - conductor.survey.near))
    flat = 0.02 * span
    low, high = 0.5 * flat, conductor.survey.sag_range[1]
    conductor = replace(conductor, survey=replace(conductor.survey, sag_range=(low, high)))
    estimates["sag"] = estimates["sag"]._replace(value=flat, u=span_share * span)
    estimates["inplane_sag"] = estimates["inplane_sag"]._replace(value=flat)
    validity, reasons = judge(site, conductor, match, estimates)
    assert (validity is not Validity.INVALID) is told, reasons
    assert told or [r.cause for r in reasons] == [Cause.UNCERTAIN]


def with_one_far_block(aside_px: float, *, texture: bool) -> tuple[Found, Registered, Matched]:
    """A wire under an uneven load of which the near part is seen and one block at mid-span; and what is seen near."""
    found = along_the_line()
    registered, _ = register(found.site, demo_picture())
    survey = replace(found.match.survey, load_u=LOAD_U, load_prior=any_single())
    observed = found.match.observed
    near = observed.usable & (observed.t < 0.12)
    far = int(np.argmin(np.abs(observed.t - 0.5)))
    assert observed.usable[far]
    offset, sigma, noise = observed.offset.copy(), observed.sigma.copy(), observed.noise.copy()
    offset[far] += aside_px
    sigma[far] = 0.2
    noise[far] = 0.05 if texture else 0.2
    both = near.copy()
    both[far] = True
    several = replace(observed, offset=offset, sigma=sigma, noise=noise, texture=0 * observed.texture)

    def solved_with(usable: NDArray[np.bool_]) -> Matched:
        seen = replace(several, usable=usable)
        offsets = offsets_of(seen, bent=True)
        solution = solve_loads(survey, found.match.solution.theta, registered.camera, offsets, 24)
        return replace(found.match, survey=survey, observed=seen, offsets=offsets, solution=solution)

    return Found(found.site, found.conductor, solved_with(both)), registered, solved_with(near)


@pytest.mark.parametrize("aside_px", [0.0, -3.0])
def test_under_an_uneven_load_the_interval_holds_what_is_left_without_a_block_that_may_be_texture(
    aside_px: float,
) -> None:
    (site, conductor, match), registered, near = with_one_far_block(aside_px, texture=True)
    left = without_lone(match, registered, 24)
    assert left is not None
    assert len(left.residual) == len(near.solution.residual)
    assert left.theta[SAG] == pytest.approx(near.solution.theta[SAG], abs=near.sag[1])
    told = replace(match, without_lone=left)
    before, after, alone = (
        propagate(site, conductor, m)[0]["sag"] for m in (match, told, replace(match, solution=left))
    )
    assert alone.u > 2 * before.u, "the far block decides"
    assert after.value == before.value
    assert after.u == pytest.approx(np.hypot(alone.u, alone.value - before.value), rel=1e-6)


def test_a_quantity_under_an_uneven_load_is_its_mean_over_all_loads_and_varies_within_and_between_them() -> None:
    (site, conductor, match), _, _ = with_one_far_block(0.0, texture=True)
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
    (_, conductor, match), registered, _ = with_one_far_block(0.0, texture=False)
    everything = replace(along_the_line().match, survey=match.survey)
    assert not everything.solution.loads
    monkeypatch.setattr(refinement, "FORETOLD_ENOUGH", 0.0)
    assert completed(demo_picture(), conductor, registered, everything, []).solution.loads


def test_under_an_uneven_load_a_block_that_is_surely_the_wire_may_decide() -> None:
    (_, _, match), registered, _ = with_one_far_block(0.0, texture=False)
    assert without_lone(match, registered, 24) is None


def test_a_clear_wire_is_good() -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    assert judge(site, conductor, match, estimates) == (Validity.GOOD, [])


def test_no_curve_is_no_conductor() -> None:
    site, conductor, _ = along_the_line()
    validity, reasons = judge(site, conductor, None, {})
    assert validity is Validity.INVALID
    assert [r.cause for r in reasons] == [Cause.NO_CONDUCTOR]


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ("rival", Cause.AMBIGUOUS),
        ("unsettled", Cause.NOT_CONVERGED),
        ("doubtful", Cause.ICE_SUSPECT),
        ("nothing seen", Cause.NO_CONDUCTOR),
        ("uncertain", Cause.UNCERTAIN),
        ("sag outside the survey's", Cause.OUTSIDE_LIMITS),
    ],
)
def test_each_defect_is_refused_by_its_name(change: str, cause: Cause) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    sag = estimates["sag"]
    if change == "rival":
        match = replace(match, rival=0.9)
    elif change == "unsettled":
        match = replace(match, solution=replace(match.solution, converged=False))
    elif change == "doubtful":
        match = replace(match, doubtful_load=True)
    elif change == "nothing seen":
        match = replace(match, sighting=Sighting(0.0, np.zeros(len(match.track.t), dtype=bool)))
    elif change == "uncertain":
        estimates = {**estimates, "sag": sag._replace(u=0.06 * sag.value)}
    else:
        estimates = {**estimates, "inplane_sag": sag._replace(value=conductor.survey.sag_range[1] + 1.0)}
    validity, reasons = judge(site, conductor, match, estimates)
    assert validity is Validity.INVALID
    assert cause in [r.cause for r in reasons]


@pytest.mark.parametrize(("part", "told"), [(0.3, False), (0.37, True)])
def test_less_than_a_third_of_a_wire_is_not_told(part: float, told: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    # by its length in the picture a third of the span is the clear part of it
    seen = match.track.t < match.track.t[0] + part
    nowhere = replace(match.observed, sigma=np.full(len(match.observed.t), 2.0))
    little = replace(match, sighting=Sighting(50.0, seen), observed=nowhere)
    assert visible_share(little) == pytest.approx(part, abs=0.02)
    _, reasons = judge(site, conductor, little, estimates)
    assert (Cause.TOO_LITTLE_VISIBLE not in [r.cause for r in reasons]) is told


@pytest.mark.parametrize(("share", "refused"), [(None, False), (1.0, False), (0.6, False), (0.5, True)])
def test_an_uneven_load_is_told_only_in_a_scene_that_is_surely_the_surveyed_one(
    share: float | None, refused: bool
) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    uneven = replace(match, survey=replace(match.survey, load_u=LOAD_U))
    for found, expected in ((match, False), (uneven, refused)):
        _, reasons = judge(site, conductor, found, estimates, share)
        assert (Cause.LANDMARKS_LOST in [r.cause for r in reasons]) is expected


@pytest.mark.parametrize(("share", "refused"), [(0.8, False), (0.6, True)])
def test_an_uneven_load_is_told_only_where_the_wire_shows_nearly_all_along(share: float, refused: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    uneven = replace(match, survey=replace(match.survey, load_u=LOAD_U))
    standing_out = Sighting(20.0, np.linspace(0.0, 1.0, len(match.track.t)) < share)
    assert judge(site, conductor, replace(match, sighting=standing_out), estimates)[0] is Validity.GOOD
    blocks = np.linspace(0.0, 1.0, len(match.observed.t)) < share
    for little in (
        replace(uneven, sighting=standing_out),
        replace(match, sighting=standing_out, other_weight=1.0),
        of_blocks_alone(uneven, blocks),
    ):
        _, reasons = judge(site, conductor, little, estimates)
        assert (Cause.NO_CONDUCTOR in [r.cause for r in reasons]) is refused


@pytest.mark.parametrize("unlike", [False, True])
def test_an_uneven_load_that_needs_a_wind_of_its_own_is_refused(unlike: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    _, reasons = judge(site, conductor, replace(match, unlike_others=unlike), estimates)
    assert (Cause.AMBIGUOUS in [r.cause for r in reasons]) is unlike


@pytest.mark.parametrize(("count", "refused"), [(22, False), (18, True)])
def test_an_uneven_load_is_told_only_by_more_blocks_than_it_has_unknowns(count: int, refused: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    uneven = replace(match, survey=replace(match.survey, load_u=LOAD_U))
    usable = np.flatnonzero(match.observed.usable)
    few = np.isin(np.arange(len(match.observed.t)), usable[np.linspace(0, len(usable) - 1, count).astype(int)])
    assert judge(site, conductor, of_blocks_alone(match, few), estimates)[0] is Validity.GOOD
    _, reasons = judge(site, conductor, of_blocks_alone(uneven, few), estimates)
    assert (Cause.TOO_LITTLE_VISIBLE in [r.cause for r in reasons]) is refused


def of_blocks_alone(match: Matched, blocks: NDArray[np.bool_]) -> Matched:
    """As if of all blocks (M,) only these had shown the wire."""
    usable = match.observed.usable
    kept = blocks[usable]
    solution = replace(match.solution, residual=match.solution.residual[kept])
    observed = replace(match.observed, usable=usable & blocks)
    return replace(match, observed=observed, solution=solution, offsets=match.offsets.some(kept))


@pytest.mark.parametrize(("chance", "refused"), [(0.005, False), (0.03, True)])
def test_an_uneven_load_is_told_only_where_a_third_of_the_span_is_surely_the_wire(chance: float, refused: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    # the near part stands out, and the far one by blocks alone, any of which may have looked at texture
    standing_out = Sighting(20.0, match.track.t < 0.15)
    observed, far = match.observed, match.observed.t > 0.15
    noise = np.where(far, 0.05, observed.noise)
    sigma = np.where(far, np.hypot(noise, spread_by(np.full(len(far), chance), observed.half_range)), observed.sigma)
    observed = replace(observed, noise=noise, sigma=sigma, scatter=0 * observed.scatter)
    faint = replace(match, sighting=standing_out, observed=observed, offsets=offsets_of(observed, bent=False))
    assert judge(site, conductor, faint, estimates)[0] is Validity.GOOD
    assert visible_share(faint) > 0.8
    uneven = replace(faint, survey=replace(faint.survey, load_u=LOAD_U))
    _, reasons = judge(site, conductor, uneven, estimates)
    assert (Cause.TOO_LITTLE_VISIBLE in [r.cause for r in reasons]) is refused


@pytest.mark.parametrize(("share", "inflation", "refused"), [(0.4, 1.0, False), (1.0, 2.0, False), (0.4, 2.0, True)])
def test_a_few_places_that_contradict_each_other_are_no_wire(share: float, inflation: float, refused: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    blocks = np.arange(len(match.observed.t)) % 10 < 10 * share
    some = of_blocks_alone(match, blocks)
    some = replace(some, solution=replace(some.solution, inflation=inflation))
    validity, reasons = judge(site, conductor, some, estimates)
    assert [r.cause for r in reasons] == ([Cause.NO_CONDUCTOR] if refused else [])
    assert (validity is Validity.INVALID) is refused


@pytest.mark.parametrize(
    ("terms", "refused"),
    [
        (np.zeros(10), False),
        (single_load_terms(0.15, 0.3, 0.01, 10), False),
        (single_load_terms(0.4, 0.7, 0.5, 10), False),
        # what hangs from one end alone, and what would have to pull upwards
        (single_load_terms(0.5, 0.94, 0.01, 10), True),
        (-single_load_terms(0.3, 0.3, 0.1, 10), True),
    ],
)
def test_a_wire_under_a_load_that_nothing_makes_is_another_wire(terms: NDArray[np.float64], refused: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    theta = match.solution.theta.copy()
    theta[LOAD] = terms
    uneven = replace(match, survey=replace(match.survey, load_u=LOAD_U), solution=replace(match.solution, theta=theta))
    validity, reasons = judge(site, conductor, uneven, estimates)
    assert (Cause.AMBIGUOUS in [r.cause for r in reasons]) is refused
    assert validity is (Validity.INVALID if refused else Validity.QUESTIONABLE)
    assert len(reasons) == len(set(reasons))


def measured(name: str, validity: Validity, *causes: Cause) -> FrameMeasurement:
    estimates = {} if validity is Validity.INVALID else {"sag": Estimate(2.0, 0.02, 1.96, 2.04)}
    reasons = tuple(Reason(cause, cause.value) for cause in causes)
    return FrameMeasurement(name, None, validity, reasons, "rational-bezier", estimates)


@pytest.mark.parametrize(
    ("others", "refused"),
    [
        ([], False),
        ([measured("b", Validity.GOOD)], False),
        ([measured("b", Validity.INVALID, Cause.UNCERTAIN)], False),
        ([measured("b", Validity.INVALID, Cause.NO_CONDUCTOR)], True),
        ([measured("b", Validity.INVALID, Cause.NO_CONDUCTOR), measured("c", Validity.GOOD)], False),
        ([measured(name, Validity.INVALID, Cause.AMBIGUOUS) for name in "bc"], True),
    ],
)
def test_what_may_hang_unevenly_is_told_only_beside_others_of_its_span(
    others: list[FrameMeasurement], refused: bool
) -> None:
    loaded = measured("a", Validity.QUESTIONABLE, Cause.ICE_SUSPECT)
    own, *rest = borne_out([loaded, *others])
    assert rest == others
    assert (own.validity is Validity.INVALID) == refused
    assert bool(own.estimates) != refused
    assert [r.cause for r in own.reasons] == [Cause.AMBIGUOUS] * refused + [Cause.ICE_SUSPECT]
    even = measured("a", Validity.GOOD)
    assert borne_out([even, *others])[0] is even
