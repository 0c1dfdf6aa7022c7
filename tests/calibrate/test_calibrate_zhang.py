"""``sagnode calibrate`` recovers a camera from rendered pictures of a board, and says when it cannot."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from sagnode.calibrate.files import load_intrinsics
from sagnode.cli.main import main
from sagnode.geometry.camera import Intrinsics, rotation_from_vector, undistort

TRUE = Intrinsics(480, 360, 420.0, 421.5, 243.0, 176.0, (-0.22, 0.06, 0.0008, -0.0005))
COLUMNS, ROWS, SQUARE = 9, 6, 0.025
OVERSAMPLING = 4


@pytest.fixture(scope="module")
def rays() -> tuple[np.ndarray, np.ndarray]:
    """Undistorted directions of every sub-pixel of the camera."""
    offset = (np.arange(OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    u = (np.arange(TRUE.width)[:, None] + offset).reshape(-1)
    v = (np.arange(TRUE.height)[:, None] + offset).reshape(-1)
    return undistort(TRUE, *np.meshgrid(u, v))


def render(rays: tuple[np.ndarray, np.ndarray], turn: np.ndarray, centre: np.ndarray, seed: int) -> np.ndarray:
    """The board's picture: each sub-pixel's ray is met with the board's plane, then averaged; noise of 1.5 levels."""
    rotation = rotation_from_vector(turn)
    middle = np.array([(COLUMNS - 1) * SQUARE / 2, (ROWS - 1) * SQUARE / 2, 0.0])
    origin = centre - rotation @ middle
    normal = rotation[:, 2]
    depth = (normal @ origin) / (normal[0] * rays[0] + normal[1] * rays[1] + normal[2])
    points = np.stack([rays[0] * depth, rays[1] * depth, depth], axis=-1) - origin
    x, y = points @ rotation[:, 0] / SQUARE, points @ rotation[:, 1] / SQUARE
    on_squares = (x > -1) & (x < COLUMNS) & (y > -1) & (y < ROWS)
    dark = on_squares & ((np.floor(x) + np.floor(y)) % 2 == 0)
    fine = np.where(dark, 40.0, 200.0)
    shape = (TRUE.height, OVERSAMPLING, TRUE.width, OVERSAMPLING)
    noise = np.random.default_rng(seed).normal(0, 1.5, (TRUE.height, TRUE.width))
    return np.clip(fine.reshape(shape).mean(axis=(1, 3)) + noise, 0, 255).round().astype(np.uint8)


@pytest.fixture(scope="module")
def pictures(rays: tuple[np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("board")
    tilts = [(0.5, 0.1), (-0.5, 0.0), (0.1, 0.55), (0.0, -0.55), (0.4, 0.4), (-0.4, 0.35), (0.35, -0.4), (-0.3, -0.4)]
    places = [(-0.05, -0.05), (0.07, -0.06), (-0.07, 0.06), (0.07, 0.06), (0.0, 0.0), (0.03, 0.02)]
    files = []
    for i in range(12):
        tilt, place = tilts[i % 8], places[i % 6]
        turn = np.array([*tilt, 0.15 * (i % 3 - 1)])
        image = render(rays, turn, np.array([*place, 0.34 + 0.02 * (i % 4)]), i)
        files.append(folder / f"board{i:02d}.png")
        cv2.imwrite(str(files[-1]), image)
    return files


def words(pictures: list[Path], *more: str) -> list[str]:
    return ["calibrate", *map(str, pictures), "--board", f"{COLUMNS}x{ROWS}", "--square", str(SQUARE), *more]


def test_a_known_camera_is_recovered_within_its_stated_uncertainty(
    pictures: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "camera.yaml"
    code = main(words(pictures, "--out", str(out), "--json"))
    result = json.loads(capsys.readouterr().out)
    assert code == 0 and result["verdict"] == "good", result["reservations"]
    assert len(result["views"]) >= 10 and result["rms_px"] < 0.1
    assert result["held_out_rms_px"] < 2 * result["rms_px"]
    found = dict(zip(("k1", "k2", "p1", "p2"), result["distortion"], strict=False)) | {
        key: result[key] for key in ("fx", "fy", "cx", "cy")
    }
    true = {"fx": TRUE.fx, "fy": TRUE.fy, "cx": TRUE.cx, "cy": TRUE.cy}
    true |= dict(zip(("k1", "k2", "p1", "p2"), TRUE.distortion, strict=True))
    for name, value in true.items():
        assert abs(found[name] - value) < 3 * result["uncertainty"][name], name
    assert result["uncertainty"]["fx"] < 0.002 * TRUE.fx
    loaded = load_intrinsics(out)
    assert (loaded.fx, loaded.width) == (result["fx"], TRUE.width)


def test_a_view_that_does_not_belong_is_left_out_and_named(
    pictures: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bent = tmp_path / "bent.png"
    image = cv2.imread(str(pictures[3]), cv2.IMREAD_GRAYSCALE)
    v, u = np.mgrid[0:360, 0:480].astype(np.float32)
    cv2.imwrite(str(bent), cv2.remap(image, u + 4 * np.sin(v / 40), v + 3 * np.sin(u / 50), cv2.INTER_LINEAR))
    empty = tmp_path / "sky.png"
    cv2.imwrite(str(empty), np.full((360, 480), 128, np.uint8))
    cut = tmp_path / "cut.png"
    cut.write_bytes(pictures[0].read_bytes()[:2000])
    code = main(words([*pictures, bent, empty, cut]))
    said = capsys.readouterr().out
    assert code == 0, said
    assert f"left out   {bent}: reprojection error" in said
    assert f"left out   {empty}: no board of 9x6 inner corners" in said
    assert f"left out   {cut}: picture {cut} is cut off" in said
    assert "verdict: good" in said and "± " in said


def test_few_views_are_said_to_be_few(pictures: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(pictures[:5])) == 1
    assert "views: take at least 10" in capsys.readouterr().out
    assert main(words(pictures[:2])) == 1
    said = capsys.readouterr()
    assert "2 usable views; at least 4 are needed" in said.err and said.out == ""


@pytest.mark.parametrize(
    ("board", "square", "says"), [("9", "0.025", "--board 9"), ("9x6", "0", "--square 0"), ("9x2", "1", "--board 9x2")]
)
def test_a_board_that_means_nothing_is_refused(
    pictures: list[Path], board: str, square: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", str(pictures[0]), "--board", board, "--square", square]) == 2
    assert says in capsys.readouterr().err


def test_pictures_of_two_sizes_are_two_cameras(
    pictures: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), np.full((100, 100), 9, np.uint8))
    assert main(words([pictures[0], other])) == 2
    assert "100x100 px, the ones before it 480x360" in capsys.readouterr().err
