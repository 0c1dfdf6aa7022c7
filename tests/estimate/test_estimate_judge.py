"""What may be told of a wire seen along the line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from demo_wire import along_the_line, of_blocks_alone
from numpy.typing import NDArray

from sagnode.estimate.judge import NOT_EXCLUDED, borne_out, judge
from sagnode.estimate.load_kinds import LOAD_U
from sagnode.estimate.matched import visible_share
from sagnode.estimate.refinement import offsets_of
from sagnode.estimate.tell import propagate
from sagnode.geometry.single_load import single_load_terms
from sagnode.match.sight import Sighting
from sagnode.match.standing import spread_by
from sagnode.measurement import FrameMeasurement
from sagnode.message import Estimate
from sagnode.quality import Cause, Reason, Validity
from sagnode.survey import LOAD


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


def test_what_is_too_uncertain_says_what_makes_it_so_but_for_loads_that_nothing_speaks_for() -> None:
    site, conductor, match = along_the_line()
    estimates, budget = propagate(site, conductor, match)
    sag = estimates["sag"]
    estimates["sag"] = sag._replace(u=0.13 * sag.value)
    budget["sag"] = {"pixel noise": 0.01, "swing prior": 0.1 * sag.value, NOT_EXCLUDED: 0.05 * sag.value}
    validity, (reason,) = judge(site, conductor, match, estimates, budget=budget)
    assert (validity, reason.cause) == (Validity.INVALID, Cause.UNCERTAIN)
    assert "sag is 12.0 % of it, most of all by 'swing prior'" in reason.text
    budget["sag"][NOT_EXCLUDED] = 0.126 * sag.value
    validity, (reason,) = judge(site, conductor, match, estimates, budget=budget)
    assert (validity, reason.cause) == (Validity.QUESTIONABLE, Cause.UNCERTAIN)
    assert f"most of all by {NOT_EXCLUDED!r}, exceeds the configured" in reason.text


def test_what_exceeds_the_configured_limit_says_what_makes_it_so() -> None:
    site, conductor, match = along_the_line()
    estimates, budget = propagate(site, conductor, match)
    strict = replace(site, limits=site.limits.model_copy(update={"clearance_u_max_m": 1e-4}))
    budget["clearance"] = {**budget["clearance"], "ground": 1.0}
    _, (reason,) = judge(strict, conductor, match, estimates, budget=budget)
    assert reason.cause is Cause.UNCERTAIN
    assert "most of all by 'ground', exceeds the configured 0.0001 m" in reason.text


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


@pytest.mark.parametrize(
    ("part", "load_u", "told"), [(0.3, 0.0, False), (0.37, 0.0, True), (0.45, LOAD_U, False), (0.55, LOAD_U, True)]
)
def test_less_than_a_third_of_a_wire_is_not_told_and_half_under_a_load(part: float, load_u: float, told: bool) -> None:
    site, conductor, match = along_the_line()
    estimates, _ = propagate(site, conductor, match)
    match = replace(match, survey=replace(match.survey, load_u=load_u))
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


@pytest.mark.parametrize(("chance", "refused"), [(0.03, False), (0.08, True)])
def test_an_uneven_load_is_told_only_where_half_of_the_span_is_surely_the_wire(chance: float, refused: bool) -> None:
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


def hardly_seen(name: str, share: float) -> FrameMeasurement:
    return replace(measured(name, Validity.INVALID, Cause.TOO_LITTLE_VISIBLE), visible_share=share)


@pytest.mark.parametrize(
    ("others", "refused"),
    [
        ([], False),
        ([measured("b", Validity.GOOD)], False),
        ([measured("b", Validity.INVALID, Cause.UNCERTAIN)], False),
        ([measured("b", Validity.INVALID, Cause.NO_CONDUCTOR)], True),
        ([hardly_seen("b", 0.16)], True),
        ([hardly_seen("b", 0.38)], False),
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


def test_no_tension_is_told_where_a_weight_may_hang() -> None:
    """The sag is nearly the same under both, the tension is not: 1.5 times as much under a weight at mid-span as heavy
    as the wire's half (``test_scene_truth``)."""
    site, conductor, match = along_the_line()
    told, _ = propagate(site, conductor, match)
    either, budget = propagate(site, conductor, replace(match, other=match, other_weight=0.3))
    assert "catenary_constant" in told
    assert told.keys() - either.keys() <= {"catenary_constant", "tension", "conductor_temp"}
    assert {"catenary_constant", "tension", "conductor_temp"}.isdisjoint(either.keys() | budget.keys())
    assert either["sag"].value == told["sag"].value
