"""Ice and weights on a part of the span: frontal, where the whole wire is seen, and along the line."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from solving import question

from presets import preset_scene, typical_states
from sagnode.calibrate.files import save_intrinsics
from sagnode.capture.images import read_grey
from sagnode.config.load import load_span
from sagnode.estimate.even import find_even
from sagnode.estimate.evidence import single_loads, unevenness
from sagnode.estimate.joint import solve
from sagnode.estimate.load import LOADS_U
from sagnode.estimate.offsets import curve_residual
from sagnode.estimate.refinement import survey_of
from sagnode.estimate.register import register
from sagnode.measurement import ConductorMeasurement
from sagnode.pipeline import load_site, measure_burst
from sagnode.quality import Cause, Validity
from sagnode.scene.catenary import Load, PartialLoad, PointLoad, WireState
from sagnode.scene.render import render
from sagnode.scene.site import demo_site, site_directory
from sagnode.scene.spec import Moment
from sagnode.scene.truth import read_truth
from sagnode.survey import LOAD


def measured(tmp_path: Path, *loads: Load) -> tuple[ConductorMeasurement, float, float]:
    """The reading of the laboratory's wire under these loads, true sag and true clearance."""
    scene = preset_scene("lab", seed=1, error_scale=1.0)
    states = typical_states(scene.surveyed)
    reference, lens = tmp_path / "reference.png", tmp_path / "camera.yaml"
    cv2.imwrite(str(reference), render(scene, Moment(states, seed=3)).image)
    save_intrinsics(lens, scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"reference_image": reference, "intrinsics": lens})
    site = load_site(scene.surveyed.model_copy(update={"camera": camera}))
    loaded = {name: replace(state, loads=loads) for name, state in states.items()}
    rendered = render(scene, Moment(loaded, seed=5))
    (reading,) = measure_burst(site, [rendered.image])
    true = rendered.truth["conductors"][reading.conductor]
    return reading, float(true["sag_m"]), float(true["clearance_m"])


@pytest.mark.parametrize(
    ("load", "skewed"),
    [
        (PartialLoad(0.5, 1.0, 0.6), +1),
        (PartialLoad(0.2, 0.5, 1.0), -1),
        (PointLoad(0.5, 0.05), 0),
    ],
)
def test_ice_or_a_weight_is_named_and_followed(tmp_path: Path, load: Load, skewed: int) -> None:
    reading, sag, clearance = measured(tmp_path, load)
    assert reading.validity is Validity.QUESTIONABLE
    assert Cause.ICE_SUSPECT in [r.cause for r in reading.reasons]
    assert abs(reading.estimates["sag"].value - sag) < 3 * reading.estimates["sag"].u
    assert abs(reading.estimates["clearance"].value - clearance) < 3 * reading.estimates["clearance"].u
    assert reading.estimates["sag"].u < 0.02 * sag
    skew = reading.estimates["load_skew"]
    # heavier towards B is positive; a weight in the middle is heavier towards neither
    if skewed:
        assert skewed * skew.value > 2 * skew.u
    else:
        assert abs(skew.value) < 3 * skew.u
    assert "conductor_temp" not in reading.estimates


def test_an_even_wire_is_not_suspected(tmp_path: Path) -> None:
    reading, sag, _ = measured(tmp_path)
    assert reading.validity is Validity.GOOD
    assert "load_skew" not in reading.estimates
    assert abs(reading.estimates["sag"].value - sag) < 3 * reading.estimates["sag"].u


def demo_moment(weight: float) -> Moment:
    """Of the demonstration's span: a wind, and the same weight on each conductor that is measured."""
    loads: tuple[Load, ...] = (PointLoad(0.6, weight),) if weight else ()
    wires = {
        c.id: WireState(0.5 * (c.sag_min_m + c.sag_max_m), 3.0, loads if c.measured else ())
        for c in demo_site().scene.surveyed.conductors
    }
    return Moment(wires, seed=8)


def along_the_line(weight: float) -> tuple[list[ConductorMeasurement], dict[str, float]]:
    """Readings of the demonstration's span, seen along the line, each conductor with a weight; and the true sags."""
    rendered = render(demo_site().scene, demo_moment(weight))
    true = {name: float(c["sag_m"]) for name, c in rendered.truth["conductors"].items()}
    site = load_site(load_span(site_directory() / "span.toml").span)
    return measure_burst(site, [rendered.image]), true


@pytest.mark.parametrize("weight", [0.04, 0.12])
def test_weights_on_a_span_seen_along_the_line_are_never_taken_for_a_wrong_swing(weight: float) -> None:
    readings, true = along_the_line(weight)
    for reading in readings:
        if reading.validity is Validity.INVALID:
            continue
        assert abs(reading.estimates["sag"].value - true[reading.conductor]) < 3 * reading.estimates["sag"].u
        assert Cause.ICE_SUSPECT in [r.cause for r in reading.reasons]


def test_where_the_load_is_left_open_the_interval_holds_both_answers() -> None:
    """In a gust the three wires swing by different angles: the picture cannot say that it is no weight."""
    file = next(site_directory().rglob("20260621T153000Z.jpg"))
    site = load_site(load_span(site_directory() / "span.toml").span)
    reading = next(r for r in measure_burst(site, [read_grey(file)]) if r.conductor == "L3")
    true = read_truth(file).conductors["L3"]["sag"]
    sag, parts = reading.estimates["sag"], reading.budget["sag"]
    assert reading.reasons[0].cause is Cause.ICE_SUSPECT
    assert abs(sag.value - true) < 0.05, "the even load is by far the likelier"
    assert parts["even or uneven load"] > 0.02
    assert np.sqrt(sum(u**2 for u in parts.values())) == pytest.approx(sag.u)
    assert "load_skew" not in reading.estimates


