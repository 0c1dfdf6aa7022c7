"""Single loads that a view does not exclude: what they would do is in the numbers, as far as they are left open."""

from dataclasses import replace

import numpy as np
import pytest
from solving import hanging

from sagnode.config.load import load_span
from sagnode.estimate.camera import CameraKnowledge
from sagnode.estimate.joint import Solution, solve
from sagnode.estimate.load_kinds import LOAD_U, any_single, kinds
from sagnode.estimate.locate import locate
from sagnode.estimate.offsets import CurveObservations
from sagnode.estimate.register import register
from sagnode.estimate.tell import propagate
from sagnode.estimate.unexcluded import EXCLUDED, IN_FIVE, OPEN, unexcluded
from sagnode.estimate.weigh import linear, settled
from sagnode.pipeline import load_site, measure_burst
from sagnode.quality import Validity
from sagnode.scene.catenary import PointLoad, WireState
from sagnode.scene.render import render
from sagnode.scene.site import demo_site, site_directory
from sagnode.scene.spec import Moment
from sagnode.survey import SAG, Survey


def even_solution() -> tuple[Survey, Solution]:
    survey, theta, curve = hanging(np.random.default_rng(3), 0.03)
    # half of the wire is seen
    near = curve.t < 0.5
    parts = {name: getattr(curve, name)[near] for name in ("t", "arc", "normal", "measured", "sigma")}
    return survey, solve(survey, theta, CameraKnowledge(np.zeros((10, 10)), np.zeros(10)), CurveObservations(**parts))


def test_a_view_that_excludes_loads_widens_nothing() -> None:
    survey, solution = even_solution()
    assert unexcluded(solution, survey, EXCLUDED, (0.0, 0.1)) is None
    assert unexcluded(replace(solution, converged=False), survey, 1.0, (0.0, 0.1)) is None


@pytest.mark.parametrize(("chance", "share"), [(OPEN, 1.0), (0.5 * (EXCLUDED + OPEN), 0.5), (10 * OPEN, 1.0)])
def test_what_a_load_would_do_counts_the_more_the_less_it_is_excluded(chance: float, share: float) -> None:
    survey, solution = even_solution()
    loads = unexcluded(solution, survey, chance, (0.0, 0.1))
    assert loads is not None
    assert loads.share == pytest.approx(share * IN_FIVE)
    assert loads.probability.sum() == pytest.approx(1.0)
    # a quantity that every load moves by 0.3 to one side or the other
    there = 2.0 + 0.3 * np.where(np.arange(len(loads.probability)) % 2, 1.0, -1.0)
    assert loads.variance(2.0, there) == pytest.approx((share * IN_FIVE * 0.3) ** 2)


def test_the_linear_step_is_that_of_all_unknowns_together() -> None:
    """Against the plain formula, kind by kind with covariances as matrices and nothing eliminated."""
    survey, solution = even_solution()
    own = replace(survey, load_u=LOAD_U, load_prior=any_single(), swing_mean=0.1, swing_u=0.05)
    logs, thetas, with_sag = linear(own, solution)
    white, correlated = solution.noise
    noise = (np.diag(white) + correlated) * solution.inflation
    jacobian = solution.jacobian
    seen = jacobian.T @ np.linalg.solve(noise, jacobian)
    about = solution.residual + jacobian @ solution.theta
    expected = []
    for k, kind in enumerate(kinds()):
        one = replace(own, load_prior=kind.prior)
        known, mean = one.prior_information(), one.prior_mean()
        covariance = np.linalg.inv(seen + known)
        theta = covariance @ (jacobian.T @ np.linalg.solve(noise, about) + known @ mean)
        sigma = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(thetas[k] / sigma, theta / sigma, atol=1e-5)
        np.testing.assert_allclose(with_sag[k] / sigma, covariance[:, SAG] / sigma, atol=1e-5 * sigma[SAG])
        # how likely the offsets are before looking
        total = noise + jacobian @ np.linalg.inv(known) @ jacobian.T
        left = about - jacobian @ mean
        evidence = -0.5 * (np.linalg.slogdet(total)[1] + left @ np.linalg.solve(total, left))
        expected.append(np.log(kind.probability) + evidence)
    np.testing.assert_allclose(logs - logs[0], np.array(expected) - expected[0], atol=1e-4)


def test_the_linear_step_reaches_as_far_as_solving_for_any_load() -> None:
    """Held against solving for the same offsets under all single loads as one Gaussian, which is another way there."""
    survey, solution = even_solution()
    swing = float(solution.theta[17])
    loads = unexcluded(solution, survey, OPEN, (swing, 0.02))
    loaded = replace(survey, load_u=LOAD_U, load_prior=any_single(), swing_mean=swing, swing_u=0.02)
    any_load = settled(loaded, solution.theta, solution.camera, solution.curve, 12)
    assert loads is not None
    assert any_load is not None
    typical = np.sqrt(loads.probability @ (loads.theta[:, SAG] - solution.theta[SAG]) ** 2)
    wider = any_load.covariance[SAG, SAG] - solution.covariance[SAG, SAG]
    moved = any_load.theta[SAG] - solution.theta[SAG]
    assert typical == pytest.approx(np.sqrt(max(wider, 0.0) + moved**2), rel=0.5)


def test_a_weight_in_a_gale_that_nothing_asks_for_is_within_five_uncertainties() -> None:
    """The middle wire hangs under a weight that moves its picture as a little less swing would."""
    scene = demo_site().scene
    site = load_site(load_span(site_directory() / "span.toml").span)
    swings = {"L1": -15.6, "L2": -14.0, "L3": -16.8}
    wires = {
        c.id: WireState(
            0.5 * (c.sag_min_m + c.sag_max_m), swings.get(c.id, -15.6), (PointLoad(0.7, 0.05),) if c.id == "L2" else ()
        )
        for c in scene.surveyed.conductors
    }
    rendered = render(scene, Moment(wires, seed=8))
    true = rendered.truth["conductors"]
    (reading,) = (one for one in measure_burst(site, [rendered.image]) if one.conductor == "L2")
    assert reading.validity is not Validity.INVALID
    sag, allowed = reading.estimates["sag"], reading.budget["sag"]["load not excluded"]
    error = abs(sag.value - true["L2"]["sag_m"])
    assert error < 5 * sag.u
    assert error > 5 * np.sqrt(sag.u**2 - allowed**2), "without what is allowed for the weight it would be wrong"


def test_every_quantity_of_a_calm_reading_is_told_with_what_a_load_would_do() -> None:
    scene = demo_site().scene
    site = load_site(load_span(site_directory() / "span.toml").span)
    wires = {c.id: WireState(0.5 * (c.sag_min_m + c.sag_max_m), 1.0) for c in scene.surveyed.conductors}
    image = render(scene, Moment(wires, seed=8)).image
    registered, _ = register(site, image)
    assert registered is not None
    conductor = next(c for c in site.conductors if c.measured)
    found = locate(site, image, registered)[conductor.id]
    before, _ = propagate(site, conductor, replace(found, unexcluded=None))
    loads = unexcluded(found.solution, found.survey, OPEN, (found.swing[0], 0.01))
    after, budget = propagate(site, conductor, replace(found, unexcluded=loads))
    assert "conductor_temp" in before
    assert after.keys() == before.keys()
    for stem, estimate in after.items():
        assert estimate.value == before[stem].value
        assert estimate.u == pytest.approx(np.hypot(before[stem].u, budget[stem]["load not excluded"]))
    for stem in ("sag", "clearance", "swing", "catenary_constant", "conductor_temp"):
        assert budget[stem]["load not excluded"] > 0, stem
