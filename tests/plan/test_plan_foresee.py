"""The plan foretells what the node states on rendered frames of the same site, and what stops it."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from plan_spans import camera_of, simple_span

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.measurement import ConductorMeasurement
from sagnode.pipeline import load_site, measure_burst
from sagnode.plan.camera import planned_site
from sagnode.plan.foresee import LEVELS, Foreseen, foresee, states_at, worst
from sagnode.plan.frame import Look
from sagnode.plan.improve import gains
from sagnode.quality import Cause, Validity
from sagnode.scene.render import render
from sagnode.scene.truth import true_quantities

PLAIN = Look("plain")
MIDDLE = LEVELS["middle"]
SAGS = {"L1": 2.1, "L2": 2.1}


@pytest.fixture(scope="module")
def plan() -> list[Foreseen]:
    """The surveyed camera, before a plain sky."""
    span, camera = simple_span()
    return foresee(span, camera, states_at(span, MIDDLE), PLAIN)


def measured(seed: int, directory: Path) -> tuple[list[ConductorMeasurement], dict[str, dict[str, float]]]:
    """What the node states of a frame of a world drawn from the survey's uncertainties, and the truth of it."""
    scene, moment = simple_scene(SAGS, backdrop="plain", seed=seed, error_scale=1.0)
    reference, lens = directory / "reference.png", directory / "camera.yaml"
    cv2.imwrite(str(reference), render(scene, replace(moment, seed=99)).image)
    save_intrinsics(lens, simple_span()[1].intrinsics)
    camera = scene.surveyed.camera.model_copy(update={"reference_image": reference, "intrinsics": lens})
    site = load_site(scene.surveyed.model_copy(update={"camera": camera}))
    true = scene.true
    truth = {c.id: true_quantities(true, c, moment.wires[c.id]) for c in true.conductors}
    return measure_burst(site, [render(scene, moment).image]), truth


def test_the_planned_uncertainty_is_the_stated_one_and_the_errors_are_of_that_size(
    plan: list[Foreseen], tmp_path: Path
) -> None:
    expected = {one.conductor: one for one in plan}
    errors = []
    for seed in range(1, 5):
        readings, truth = measured(seed, tmp_path)
        for reading in readings:
            for stem in ("sag", "clearance"):
                planned = expected[reading.conductor].estimates[stem].u
                assert reading.estimates[stem].u == pytest.approx(planned, rel=0.25)
                errors.append((reading.estimates[stem].value - truth[reading.conductor][stem]) / planned)
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_a_conductor_is_told_with_its_share_its_widths_and_its_budget(plan: list[Foreseen]) -> None:
    focal = simple_span()[1].intrinsics.fx
    for one in plan:
        assert one.validity is Validity.GOOD
        assert one.sag_m == pytest.approx(2.1, rel=1e-3)
        assert 0.5 < one.in_view < 1.0
        assert 0.5 < one.stands_out <= 1.0
        assert one.width_px is not None
        near, middle, far = one.width_px
        assert near > middle > far
        assert far == pytest.approx(0.02 * focal / 60, rel=0.02)
        for stem in ("sag", "clearance"):
            parts = np.array(list(one.budget[stem].values()))
            assert np.sqrt(np.sum(parts**2)) == pytest.approx(one.estimates[stem].u, rel=1e-6)


def test_wires_that_are_too_faint_or_not_in_the_picture_are_expected_to_be_refused() -> None:
    span, camera = simple_span()
    faint = foresee(span, camera, states_at(span, MIDDLE), Look("plain", contrast=1.0, noise=6.0))
    assert all(one.validity is Validity.INVALID for one in faint)
    away = foresee(span, replace(camera, azimuth_deg=180.0), states_at(span, MIDDLE), PLAIN)
    assert [one.in_view for one in away] == [0.0, 0.0]
    assert all(one.reasons[0].cause is Cause.NO_CONDUCTOR for one in away)
    assert all(one.width_px is None and not one.estimates for one in away)


def test_landmarks_out_of_the_picture_do_not_count(plan: list[Foreseen]) -> None:
    span, camera = simple_span()
    assert len(planned_site(span, camera).landmark_ids) == 6
    narrow = replace(camera, intrinsics=replace(camera.intrinsics, fx=4000.0, fy=4000.0))
    assert len(planned_site(span, narrow).landmark_ids) < 6
    few = planned_site(span.model_copy(update={"landmarks": ()}), camera)
    assert few.landmark_ids == ()
    (one, _) = foresee(span.model_copy(update={"landmarks": ()}), camera, states_at(span, MIDDLE), PLAIN)
    assert one.estimates["clearance"].u > 1.5 * plan[0].estimates["clearance"].u


def test_what_would_help_is_what_does_help(plan: list[Foreseen]) -> None:
    span, camera = simple_span()
    site = planned_site(span, camera)
    weakest = worst(plan)
    told = {gain.what: gain for gain in gains(site, weakest)}
    better = {
        "attachments half as uncertain": span.model_copy(
            update={
                "conductors": tuple(
                    c.model_copy(update={"attachment_u_m": c.attachment_u_m / 2}) for c in span.conductors
                )
            }
        ),
        "landmark positions half as uncertain": span.model_copy(
            update={
                "landmarks": tuple(m.model_copy(update={"position_u_m": m.position_u_m / 2}) for m in span.landmarks)
            }
        ),
        "ground heights half as uncertain": span.model_copy(
            update={"ground": span.ground.model_copy(update={"height_u_m": span.ground.height_u_m / 2})}
        ),
    }
    for what, improved in better.items():
        (again,) = [
            o for o in foresee(improved, camera, states_at(span, MIDDLE), PLAIN) if o.conductor == weakest.conductor
        ]
        assert told[what].sag_u == pytest.approx(again.estimates["sag"].u, rel=0.03), what
        assert told[what].clearance_u == pytest.approx(again.estimates["clearance"].u, rel=0.03), what
    shares = [gain.best for gain in told.values()]
    assert shares == sorted(shares, reverse=True)
    assert told["ground heights half as uncertain"].sag_share == 0.0
    assert told["attachments half as uncertain"].sag_share > 0.1


def test_the_same_camera_through_a_shorter_lens_is_less_certain(plan: list[Foreseen]) -> None:
    span, camera = simple_span()
    lens = camera.intrinsics
    short = camera_of(span, replace(lens, fx=lens.fx / 2, fy=lens.fy / 2, distortion=(), reach=0.0))
    assert (
        worst(foresee(span, short, states_at(span, MIDDLE), PLAIN)).estimates["sag"].u > worst(plan).estimates["sag"].u
    )
