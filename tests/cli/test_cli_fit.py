"""``sagnode fit``: one curve between two points of a photograph, or a refusal with its reason."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sagnode.cli.main import main

Capture = pytest.CaptureFixture[str]
WIDTH, HEIGHT = 960, 600
START, END = (40.0, 120.0), (900.0, 160.0)


def wire() -> np.ndarray:
    """A parabola between START and END, 200 px deep, sampled finely (N, 2)."""
    t = np.linspace(0, 1, 2001)[:, None]
    middle = (np.array(START) + END) / 2 + (0, 400.0)
    return np.asarray((1 - t) ** 2 * np.array(START) + 2 * t * (1 - t) * middle + t**2 * np.array(END))


def picture(path: Path, *, drawn: bool = True) -> Path:
    """A sky with noise and, if asked for, a dark wire 2 px thick."""
    rng = np.random.default_rng(1)
    image = np.tile(np.linspace(190, 160, HEIGHT)[:, None], (1, WIDTH)).astype(np.uint8)
    if drawn:
        points = np.round(wire() * 16).astype(np.int32)
        cv2.polylines(image, [points], False, 60, 2, cv2.LINE_AA, 4)
    noisy = image.astype(float) + rng.normal(0, 3, image.shape)
    cv2.imwrite(str(path), np.clip(noisy, 0, 255).astype(np.uint8))
    return path


def fit(capsys: Capture, path: Path, start: str, end: str, *words: str) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = main(["fit", str(path), "--from", start, "--to", end, "--json", *words])
    return code, json.loads(capsys.readouterr().out)


def test_a_wire_is_traced_to_its_pixels(tmp_path: Path, capsys: Capture) -> None:
    code, found = fit(capsys, picture(tmp_path / "a.png"), "40,120", "900,160")
    assert code == 0
    assert found["schema_version"] == "sagnode.fit/1"
    assert (found["found"], found["refusal"], found["kind"]) == (True, None, "rational-quadratic-bezier")
    assert (found["from"], found["to"]) == ([40.0, 120.0], [900.0, 160.0])
    points = np.array(found["points"])
    assert len(points) >= 50
    assert len(found["confidence"]) == len(points)
    assert all(0 <= c <= 1 for c in found["confidence"])
    distance = np.min(np.linalg.norm(points[:, None] - wire()[None], axis=-1), axis=1)
    assert np.median(distance) < 0.5
    assert distance.max() < 2.0
    assert found["score"] > 0
    assert len(found["control_points"]) == len(found["weights"])


def test_a_sky_without_wire_is_refused_with_a_reason(tmp_path: Path, capsys: Capture) -> None:
    code, found = fit(capsys, picture(tmp_path / "a.png", drawn=False), "40,120", "900,160")
    assert code == 1
    assert found["found"] is False
    assert found["points"] == found["control_points"] == found["weights"] == found["confidence"] == []
    assert set(found["refusal"]) == {"cause", "detail_qual", "text"}
    assert found["refusal"]["text"]


def test_the_overlay_is_drawn(tmp_path: Path, capsys: Capture, written: list[Any]) -> None:
    overlay = tmp_path / "deep" / "o.png"
    code, _ = fit(capsys, picture(tmp_path / "a.png"), "40,120", "900,160", "--overlay", str(overlay))
    assert code == 0
    drawn = cv2.imread(str(overlay))
    rows = [word for word in written if word.text]
    assert [word.text.split(",")[0].split(";")[0] for word in rows] == [
        "visible 100%",
        "the wire is between the two lines",
    ]
    assert not rows[0].covers(*rows[1][1:])
    assert all(word.bottom - word.top >= 9 and word.right < drawn.shape[1] for word in rows)
    assert drawn is not None
    assert drawn.shape == (HEIGHT, WIDTH, 3)
    assert np.ptp(drawn.astype(int), axis=2).max() > 50


def test_lines_for_people(tmp_path: Path, capsys: Capture) -> None:
    path = picture(tmp_path / "a.png")
    assert main(["fit", str(path), "--from", "40,120", "--to", "900,160"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{path}: found, score ")
    assert [line.split()[0] for line in lines[1:4]] == ["control", "weights", "lowest"]
    assert main(["fit", str(picture(tmp_path / "b.png", drawn=False)), "--from", "40,120", "--to", "900,160"]) == 1
    assert capsys.readouterr().out.startswith(f"{tmp_path}/b.png: no conductor was found")


def test_a_point_may_lie_outside_the_picture_but_not_far(tmp_path: Path, capsys: Capture) -> None:
    path = picture(tmp_path / "a.png")
    # the same parabola, begun a little to the left of the picture
    t = -0.1
    middle = (np.array(START) + END) / 2 + (0, 400.0)
    u, v = (1 - t) ** 2 * np.array(START) + 2 * t * (1 - t) * middle + t**2 * np.array(END)
    assert u < 0
    code, found = fit(capsys, path, f"{u:.1f},{v:.1f}", "900,160")
    assert found["from"] == [round(u, 1), round(v, 1)]
    assert code in {0, 1}  # the left half of it is sky without wire: found or refused, but understood
    assert main(["fit", str(path), "--from=-5000,20", "--to", "900,160"]) == 2
    said = capsys.readouterr().err
    assert "--from -5000,20 lies too far outside" in said
    assert "u from -960 to 1920" in said


@pytest.mark.parametrize(
    ("start", "text"),
    [
        ("here", "'here' is not two numbers"),
        ("1", "'1' is not two numbers"),
        ("1,2,3", "'1,2,3' is not two numbers"),
        ("1,nan", "'1,nan' is not two finite numbers"),
        ("900,160", "--from and --to are the same point"),
    ],
)
def test_points_that_are_none(tmp_path: Path, start: str, text: str, capsys: Capture) -> None:
    assert main(["fit", str(picture(tmp_path / "a.png")), "--from", start, "--to", "900,160"]) == 2
    assert text in capsys.readouterr().err


def test_pictures_that_are_none(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "text.png").write_text("no picture")
    for name, text in (("gone.png", "does not exist"), ("text.png", "is not")):
        assert main(["fit", str(tmp_path / name), "--from", "1,2", "--to", "3,4"]) == 2
        assert text in capsys.readouterr().err
