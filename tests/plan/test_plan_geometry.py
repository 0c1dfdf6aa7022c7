"""Lenses, places, directions and neighbours of a plan."""

from dataclasses import replace

import numpy as np
import pytest
from plan_spans import simple_span

from sagnode.errors import ConfigError
from sagnode.geometry.camera import Intrinsics
from sagnode.plan.camera import planned_site
from sagnode.plan.lenses import lens_on, named_sensor, sensor_of
from sagnode.plan.neighbours import MERGED_PX, neighbours
from sagnode.plan.places import grid_places
from sagnode.plan.study import aimed


def test_millimetres_become_pixels() -> None:
    lens = lens_on(named_sensor("IMX296"), 6.0)
    assert (lens.width, lens.height) == (1456, 1088)
    assert lens.fx == lens.fy == pytest.approx(6.0 / 3.45e-3)
    assert (lens.cx, lens.cy) == (727.5, 543.5)
    own = named_sensor("1000x800x2.5")
    assert (own.width, own.height, own.pitch_um) == (1000, 800, 2.5)
    assert sensor_of(lens) is named_sensor("imx296")
    assert sensor_of(Intrinsics(123, 77, 100.0, 100.0, 61.0, 38.0)) is None


@pytest.mark.parametrize("text", ["imx999", "1000x800", "10x10x3", "99999x99999x3", "1000x800x0", "axbxc"])
def test_an_unknown_sensor_names_the_known_ones(text: str) -> None:
    with pytest.raises(ConfigError, match="no such sensor") as caught:
        named_sensor(text)
    assert "imx296" in caught.value.remedy


def test_a_camera_is_turned_to_where_the_span_is_seen() -> None:
    span, camera = simple_span()
    side = aimed(span, replace(camera, position=(40.0, 30.0, 3.0)))
    assert side.azimuth_deg == pytest.approx(-90.0, abs=25.0)
    assert abs(side.elevation_deg) < 10.0
    along = aimed(span, camera)
    assert along.azimuth_deg == pytest.approx(0.0, abs=15.0)
    assert len(planned_site(span, along).landmark_ids) >= 5
    behind = aimed(span, replace(camera, position=(0.0, -80.0, 6.0)))
    assert (behind.azimuth_deg, behind.elevation_deg) == (pytest.approx(0.0, abs=3.0), pytest.approx(0.0, abs=3.0))


def test_a_wanted_direction_is_kept_where_it_shows_nearly_as_much() -> None:
    span, camera = simple_span()
    kept = aimed(span, camera, (1.0, 2.0))
    assert (kept.azimuth_deg, kept.turned_from) == (1.0, None)
    turned = aimed(span, camera, (90.0, 2.0))
    assert turned.azimuth_deg == pytest.approx(0.0, abs=15.0)
    assert turned.turned_from == (90.0, 2.0)
    assert aimed(span, turned).turned_from is None


def test_places_of_a_grid_count_along_the_span_to_its_right_and_up_from_the_ground() -> None:
    span, _ = simple_span()
    places = grid_places(span, [0.0, 60.0], [0.0, 30.0], [2.0])
    assert places == [
        pytest.approx((-2.6, 0.0, 2.0)),
        pytest.approx((27.4, 0.0, 2.0)),
        pytest.approx((-2.6, 60.0, 2.2)),
        pytest.approx((27.4, 60.0, 2.2)),
    ]


def line(*ends: tuple[float, float], count: int = 101) -> np.ndarray:
    return np.linspace(*np.array(ends, dtype=float), count)


def test_neighbours_merge_cross_and_keep_away() -> None:
    curve = line((0, 100), (400, 100))
    others = {
        "parallel": line((0, 102), (400, 102)),
        "crossing": line((150, 0), (250, 200)),
        "far": line((0, 300), (400, 300)),
        "ahead": line((410, 90), (500, 0)),
        "hidden": np.full((101, 2), np.nan),
    }
    found = {n.conductor: n for n in neighbours(curve, others)}
    assert set(found) == {"parallel", "crossing", "ahead"}
    assert found["parallel"].closest_px == pytest.approx(2.0)
    assert found["parallel"].merged_share == 1.0
    assert not found["parallel"].crosses
    assert found["crossing"].crosses
    assert found["crossing"].closest_px < MERGED_PX
    assert found["crossing"].at_share == pytest.approx(0.5, abs=0.02)
    assert 0 < found["crossing"].merged_share < 0.05
    assert not found["ahead"].crosses


def test_curves_out_of_the_frame_have_no_neighbours() -> None:
    assert neighbours(np.full((50, 2), np.nan), {"other": line((0, 0), (10, 0))}) == []
