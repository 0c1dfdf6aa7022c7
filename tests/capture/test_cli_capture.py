"""``sagnode capture`` writes what the configured camera sees, under its time."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from sagnode.capture.images import read_grey
from sagnode.capture.taken import taken_at
from sagnode.cli.main import main

NODE = """\
span_file = "span.toml"

[unit]
utility = "U"
line = "L"
span = "1-2"
unit = "n1"

[camera]
backend = "replay"
replay = { path = "frames", cadence_s = 0.5, start = "2026-06-21T12:00:00Z" }

[schedule]
interval_s = 60
"""
SPAN = """\
name = "1-2"

[[conductors]]
id = "A"
near = [0.0, 0.0, 20.0]
far = [0.0, 200.0, 20.0]
diameter_m = 0.02
sag_min_m = 1.0
sag_max_m = 10.0

[ground]
profile = [[0.0, 0.0], [200.0, 0.0]]

[camera]
position = [3.0, 0.0, 15.0]
azimuth_deg = 0
elevation_deg = 0
intrinsics = "camera.yaml"
"""


@pytest.fixture
def node(tmp_path: Path) -> Path:
    (tmp_path / "frames").mkdir()
    for i in range(3):
        cv2.imwrite(str(tmp_path / "frames" / f"{i}.png"), np.full((24, 32), 40 + i, np.uint8))
    (tmp_path / "span.toml").write_text(SPAN)
    (tmp_path / "camera.yaml").write_text(
        "image_width: 32\nimage_height: 24\ncamera_matrix: [[30, 0, 16], [0, 30, 12], [0, 0, 1]]\nD: [0, 0, 0, 0, 0]\n"
    )
    path = tmp_path / "node.toml"
    path.write_text(NODE)
    return path


def test_pictures_stand_under_their_time_with_their_metadata(
    node: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "pictures"
    assert main(["capture", "--config", str(node), "--out", str(out), "--count", "2"]) == 0
    files = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert [f.name for f in files] == ["20260621T120000.000000Z.png", "20260621T120000.500000Z.png"]
    assert int(read_grey(files[1])[0, 0]) == 41
    metadata = json.loads(files[1].with_suffix(".json").read_text())
    assert metadata["utc"] == taken_at(files[1])[0].isoformat() == "2026-06-21T12:00:00.500000+00:00"
    assert (metadata["width"], metadata["height"]) == (32, 24)
    assert sorted(p.suffix for p in out.iterdir()) == [".json", ".json", ".png", ".png"]


def test_the_end_of_the_frames_is_told(node: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "--config", str(node), "--out", str(tmp_path / "o"), "--count", "9", "--json"]) == 1
    said = capsys.readouterr()
    assert len([json.loads(line) for line in said.out.splitlines()]) == 3
    assert "3 of 9 pictures" in said.err and "Traceback" not in said.err


def test_what_cannot_be_opened_or_written_is_named(
    node: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["capture", "--config", str(node), "--out", str(tmp_path / "file")]) == 2
    assert "--out" in capsys.readouterr().err
    for file in (tmp_path / "frames").iterdir():
        file.unlink()
    assert main(["capture", "--config", str(node), "--out", str(tmp_path / "o")]) == 1
    assert "no pictures" in capsys.readouterr().err


def test_the_boards_pictures_can_be_taken_before_there_is_a_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What 'config init' writes, with a camera put into it: neither lens file nor reference picture is there."""
    site = tmp_path / "my-span"
    assert main(["config", "init", "--out", str(site)]) == 0
    (site / "boards-seen").mkdir()
    for i in range(3):
        cv2.imwrite(str(site / "boards-seen" / f"{i}.png"), np.full((24, 32), 40 + i, np.uint8))
    node = site / "node.toml"
    text = node.read_text().replace('backend = "picamera2"', 'backend = "replay"\nreplay = { path = "boards-seen" }')
    node.write_text(text)
    (site / "span.toml").unlink()
    capsys.readouterr()
    out = tmp_path / "boards"
    assert main(["capture", "--config", str(site), "--out", str(out), "--count", "3"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(list(out.glob("*.png"))) == 3


def test_a_fault_of_the_camera_alone_stops_it(node: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--out", str(tmp_path / "o")]
    node.write_text(NODE.replace("interval_s = 60", "interval_s = -1").replace('unit = "n1"', ""))
    assert main(["capture", "--config", str(node), *words]) == 0
    node.write_text(NODE.replace('backend = "replay"', 'backend = "replya"'))
    assert main(["capture", "--config", str(node), *words]) == 2
    assert f"{node}:10: camera.backend" in capsys.readouterr().err
    node.write_text(NODE.replace("[camera]", "[cmaera]"))
    assert main(["capture", "--config", str(node), *words]) == 2
    assert "camera: is missing" in capsys.readouterr().err
    assert main(["capture", "--config", str(tmp_path / "span.toml"), *words]) == 2
    assert "is a span file" in capsys.readouterr().err
