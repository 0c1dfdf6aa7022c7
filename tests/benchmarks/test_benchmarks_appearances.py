"""The benchmark of appearances: its counts, and that its report says what was counted."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from appearances import disturbed, pose_error, year
from appearances_report import Outcome, Tally, document
from groups import groups_by_name
from sagnode.estimate.register import register
from sagnode.pipeline import load_site
from sagnode.scene.render import render
from sagnode.site import Site
from worlds import Setting, any_moment, settle


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> tuple[Setting, Site]:
    setting = settle(groups_by_name("side100")[0], 3, 0, tmp_path_factory.mktemp("world"))
    return setting, load_site(setting.survey)


def test_a_year_has_snow_only_in_winter_and_goes_forward(world: tuple[Setting, Site]) -> None:
    moments = list(year(world[0], np.random.default_rng(2)))
    times = [at for at, _ in moments]
    assert times == sorted(times)
    assert times[-1] - times[0] > datetime(2026, 11, 1, tzinfo=UTC) - datetime(2026, 3, 10, tzinfo=UTC)
    assert all(at.month in (11, 12, 1, 2, 3) for at, moment in moments if moment.snow)
    assert all(moment.relief == 1.0 for _, moment in moments)


def test_the_error_of_the_pose_is_small_where_all_is_well_and_large_where_the_camera_is_elsewhere(
    world: tuple[Setting, Site],
) -> None:
    setting, site = world
    moment = any_moment(setting)
    registered, reasons = register(site, render(setting.scene, moment).image)
    assert not reasons
    now = registered.tracked.pixels if registered.tracked is not None else np.empty((0, 2))
    assert np.isfinite(now).all()
    pixels, z, aside = pose_error(site, setting.scene, moment, registered, now)
    assert aside < 0.2
    assert pixels < 3.0
    assert z < 4.0
    elsewhere = replace(moment, turn_rad=(0.02, 0.02, 0.0))
    assert pose_error(site, setting.scene, elsewhere, registered, now)[0] > 10.0


def test_something_hides_a_landmark(world: tuple[Setting, Site]) -> None:
    plain = np.full((1088, 1456), 90, np.uint8)
    changed = disturbed(plain, world[1], np.random.default_rng(1))
    assert (changed != plain).any()
    assert (plain == 90).all()


def test_the_report_tells_the_counts() -> None:
    told = Tally(frames=10, visible=60, found=57, lost=1, pixels=[0.5] * 9, z=[1.0] * 8 + [9.0], aside=[0.25] * 9)
    outcome = Outcome(
        without=Tally(frames=10, visible=60), kept=told, places=[0.1, -0.1], readings=[(False, True, 0.4)]
    )
    text = document({"side100": [outcome]}, 3)
    assert "| side100, with appearances | 10 | 95.0 % | 1 | 0.25 | 0.25 | 0.50 |" in text
    assert "| side100, reference alone | 10 | – | 0 |" in text
    assert "1 landmarks were found by an appearance, 0.10 px off" in text
    assert "Told by the reference alone: 0; with appearances: 1" in text
