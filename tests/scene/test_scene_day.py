"""The simulated day and the true world behind a survey."""

from __future__ import annotations

import itertools
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from presets import preset
from sagnode.errors import ConfigError
from sagnode.geometry.camera import Intrinsics
from sagnode.scene.day import DayPlan, Spell, day_of_moments, sag_at_temperature, sun_position
from sagnode.scene.noise import generator
from sagnode.scene.perturb import perturbed, perturbed_intrinsics
from sagnode.scene.site import demo_site


@pytest.mark.parametrize(
    ("time", "latitude", "longitude", "azimuth", "elevation"),
    [
        # noon at Greenwich at the solstice: 90 - 51.48 + 23.44
        (datetime(2026, 6, 21, 12, 2, tzinfo=UTC), 51.48, 0.0, 180.0, 61.96),
        # the equinox of 2026-03-20 14:46 UTC: the sun is overhead where it is true noon, 39.6 degrees west
        (datetime(2026, 3, 20, 14, 46, tzinfo=UTC), 0.0, -39.6, None, 90.0),
        (datetime(2026, 12, 21, 12, 0, tzinfo=UTC), 51.48, 0.0, 180.0, 15.1),
    ],
)
def test_the_sun_stands_where_astronomy_puts_it(
    time: datetime, latitude: float, longitude: float, azimuth: float | None, elevation: float
) -> None:
    found = sun_position(time, latitude, longitude)
    assert found[1] == pytest.approx(elevation, abs=0.6)
    if azimuth is not None:
        assert found[0] == pytest.approx(azimuth, abs=1.5)


def test_sag_rises_with_temperature_as_the_published_span_does() -> None:
    """ASTER600 on 269.7 m, p = 1200 m at 15 °C: sags at 40, 60, 80 °C by mechaphlowers 0.13.1, within 3 mm."""
    conductor = preset("tower")[0].conductors[0]
    stringing = {
        "temperature_c": 15.0,
        "tension_n": 1200 * 17.658,
        "section_mm2": 600.4,
        "modulus_gpa": 60.0,
        "expansion_per_k": 23e-6,
    }
    aster = {"stringing": stringing, "unit_weight_n_m": 17.658, "diameter_m": 0.0319}
    conductor = type(conductor).model_validate(conductor.model_dump() | aster)
    sags = [sag_at_temperature(conductor, t) for t in (15.0, 40.0, 60.0, 80.0)]
    assert sags == pytest.approx([7.585, 8.463, 9.122, 9.745], abs=0.012)


def test_a_day_is_smooth_repeatable_and_possible() -> None:
    site = demo_site()
    times = [moment.time for moment in site.day]
    assert all(b - a == timedelta(minutes=30) for a, b in itertools.pairwise(times))
    limits = {c.id: (c.sag_min_m, c.sag_max_m) for c in site.scene.true.conductors}
    for before, after in zip(site.day, site.day[1:], strict=False):
        for name, state in after.wires.items():
            low, high = limits[name]
            assert low < state.sag_m < high
            assert abs(state.sag_m - before.wires[name].sag_m) < 0.6
            assert abs(state.swing_deg) < 25
        assert np.hypot(*after.turn_rad[:2]) * 2050 < 30
    again = demo_site()
    assert again.day == site.day
    sags = [m.wires["L1"].sag_m for m in site.day]
    assert max(sags) - min(sags) > 0.8


def test_conductors_swing_together() -> None:
    site = demo_site()
    left, right = (np.array([m.wires[name].swing_deg for m in site.day]) for name in ("L1", "L2"))
    assert np.corrcoef(left, right)[0, 1] > 0.8


def test_a_spell_brings_its_weather() -> None:
    span = demo_site().scene.true
    plan = DayPlan(spells=(Spell((10.0, 11.0), fog_per_m=0.03, lens="covered", turn_rad=(0.0, 0.5, 0.0)),))
    times = [datetime(2026, 6, 21, h, tzinfo=UTC) for h in (9, 10, 11)]
    before, during, after = day_of_moments(span, plan, times, seed=3)
    assert (before.lens, during.lens, after.lens) == ("clear", "covered", "clear")
    assert during.fog_per_m == 0.03
    assert during.turn_rad[1] > 0.4 > abs(after.turn_rad[1])


def test_a_day_needs_stringing_data() -> None:
    span, _ = preset("tower")
    with pytest.raises(ConfigError, match=r"L1.*stringing"):
        day_of_moments(span, DayPlan(), [datetime(2026, 6, 21, tzinfo=UTC)], seed=1)


def test_true_worlds_scatter_about_the_survey_as_it_says() -> None:
    survey, intrinsics = preset("tower")
    rng = generator(7, "errors")
    worlds = [perturbed(survey, rng) for _ in range(400)]
    lenses = [perturbed_intrinsics(intrinsics, survey, rng) for _ in range(400)]

    def check(values: list[float], centre: float, u: float) -> None:
        assert np.std(values) == pytest.approx(u, rel=0.15)
        assert np.mean(values) == pytest.approx(centre, abs=0.2 * u)

    check([w.conductors[1].far[2] for w in worlds], survey.conductors[1].far[2], 0.05)
    check([w.landmarks[2].position[0] for w in worlds], survey.landmarks[2].position[0], 0.03)
    check([w.ground.profile[1][1] for w in worlds], survey.ground.profile[1][1], survey.ground.height_u_m)
    check([w.camera.azimuth_deg for w in worlds], survey.camera.azimuth_deg, 0.3)
    check([k.fx / intrinsics.fx for k in lenses], 1.0, 0.001)
    check([k.distortion[0] for k in lenses], intrinsics.distortion[0], 0.002)
    assert all(k.fx / k.fy == pytest.approx(intrinsics.fx / intrinsics.fy) for k in lenses)


def test_no_errors_give_the_survey_back() -> None:
    survey, intrinsics = preset("lab")
    assert perturbed(survey, generator(1), 0.0) == survey
    assert perturbed_intrinsics(intrinsics, survey, generator(1), 0.0) == intrinsics
    assert isinstance(intrinsics, Intrinsics)
