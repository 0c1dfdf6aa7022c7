"""Weight, section and tension of a wire against each other: wrong units are noticed, no real wire is."""

from __future__ import annotations

from typing import Any

import pytest
from config_files import SiteFiles
from pydantic import ValidationError

from sagnode.check.configuration import check
from sagnode.check.wire_warnings import wire_warnings
from sagnode.config.span import Conductor

# name, span m, diameter mm, section mm2, weight N/m, tension N, modulus GPa, expansion 1e-6/K, sags searched
REAL = [
    ("Al/St 240/40", 269.7, 21.8, 282.5, 9.61, 10500, 77, 18.9, (6.0, 11.5)),
    ("Aster 600", 269.7, 31.9, 600.4, 17.66, 21190, 60, 23.0, (5.0, 12.0)),
    ("hard-drawn copper 70", 120, 10.5, 65.8, 5.85, 6000, 113, 17.0, (1.0, 4.0)),
    ("solid trolley wire 107", 60, 12.0, 107, 9.33, 10000, 120, 17.0, (0.2, 1.5)),
    ("ACCC Drake", 400, 28.1, 588, 15.3, 31000, 66, 15.0, (6.0, 16.0)),
    ("steel strand 7/3.25", 270, 9.75, 58.0, 4.5, 9000, 185, 11.5, (2.5, 9.0)),
    ("river crossing, steel", 1500, 36.0, 760, 59.0, 450000, 180, 11.5, (25.0, 60.0)),
    ("optical earth wire", 300, 15.0, 95.0, 4.6, 9500, 115, 15.0, (3.0, 9.0)),
    ("all-dielectric cable", 200, 13.0, 130.0, 1.35, 2400, 12, 4.0, (1.5, 6.0)),
    ("covered conductor", 60, 18.0, 99.0, 3.6, 2500, 62, 23.0, (0.2, 2.0)),
    ("slack bar of a substation", 30, 36.0, 774, 21.3, 1700, 57, 23.0, (0.7, 2.5)),
    ("nylon thread", 2.7, 0.3, 0.0707, 0.00079, 0.008, 3, 80.0, (0.04, 0.16)),
    ("cotton thread", 1.0, 0.5, 0.15, 0.001, 0.0016, 3, 10.0, (0.02, 0.16)),
]


def wire(
    span: float,
    diameter: float,
    section: float,
    weight: float,
    tension: float,
    modulus: float,
    expansion: float,
    sags: tuple[float, float],
    **other: float,
) -> dict[str, Any]:
    stringing = {
        "temperature_c": other.get("temperature", 20.0),
        "tension_n": tension,
        "section_mm2": section,
        "modulus_gpa": modulus,
        "expansion_per_k": expansion * 1e-6,
    }
    return {
        "id": "L1",
        "near": (0.0, 0.0, 20.0),
        "far": (0.0, span, 20.5),
        "diameter_m": diameter / 1000,
        "unit_weight_n_m": weight,
        "stringing": stringing,
        "sag_min_m": sags[0],
        "sag_max_m": sags[1],
    }


@pytest.mark.parametrize("real", REAL, ids=lambda real: real[0])
def test_real_wires_pass_without_a_word(real: tuple[Any, ...]) -> None:
    assert list(wire_warnings(Conductor.model_validate(wire(*real[1:])))) == []


NAMES = ("span", "diameter", "section", "weight", "tension", "modulus", "expansion", "sags")
RIGHT = dict(zip(NAMES, REAL[0][1:], strict=True))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"weight": 9610}, "denser than any matter"),
        ({"diameter": 0.0218}, "denser than any matter"),
        ({"section": 2825}, "more than a solid wire"),
        ({"section": 282.5e-6}, "which no matter bears"),
        ({"section": 282.5e-9}, "section_mm2"),
        ({"temperature": -400}, "temperature_c"),
        ({"tension": 1e-300}, "tension_n"),
        ({"modulus": 77000}, "modulus_gpa"),
        ({"expansion": 18.9e6}, "expansion_per_k"),
    ],
)
def test_what_no_wire_can_be_is_a_fault(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        Conductor.model_validate(wire(**{**RIGHT, **wrong}))


@pytest.mark.parametrize(
    ("wrong", "key", "says"),
    [
        ({"tension": 1050}, ("stringing", "tension_n"), "83.2 m of sag, and 6 to 11.5 m are searched"),
        ({"tension": 105000}, ("stringing", "tension_n"), "0.832 m of sag"),
        ({"weight": 0.98}, ("unit_weight_n_m",), "newton per metre"),
        ({"weight": 4 * 9.61}, ("unit_weight_n_m",), "of one sub-conductor"),
        ({"section": 28.25}, ("stringing", "section_mm2"), "7.6 % of what"),
        ({"tension": 450000}, ("stringing", "tension_n"), "1.59e+03 MPa"),
        ({"temperature": 400}, ("stringing",), "no temperature is told below -60 or above 300"),
    ],
)
def test_what_is_odd_is_a_warning(wrong: dict[str, Any], key: tuple[str, ...], says: str) -> None:
    said = list(wire_warnings(Conductor.model_validate(wire(**{**RIGHT, **wrong}))))
    assert [True for where, text in said if where == key and says in text], said


def test_both_are_said_with_their_place(site: SiteFiles) -> None:
    report = check(site.write(span=lambda s: s["conductors"][1].update(unit_weight_n_m=9610.0)).node)
    assert report.loaded is None
    assert any("conductors[1]: unit_weight_n_m = 9610" in str(fault) for fault in report.faults)
    report = check(site.write(span=lambda s: s["conductors"][1].update(unit_weight_n_m=0.8)).node)
    assert [warning.key for warning in report.warnings] == ["conductors[1].unit_weight_n_m"]


def test_an_obstacle_beyond_the_span_counts_for_nothing_and_that_is_said(site: SiteFiles) -> None:
    def with_roads(*roads: tuple[float, float]) -> list[tuple[str, str]]:
        obstacles = [{"id": f"road{i}", "along_m": list(along), "height_m": 1.0} for i, along in enumerate(roads)]
        report = check(site.write(span=lambda s: s["ground"].update(obstacles=obstacles)).node)
        assert report.faults == ()
        return [(warning.key, warning.text) for warning in report.warnings]

    assert with_roads((55.0, 61.0), (-4.0, 3.0), (97.0, 120.0)) == []
    ((key, text),) = with_roads((55.0, 61.0), (550.0, 610.0))
    assert key == "ground.obstacles[1].along_m"
    assert "no alarm will be raised" in text
    assert len(with_roads((-9.0, -2.0))) == 1
