"""``sagnode measure``: the daemon's code on pictures; a bad picture is an invalid reading and the next one goes on."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sagnode.cli.main import main
from sagnode.message import QUANTITIES, Estimate
from sagnode.quality import Cause

Capture = pytest.CaptureFixture[str]


def measure(lab: Path, capsys: Capture, *words: str | Path) -> tuple[int, list[dict[str, Any]]]:
    capsys.readouterr()
    code = main(["measure", "--config", str(lab), "--json", *map(str, words)])
    document = json.loads(capsys.readouterr().out)
    assert document["schema_version"] == "sagnode.measure/1"
    return code, document["readings"]


def frames(lab: Path) -> list[Path]:
    return sorted((lab / "frames").glob("*.png"))


def test_readings_hold_the_truth(lab: Path, capsys: Capture) -> None:
    code, readings = measure(lab, capsys, *frames(lab))
    assert code == 0
    assert len(readings) == 6
    for reading in readings:
        truth = json.loads(Path(reading["images"][0]).with_suffix(".json").read_text())["conductors"]
        true = truth[reading["conductor"]]
        assert reading["quality"]["validity"] == "good"
        assert reading["sag_m"] == pytest.approx(true["sag_m"], rel=0.02)
        assert reading["clearance_lo"] <= true["clearance_m"] <= reading["clearance_hi"]
        assert reading["clearance_hi"] - reading["clearance_lo"] < 0.01
        (x0, y0), _, (x2, y2) = reading["curve"]["control_points"]
        w0, w1, w2 = reading["curve"]["weights"]
        (x1, y1) = reading["curve"]["control_points"][1]
        total = w0 + 2 * w1 + w2
        middle = ((w0 * x0 + 2 * w1 * x1 + w2 * x2) / total, (w0 * y0 + 2 * w1 * y1 + w2 * y2) / total)
        # the middle of the curve lies on the true one, but for a slight distortion and the catenary's departure
        assert min(abs(middle[1] - v) for u, v in true["pixels"] if abs(u - middle[0]) < 30) < 4.0


def test_a_reading_has_every_field_of_the_message_that_a_picture_can_have(lab: Path, capsys: Capture) -> None:
    from sagnode.message import Reading

    _, readings = measure(lab, capsys, frames(lab)[0], "--budget")
    daemons = {"schema_version", "utility", "line", "span", "unit", "sequence", "acquired_at", "published_at"}
    daemons |= {"clock_synced", "boot_id", "monotonic_s", "backfill"}
    assert set(readings[0]) == (set(Reading.model_fields) - daemons) | {"images", "overlay", "curve", "budget"}
    sag = Estimate(*(readings[0][f"sag_{part}"] for part in ("m", "u", "lo", "hi")))
    parts = readings[0]["budget"]["sag"].values()
    assert np.sqrt(sum(part**2 for part in parts)) == pytest.approx(sag.u, rel=0.35)


def test_the_budget_for_people_holds_what_counts_and_json_holds_all(lab: Path, capsys: Capture) -> None:
    _, (reading, _) = measure(lab, capsys, frames(lab)[0], "--budget")
    assert main(["measure", "--config", str(lab), str(frames(lab)[0]), "--budget"]) == 0
    (line, *_) = [said for said in capsys.readouterr().out.splitlines() if "u(sag) by source, mm: " in said]
    told = {part.rpartition(" ")[0]: float(part.rpartition(" ")[2]) for part in line.partition("mm: ")[2].split(", ")}
    parts = {name: 1000 * u for name, u in reading["budget"]["sag"].items()}
    greatest = max(parts.values())
    assert set(told) == {name for name, u in parts.items() if u > 0.02 * greatest} < set(parts)
    assert list(told.values()) == sorted(told.values(), reverse=True)
    for name, u in told.items():
        assert u == pytest.approx(parts[name], rel=0.01, abs=0.006), name


def test_a_refused_reading_has_no_budget(lab: Path, capsys: Capture) -> None:
    (empty,) = (lab / "empty").glob("*.png")
    _, readings = measure(lab, capsys, empty, "--budget")
    assert [(reading["quality"]["validity"], reading["budget"]) for reading in readings] == [("invalid", {})] * 2
    main(["measure", "--config", str(lab), str(empty), "--budget"])
    assert "by source" not in capsys.readouterr().out


def test_every_source_of_uncertainty_is_explained_to_the_user(lab: Path, capsys: Capture) -> None:
    from sagnode.estimate.joint import SOURCES

    _, readings = measure(lab, capsys, frames(lab)[0], "--budget")
    seen = {name for reading in readings for parts in reading["budget"].values() for name in parts}
    assert set(SOURCES) <= seen
    seen |= {"load not excluded", "which load", "even or uneven load", "blocks that may be texture"}
    page = (Path(__file__).parents[2] / "docs" / "operations.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    explained = {name for row in rows for name in row.split("`")[1::2]}
    assert seen <= explained, seen - explained


def test_bad_pictures_are_invalid_with_their_reason_and_the_good_one_is_measured(
    lab: Path, tmp_path: Path, capsys: Capture
) -> None:
    good = frames(lab)[0]
    (tmp_path / "cut.png").write_bytes(good.read_bytes()[:5000])
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "void.png").write_bytes(b"")
    cv2.imwrite(str(tmp_path / "small.png"), np.full((270, 480), 120, np.uint8))
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((540, 960), np.uint8))
    bad = [tmp_path / name for name in ("gone.png", "cut.png", "text.png", "void.png", "small.png", "black.png")]
    code, readings = measure(lab, capsys, *bad, good)
    assert code == 1
    by_picture = {Path(reading["images"][0]).name: reading for reading in readings}
    for path in bad:
        reading = by_picture[path.name]
        assert reading["quality"]["validity"] == "invalid"
        assert reading["quality"]["reasons"][0]["text"]
        for quantity in QUANTITIES:
            assert [reading[name] for name in quantity.fields] == [None] * 4
    assert by_picture["gone.png"]["quality"]["reasons"][0]["cause"] == Cause.BAD_FRAME
    assert by_picture["black.png"]["quality"]["reasons"][0]["cause"] == Cause.DARK
    assert by_picture[good.name]["quality"]["validity"] == "good"


def test_no_wire_in_the_picture_is_no_number(lab: Path, capsys: Capture) -> None:
    code, readings = measure(lab, capsys, *(lab / "empty").glob("*.png"))
    assert code == 1
    assert [(r["quality"]["validity"], r["sag_m"]) for r in readings] == [("invalid", None)] * 2
    assert {r["quality"]["detail_qual"][0] for r in readings} == {"failure"}


def test_a_burst_is_one_reading_and_a_bad_frame_in_it_is_said(lab: Path, tmp_path: Path, capsys: Capture) -> None:
    first = frames(lab)[0]
    code = main(["measure", "--config", str(lab), "--json", "--burst", str(first), str(first), str(tmp_path / "x.png")])
    said = capsys.readouterr()
    readings = json.loads(said.out)["readings"]
    assert code == 0
    assert len(readings) == 2
    assert readings[0]["frames_used"] == 2
    assert readings[0]["frames_rejected"] == 1
    assert "left out of the burst" in said.err
    assert f"{tmp_path}/x.png does not exist" in said.err


def test_the_table_for_people(lab: Path, tmp_path: Path, capsys: Capture) -> None:
    capsys.readouterr()
    assert main(["measure", "--config", str(lab), str(frames(lab)[0]), str(tmp_path / "gone.png")]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == str(frames(lab)[0])
    assert lines[1].split() == ["conductor", "sag", "(95", "%)", "clearance", "(95", "%)", "quality"]
    assert lines[2].startswith("  right      0.09")
    assert " m at 1.3" in lines[2]
    assert lines[2].endswith(" good")
    assert lines[5].split() == ["conductor", "sag", "(95", "%)", "clearance", "(95", "%)", "quality"]
    assert lines[6].split() == ["right", "-", "-", "invalid"]
    assert lines[7] == f"      bad-frame (failure): picture {tmp_path}/gone.png does not exist; check the path"


def test_overlays_are_drawn_and_equal_names_do_not_collide(lab: Path, tmp_path: Path, capsys: Capture) -> None:
    first = frames(lab)[0]
    other = tmp_path / "other" / first.name
    other.parent.mkdir()
    shutil.copy(first, other)
    code, readings = measure(lab, capsys, first, other, tmp_path / "gone.png", "--overlay", tmp_path / "drawn")
    assert code == 1
    drawn = [reading["overlay"] for reading in readings[::2]]
    expected = [tmp_path / "drawn" / f"{first.stem}{tail}-overlay.png" for tail in ("", "-2")]
    assert drawn == [*map(str, expected), None]
    picture = cv2.imread(drawn[0])
    assert picture is not None
    assert picture.shape == (540, 960, 3)
    assert (picture[..., 1].astype(int) - picture[..., 0] > 60).any()  # a coloured curve on the grey picture


def test_the_overlay_tells_a_model_in_as_many_digits_as_the_terminal(
    lab: Path, tmp_path: Path, capsys: Capture, written: list[Any]
) -> None:
    _, readings = measure(lab, capsys, frames(lab)[0], "--overlay", tmp_path / "drawn")
    texts = [word.text for word in written]
    for r in readings:
        sag = f"sag {r['sag_m']:.4f} [{r['sag_lo']:.4f} {r['sag_hi']:.4f}] m"
        (line,) = [text for text in texts if text.startswith(f"{r['conductor']}: ")]
        assert line.startswith(f"{r['conductor']}: {sag}  clearance {r['clearance_m']:.4f} [")
        assert line.endswith(f" at {r['clearance_along_m']:.2f} m  good")
        assert f"{r['conductor']} {r['clearance_m']:.4f} m" in texts


def test_words_of_the_overlay_cover_neither_each_other_nor_a_landmark(
    lab: Path, tmp_path: Path, capsys: Capture, written: list[Any]
) -> None:
    """Both wires of the laboratory are labelled at mid-span, where a landmark stands as well."""
    from sagnode.config.load import load_any

    measure(lab, capsys, frames(lab)[0], "--overlay", tmp_path / "drawn")
    labels = [word for word in written if word.text.endswith(" m")]
    assert len(labels) == 2
    assert not labels[0].covers(*labels[1][1:])
    for landmark in load_any(lab).span.landmarks:
        u, v = map(round, landmark.pixel)
        assert not any(label.covers(u - 10, v - 10, u + 10, v + 10) for label in labels), landmark.id


def test_distortion_can_be_left_out_and_matters(lab: Path, capsys: Capture) -> None:
    _, (with_it, *_) = measure(lab, capsys, frames(lab)[0])
    _, (without, *_) = measure(lab, capsys, frames(lab)[0], "--no-undistort")
    assert with_it["sag_m"] != without["sag_m"]


def test_the_papers_method_can_be_chosen(lab: Path, capsys: Capture) -> None:
    _, readings = measure(lab, capsys, frames(lab)[0], "--method", "paper-bezier")
    assert {reading["method"] for reading in readings} == {"paper-bezier"}


def test_a_span_file_alone_is_enough(lab: Path, capsys: Capture) -> None:
    code, readings = measure(lab / "span.toml", capsys, frames(lab)[0])
    assert (code, len(readings)) == (0, 2)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["x.png"], "the following arguments are required: --config"),
        (["--config", "nowhere"], "the following arguments are required: IMAGE"),
        (["x.png", "--config", "/nowhere"], "file not found: /nowhere"),
        (["x.png", "--config", "c", "--method", "guess"], "invalid choice: 'guess'"),
    ],
)
def test_usage_and_configuration_errors_are_code_2(words: list[str], text: str, capsys: Capture) -> None:
    assert main(["measure", *words]) == 2
    assert text in capsys.readouterr().err


def test_an_overlay_that_cannot_be_written_is_said(lab: Path, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "file").write_text("")
    words = ["measure", "--config", str(lab), str(frames(lab)[0]), "--overlay", str(tmp_path / "file")]
    assert main(words) == 1
    assert "cannot write" in capsys.readouterr().err
