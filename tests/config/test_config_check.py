"""Looking a configuration over: each oddity gives its warning, and sound ones give none."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from config_files import CAMERA, SiteFiles

from sagnode.calibrate.files import save_intrinsics
from sagnode.check.configuration import Report, check
from sagnode.geometry.camera import Intrinsics

CONFIGS = Path(__file__).parents[2] / "configs"
DEMO = Path(__file__).parents[2] / "src" / "sagnode" / "demo" / "site"


def keys(report: Report) -> list[str]:
    return [warning.key for warning in report.warnings]


def test_a_sound_configuration_gives_neither_fault_nor_warning(site: SiteFiles) -> None:
    report = check(site.node)
    assert (report.faults, report.warnings) == ((), ())
    assert report.loaded is not None


@pytest.mark.parametrize(
    ("example", "expected"),
    [
        ("lab", ["camera.replay.path", "camera"]),
        ("field-110kv", ["mqtt.password_file", "mqtt.tls.ca_file", "camera"]),
    ],
)
def test_the_examples_are_in_order_but_for_the_files_that_a_user_adds(example: str, expected: list[str]) -> None:
    report = check(CONFIGS / example)
    assert report.faults == ()
    assert keys(report) == expected
    assert "without a reference_image" in report.warnings[-1].text


def test_the_demonstrations_site_is_in_order_and_lacks_a_broker_only() -> None:
    report = check(DEMO)
    assert report.faults == ()
    assert [warning.text for warning in report.warnings] == [
        "there is no table [mqtt]; readings are kept and shown here, and published nowhere"
    ]


def test_the_papers_clearances_come_out_of_the_examples() -> None:
    from sagnode.config.load import load_any
    from sagnode.geometry.quantities import Shape, quantities
    from sagnode.site import ground_profile

    for example, sag, expected in (("lab", 0.09, [0.18, 0.21]), ("field-110kv", 8.42, [6.39] * 3)):
        span = load_any(CONFIGS / example).span
        found = [
            quantities(Shape(np.array(c.near), np.array(c.far), sag), ground_profile(span.ground))["clearance"]
            for c in span.conductors
        ]
        assert found == pytest.approx(expected, abs=0.002)


@pytest.mark.parametrize(
    ("change", "key", "text"),
    [
        (lambda n: n["unit"].update(span="T7-T8"), "unit.span", "'T7-T8' is not the name in the span file ('T1-T2')"),
        (lambda n: n["unit"].update(commissioning=True), "unit.commissioning", "every reading is marked as a test"),
        (lambda n: n["schedule"].update(deadline_s=301), "schedule.deadline_s", "is longer than interval_s = 300"),
        (lambda n: n.pop("mqtt"), "", "no table [mqtt]"),
        (
            lambda n: n["mqtt"].update(host="broker.example.org", insecure_plaintext=True),
            "mqtt.insecure_plaintext",
            "in plain text",
        ),
        (lambda n: n["mqtt"].update(tls={"ca_file": "ca.crt"}), "mqtt.tls.ca_file", "file not found"),
        (lambda n: n["camera"]["replay"].update(path="frames/*.jpg"), "camera.replay.path", "matches nothing"),
        (
            lambda n: n["camera"].update(backend="picamera2", picamera2={"width": 800, "height": 600}),
            "camera.intrinsics",
            "belong to pictures of 1456x1088 px, and the node's [camera.picamera2] takes 800x600",
        ),
        (
            lambda n: n["camera"].update(backend="v4l2", v4l2={"device": "/dev/no-such-video"}),
            "camera.v4l2.device",
            "/dev/no-such-video is not there",
        ),
    ],
)
def test_oddities_of_the_node_file(site: SiteFiles, change: Any, key: str, text: str) -> None:
    report = check(site.write(node=change).node)
    assert report.faults == ()
    assert keys(report) == [key]
    assert text in report.warnings[0].text


def _swapped(name: str) -> Any:
    """Near and far of a conductor exchanged."""

    def change(span: dict[str, Any]) -> None:
        for conductor in span["conductors"]:
            if conductor["id"] == name or not name:
                conductor["near"], conductor["far"] = conductor["far"], conductor["near"]

    return change


@pytest.mark.parametrize(
    ("change", "key", "text"),
    [
        (lambda s: s.update(landmarks=s["landmarks"][:3]), "landmarks", "there are 3"),
        (lambda s: s["camera"].pop("reference_image"), "camera", "without a reference_image"),
        (
            lambda s: s["landmarks"][3].update(pixel=[900.0, 300.0]),
            "landmarks[3]",
            "px from its clicked pixel even with the camera turned to fit the landmarks",
        ),
        (
            lambda s: s["landmarks"][3].update(pixel=[1456.0, 706.2], pixel_u_px=400),
            "landmarks[3].pixel",
            "outside the picture of 1456x1088 px",
        ),
        (
            lambda s: s["landmarks"][4].update(position=[-9.0, -70.0, 5.0]),
            "landmarks[4].position",
            "barn lies behind the camera",
        ),
        (lambda s: s["camera"].update(roll_deg=15.0), "camera", "landmarks lie up to"),
        (lambda s: s["camera"].update(azimuth_deg=2.5), "camera", "check azimuth, elevation, roll and position"),
        (lambda s: s["ground"].update(profile=[[0.0, 0.0], [80.0, 0.4]]), "conductors[0]", "goes from 0 to 80 m"),
        (
            lambda s: s.update(limits={"clearance_min_m": 11.5}),
            "conductors[0].sag_min_m",
            "the alarm would never clear",
        ),
        (
            lambda s: s.update(limits={"clearance_min_m": 6.0}),
            "conductors[0].sag_max_m",
            "would not be found; raise it",
        ),
        (lambda s: s.update(limits={"sag_max_m": 0.5}), "conductors[0].sag_min_m", "exceeds limits.sag_max_m = 0.5"),
        (lambda s: s.update(limits={"sag_max_m": 5.0}), "conductors[0].sag_max_m", "ends before limits.sag_max_m = 5"),
        (
            lambda s: s["conductors"][0].update(sag_max_m=14.0),
            "conductors[0].sag_max_m",
            "m below ground, ",
        ),
        (lambda s: s["ground"].update(profile=[[0.0, 12.0], [100.0, 12.0]]), "conductors[0].sag_min_m", "would touch"),
        (_swapped("L2"), "conductors[1]", "L2 runs against L1; are its near and far swapped?"),
    ],
)
def test_oddities_of_the_span_file(site: SiteFiles, change: Any, key: str, text: str) -> None:
    report = check(site.write(span=change).node)
    assert report.faults == ()
    assert (key, True) in [(warning.key, text in warning.text) for warning in report.warnings]


def test_a_wrong_landmark_is_named_and_the_right_ones_are_not(site: SiteFiles) -> None:
    report = check(site.write(span=lambda s: s["landmarks"][1].update(id="wrong", position=[3.0, 100.0, 13.0])).node)
    assert keys(report) == ["landmarks[1]"]


def _phases(*given: dict[str, Any]) -> Any:
    return lambda span: [conductor.update(of) for conductor, of in zip(span["conductors"], given, strict=True)]


@pytest.mark.parametrize(
    ("given", "warned"),
    [
        (({"phase": "L1"}, {"phase": "L1"}), True),
        (({"phase": "L1", "circuit": "north"}, {"phase": "L1", "circuit": "north"}), True),
        (({"phase": "L1", "circuit": "north"}, {"phase": "L1", "circuit": "south"}), False),
        (({"phase": "L1"}, {"phase": "L2"}), False),
        (({"phase": "earth"}, {"phase": "earth", "measured": False}), False),
        (({}, {}), False),
    ],
)
def test_two_conductors_of_one_circuit_have_two_phases(
    site: SiteFiles, given: tuple[dict[str, Any], ...], warned: bool
) -> None:
    report = check(site.write(span=_phases(*given)).node)
    assert report.faults == ()
    assert keys(report) == (["conductors[1].phase"] if warned else [])
    assert all("L2 and L1 are both L1" in warning.text for warning in report.warnings)


def test_a_slightly_turned_camera_within_its_uncertainty_is_no_oddity(site: SiteFiles) -> None:
    assert check(site.write(span=lambda s: s["camera"].update(azimuth_deg=0.4, elevation_deg=3.2)).node).warnings == ()


def test_a_camera_that_looks_away_sees_nothing(site: SiteFiles) -> None:
    def away(span: dict[str, Any]) -> None:
        span["camera"].update(azimuth_deg=180.0)
        span["landmarks"] = []

    report = check(site.write(span=away).node)
    texts = [warning.text for warning in report.warnings]
    assert any("L1 is not in the picture at any sag" in text for text in texts)
    assert any("far attachment of L1 lies behind the camera" in text for text in texts)


def test_the_wrong_end_called_near_is_noticed(site: SiteFiles) -> None:
    report = check(site.write(span=_swapped("")).node)
    assert any("'near' is meant to be the camera's end" in warning.text for warning in report.warnings)


def test_a_lens_too_short_is_noticed(site: SiteFiles) -> None:
    save_intrinsics(site.directory / "camera.yaml", Intrinsics(1456, 1088, 50.0, 50.0, 727.5, 543.5))
    texts = [warning.text for warning in check(site.node).warnings]
    assert any("its lens too short to measure it" in text for text in texts)


@pytest.mark.parametrize(
    ("note", "warned"),
    [
        ({"avg_reprojection_error": 17.0}, "avg_reprojection_error = 17 px"),
        ({"rms_px": 0.6}, "rms_px = 0.6 px"),
        ({"rms": float("nan")}, "rms = nan px"),
        ({"rms_px": 0.2}, None),
        ({"rms": "unknown"}, None),
    ],
)
def test_a_calibration_that_says_itself_that_it_fits_badly_is_noticed(
    site: SiteFiles, note: dict[str, float | str], warned: str | None
) -> None:
    save_intrinsics(site.directory / "camera.yaml", CAMERA, note)
    report = check(site.node)
    assert report.faults == ()
    assert keys(report) == (["camera.intrinsics"] if warned else [])
    assert warned is None or warned in report.warnings[0].text


def test_a_damaged_calibration_is_a_fault(site: SiteFiles) -> None:
    (site.directory / "camera.yaml").write_text("%YAML:1.0\n---\nimage_width: 1456\n")
    report = check(site.node)
    assert [fault.key for fault in report.faults] == ["camera.intrinsics"] * len(report.faults)
    assert any("camera_matrix" in fault.text for fault in report.faults)


def test_a_reference_image_of_another_size_or_that_is_none_is_a_fault(site: SiteFiles) -> None:
    cv2.imwrite(str(site.directory / "reference.png"), np.zeros((100, 200), np.uint8))
    (fault,) = check(site.node).faults
    assert fault.line == 27
    assert "has 200x100 px, and the intrinsics belong to 1456x1088" in fault.text
    (site.directory / "reference.png").write_text("no picture")
    (fault,) = check(site.node).faults
    assert fault.key == "camera.reference_image"


def _upside_down(picture: Any) -> Any:
    return picture[::-1, ::-1]


def _noise_only(picture: Any) -> Any:
    return np.random.default_rng(2).normal(128, 6, picture.shape).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("spoil", "missing"),
    [
        (np.zeros_like, "10 of 10 landmarks are not in reference.jpg"),
        (_noise_only, "10 of 10 landmarks are not in reference.jpg"),
        (_upside_down, "target-left, target-right, target-middle, barn-ridge, house-ridge and 1 more were clicked"),
    ],
)
def test_a_reference_picture_without_the_landmarks_that_were_clicked_is_noticed(
    tmp_path: Path, spoil: Any, missing: str
) -> None:
    shutil.copytree(DEMO, tmp_path / "site", ignore=shutil.ignore_patterns("frames"))
    reference = tmp_path / "site" / "reference.jpg"
    picture = cv2.imread(str(reference), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(reference), spoil(picture), [cv2.IMWRITE_JPEG_QUALITY, 95])
    report = check(tmp_path / "site" / "span.toml")
    assert report.faults == ()
    (warning,) = report.warnings
    assert warning.key == "camera.reference_image"
    assert missing in warning.text


def test_a_landmark_whose_square_reaches_over_the_edge_is_named(site: SiteFiles) -> None:
    site.write(span=lambda s: s["landmarks"][2].update(size_px=255, pixel=[800.0, 90.0], position_u_m=9.0))
    warnings = check(site.node).warnings
    assert [(w.key, "lies 90 px from the edge of reference.png" in w.text) for w in warnings] == [
        ("landmarks[2].pixel", True)
    ]


def test_a_span_file_alone_is_looked_over_too(site: SiteFiles) -> None:
    site.write(span=lambda s: s["conductors"][0].update(sag_max_m=14.0))
    assert "conductors[0].sag_max_m" in keys(check(site.span))
