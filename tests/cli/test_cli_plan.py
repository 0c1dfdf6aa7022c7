"""``sagnode plan``: from a half-finished span file to a verdict, a table, a picture; errors with a remedy."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import cv2
import pytest

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.cli.main import main
from sagnode.config.show import toml_text
from sagnode.plan.lenses import SENSORS

Capture = pytest.CaptureFixture[str]
SENSOR = "640x480x3.45"
LENS = ("--sensor", SENSOR, "--focal", "2.5")


def tables() -> dict[str, Any]:
    """A survey before anybody has climbed: no clicks, no calibration, no picture."""
    span = simple_scene()[0].surveyed
    document: dict[str, Any] = json.loads(span.model_dump_json(exclude_none=True, exclude_defaults=True))
    for landmark in document["landmarks"]:
        del landmark["pixel"]
    document["camera"].pop("intrinsics", None)
    return document


@pytest.fixture
def span_file(tmp_path: Path) -> Path:
    return write(tmp_path, tables())


def write(directory: Path, document: dict[str, Any]) -> Path:
    file = directory / "span.toml"
    file.write_text(toml_text(document))
    return file


def plan(capsys: Capture, *words: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main(["plan", "--backdrop", "plain", *map(str, words)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_span_that_nobody_has_climbed_for_is_planned(
    span_file: Path, tmp_path: Path, capsys: Capture, written: list[Any]
) -> None:
    picture = tmp_path / "drawn" / "view.png"
    code, out, _ = plan(capsys, "--config", span_file, *LENS, "--picture", picture)
    assert code == 0
    assert "not yet:" in out
    assert "landmarks[0].pixel: not clicked yet" in out
    assert "2.5 mm, f = 725 px" in out
    assert "6 landmarks in view" in out
    assert out.count("(middle)  ") == 2
    assert "u(sag) of L" in out
    assert "ground heights half as uncertain" in out
    drawn = cv2.imread(str(picture))
    assert drawn.shape[1] > 640
    assert drawn.std() > 10
    assert any("thick: middle sag" in word.text and "thin: small and large sag" in word.text for word in written)
    assert all(word.right <= drawn.shape[1] for word in written), "a line of the legend runs out of the picture"


def test_json_tells_the_same_to_a_program(span_file: Path, capsys: Capture) -> None:
    code, out, _ = plan(capsys, "--config", span_file, *LENS, "--json")
    document = json.loads(out)
    assert code == 0
    assert document["schema_version"] == "sagnode.plan/1"
    assert document["assumed"] == {"backdrop": "plain", "contrast_grey": 60.0, "noise_grey": 2.0}
    assert document["table"] == []
    told = document["plan"]["conductors"]
    assert [(one["conductor"], one["level"]) for one in told] == [
        (name, level) for level in ("small", "middle", "large", "wind") for name in ("L1", "L2")
    ]
    for one in told:
        assert one["expected"] == "good"
        assert one["sag_half_width"] == pytest.approx(1.96 * one["sag_u"], rel=1e-3)
        assert one["clearance_mostly_from"] == max(one["clearance_budget"], key=one["clearance_budget"].get)
        assert one["wire_px"]["near"] > one["wire_px"]["far"]
    gains = [max(gain["sag_gain"], gain["clearance_gain"]) for gain in document["plan"]["improvements"]]
    assert gains == sorted(gains, reverse=True)


def test_several_lenses_and_places_make_a_table_and_the_best_is_told(span_file: Path, capsys: Capture) -> None:
    words = ["--sensor", SENSOR, "--focal", "2", "2.5", "--camera", "-1.6,0.5,5", "--grid", "0.6,2.9,5.2"]
    code, out, err = plan(capsys, "--config", span_file, *words, "--json")
    document = json.loads(out)
    assert code == document["plan"]["conductors"].count({"expected": "refused"})
    rows = document["table"]
    assert [(row["camera"]["position"], row["camera"]["focal_mm"]) for row in rows] == [
        (pytest.approx(position, abs=0.01), mm)
        for position in ([-1.6, 0.5, 5.0], [0.3, 0.6, 5.21])
        for mm in (2.0, 2.5)
    ]

    def weakest(row: dict[str, Any]) -> float:
        return max(one["sag_u"] or 9.0 for one in row["conductors"])

    good = [row for row in rows if all(one["expected"] == "good" for one in row["conductors"])]
    assert document["plan"]["camera"] == min(good, key=weakest)["camera"]
    assert err == ""


def test_a_view_in_which_nothing_is_seen_exits_with_1(tmp_path: Path, capsys: Capture) -> None:
    document = tables()
    document["camera"]["azimuth_deg"] = 180.0
    save_intrinsics(tmp_path / "camera.yaml", simple_scene()[0].intrinsics)
    document["camera"]["intrinsics"] = "camera.yaml"
    code, out, _ = plan(capsys, "--config", write(tmp_path, document))
    assert code == 1
    assert "refused (no-conductor)" in out


def test_a_camera_that_is_turned_is_told_with_the_surveyed_direction(
    span_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    surveyed, away = tables(), tables()
    away["camera"] |= {"azimuth_deg": 70.0, "elevation_deg": 2.5}
    kept, turned = tmp_path / "kept.png", tmp_path / "turned.png"
    _, out, _ = plan(capsys, "--config", span_file, *LENS, "--picture", kept)
    assert f"azimuth {surveyed['camera']['azimuth_deg']:.1f}°" in out
    assert "turned from" not in out
    file = write(tmp_path, away)
    _, out, _ = plan(capsys, "--config", file, *LENS, "--picture", turned)
    assert out.count("\n  turned from the surveyed azimuth 70.0°, elevation 2.5°, which shows less\n") == 1
    assert cv2.imread(str(turned)).shape[0] == cv2.imread(str(kept)).shape[0] + 22, "a line more in the legend"
    _, out, _ = plan(capsys, "--config", file, "--sensor", SENSOR, "--focal", "2.5", "2", "--json")
    rows = json.loads(out)["table"]
    assert [row["camera"]["turned_from"] for row in rows] == [{"azimuth_deg": 70.0, "elevation_deg": 2.5}] * 2


def test_a_change_that_leaves_a_conductor_refused_is_told_with_that(tmp_path: Path, capsys: Capture) -> None:
    """The example survey without its landmarks: what helps most does not help enough, and is what has to be known."""
    main(["config", "init", "--out", str(tmp_path)])
    text = (tmp_path / "span.toml").read_text()
    first, last = text.index("[[landmarks]]"), text.index("# [swing]")
    (tmp_path / "span.toml").write_text(text[:first] + text[last:])
    words = ("--sensor", "imx296", "--focal", "6", "--backdrop", "country")
    code, out, _ = plan(capsys, "--config", tmp_path, *words)
    assert code == 1
    assert "  0 landmarks in view" in out
    told = out[out.index("First of all: survey landmarks") :].splitlines()
    rows = [line for line in told if line.endswith(" %")]
    assert rows[0].startswith("  eight landmarks more")
    assert "(still refused: uncertain)" in rows[0]
    assert int(re.findall(r"-(\d+) %", rows[0])[0]) > 30


def test_the_examples_own_survey_has_landmarks_to_plan_with(tmp_path: Path, capsys: Capture) -> None:
    main(["config", "init", "--out", str(tmp_path)])
    code, out, _ = plan(capsys, "--config", tmp_path, "--sensor", "imx296", "--focal", "6")
    assert code == 1
    assert "landmarks[3].pixel: not clicked yet" in out
    assert "  4 landmarks in view (T2-peak, T2-leg, barn-roof, pole-top)" in out
    assert "First of all" not in out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ((), "the lens is not calibrated yet"),
        (("--focal", "6"), "--focal needs the sensor"),
        (("--focal", "6", "--sensor", "imx1"), "no such sensor"),
        (("--sensor", "imx296"), "--sensor imx296 says nothing without a lens"),
        ((*LENS, "--grid", "0:60:900,1:2:900,3"), "at most 2000"),
    ],
)
def test_what_is_needed_is_asked_for(words: tuple[str, ...], what: str, span_file: Path, capsys: Capture) -> None:
    code, _, err = plan(capsys, "--config", span_file, *words)
    assert code == 2
    assert what in err
    assert "remedy:" in err


def test_a_sensor_that_is_none_is_refused_beside_a_calibrated_lens(tmp_path: Path, capsys: Capture) -> None:
    document = tables()
    save_intrinsics(tmp_path / "camera.yaml", simple_scene()[0].intrinsics)
    document["camera"]["intrinsics"] = "camera.yaml"
    code, out, err = plan(capsys, "--config", write(tmp_path, document), "--sensor", "nope")
    assert (code, out) == (2, "")
    assert "--sensor nope: no such sensor" in err
    assert all(sensor.name in err for sensor in SENSORS)


@pytest.mark.parametrize(
    "words",
    [("--camera", "1,2"), ("--camera", "1,2,x"), ("--grid", "1,2"), ("--grid", "0:1,2,3"), ("--focal", "0")],
)
def test_words_that_are_no_numbers_are_usage_errors(words: tuple[str, str], span_file: Path, capsys: Capture) -> None:
    code, _, err = plan(capsys, "--config", span_file, *words)
    assert code == 2
    assert "usage: sagnode plan" in err


def test_without_a_place_one_is_asked_for(tmp_path: Path, capsys: Capture) -> None:
    document = tables()
    del document["camera"]
    file = write(tmp_path, document)
    code, _, err = plan(capsys, "--config", file, *LENS)
    assert code == 2
    assert "the camera has no place yet" in err