def test_even_wires_on_a_span_seen_along_the_line_are_not_suspected() -> None:
    readings, true = along_the_line(0.0)
    for reading in readings:
        assert reading.validity is not Validity.INVALID, reading.reasons
        assert Cause.ICE_SUSPECT not in [r.cause for r in reading.reasons]
        assert abs(reading.estimates["sag"].value - true[reading.conductor]) < 3 * reading.estimates["sag"].u


def test_even_wires_at_dusk_are_not_suspected_for_what_a_free_curve_finds() -> None:
    """In the dark a curve that is free to bend shows as much of nearly nothing as the even one does."""
    scene = demo_site().scene
    site = load_site(load_span(site_directory() / "span.toml").span)
    swings = {"L1": 3.18, "L2": 2.93, "L3": 2.11, "earth": 3.22}
    wires = {c.id: WireState(0.5 * (c.sag_min_m + c.sag_max_m), swings[c.id]) for c in scene.surveyed.conductors}
    rendered = render(scene, Moment(wires, seed=1, sun_elevation_deg=-4.5))
    readings = measure_burst(site, [rendered.image])
    assert {r.validity for r in readings} == {Validity.GOOD}
    for reading in readings:
        sag = reading.estimates["sag"]
        assert abs(sag.value - rendered.truth["conductors"][reading.conductor]["sag_m"]) < 3 * sag.u


def test_a_single_weight_shows_before_ten_free_terms_do() -> None:
    odds = {}
    for weight in (0.0, 0.08):
        image = render(demo_site().scene, demo_moment(weight)).image
        site = load_site(load_span(site_directory() / "span.toml").span)
        registered, _ = register(site, image)
        assert registered is not None
        conductor = next(c for c in site.conductors if c.measured)
        survey = survey_of(conductor, registered)
        found = find_even(image, conductor, survey, registered)
        assert found is not None
        seen = found.unaided or found
        singles = single_loads(seen.solution, survey, seen.offsets.t)
        single = float(np.log(np.mean(np.exp([each.log_odds for each in singles]))))
        odds[weight] = (single, max(each.log_odds for each in unevenness(seen.solution, survey, LOADS_U)))
    assert max(odds[0.0]) < 0
    assert odds[0.08][0] > max(0.0, odds[0.08][1])


def test_what_an_even_wire_leaves_over_does_not_hang_on_the_last_bit_of_settling() -> None:
    """A load's terms lean on sag, swing and attachments: a hundredth of an uncertainty there must not look like ice."""
    scene = demo_site().scene
    wires = {c.id: WireState(0.5 * (c.sag_min_m + c.sag_max_m), 3.0) for c in scene.surveyed.conductors}
    image = render(scene, Moment(wires, seed=8)).image
    site = load_site(load_span(site_directory() / "span.toml").span)
    registered, _ = register(site, image)
    assert registered is not None
    conductor = next(c for c in site.conductors if c.measured)
    survey = survey_of(conductor, registered)
    found = find_even(image, conductor, survey, registered)
    assert found is not None
    settled = unevenness(found.solution, survey, LOADS_U)
    rng = np.random.default_rng(4)
    deviation = np.sqrt(np.diag(found.solution.covariance))
    for _ in range(5):
        theta = found.solution.theta + 0.02 * deviation * rng.standard_normal(len(deviation))
        residual = curve_residual(survey, theta, found.offsets)
        moved = unevenness(replace(found.solution, theta=theta, residual=residual), survey, LOADS_U)
        for before, after in zip(settled, moved, strict=True):
            assert after.log_odds == pytest.approx(before.log_odds, abs=0.1)
            assert after.swing[0] == pytest.approx(before.swing[0], abs=0.05 * before.swing[1])


@pytest.mark.parametrize("sharper", [1.0, 8.0])
def test_what_a_bare_wire_leaves_over_is_no_surprise_however_sharp_the_view(sharper: float) -> None:
    """Offsets that err as they say, about a conductor drawn from its survey: a light load takes off what is usual."""
    survey, start, camera, curve = question(2, "perfect", count=40)
    curve = replace(curve, arc=np.sort(curve.arc), sigma=np.full(40, 0.05 / sharper))
    solution = solve(survey, start, replace(camera, vector=0 * camera.vector), curve)
    solution = replace(solution, theta=survey.prior_mean(), white=curve.sigma**2, inflation=1.0)
    free = survey.unknowns()
    known = np.diag(1 / survey.prior_sigma()[free] ** 2)
    known[:10, :10] += camera.precision
    white, correlated = solution.noise
    noise = np.linalg.cholesky(np.diag(white) + correlated)
    apart = np.linalg.cholesky(np.linalg.inv(known))
    rng = np.random.default_rng(5)
    draws = [
        noise @ rng.standard_normal(40) + solution.jacobian[:, free] @ (apart @ rng.standard_normal(len(free)))
        for _ in range(600)
    ]
    asked = [unevenness(replace(solution, residual=one), survey, LOADS_U)[0] for one in draws]
    surprise = np.array([one.surprise for one in asked])
    assert np.mean(surprise) == pytest.approx(0.0, abs=0.15)
    assert np.std(surprise) == pytest.approx(1.0, abs=0.15)
    assert np.mean(surprise > 3.0) < 0.01
    # and a load that is there is one
    uneven = solution.jacobian[:, LOAD] @ np.array([0.0, 0.3, *[0.0] * 8])
    (loaded, _) = unevenness(replace(solution, residual=draws[0] + uneven), survey, LOADS_U)
    assert loaded.surprise > 5.0
