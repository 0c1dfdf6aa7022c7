"""Calibration files: every notation gives the same camera, and no fault gets through."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.calibrate import undistort_image
from sagnode.calibrate.files import load_intrinsics, save_intrinsics
from sagnode.errors import ConfigError, FrameError
from sagnode.geometry.camera import Intrinsics, distort
from sagnode.quality import Cause

K = np.array([[1200.5, 0.0, 730.25], [0.0, 1201.75, 540.5], [0.0, 0.0, 1.0]])
D = np.array([[-0.25, 0.08, 0.0005, -0.0003, 0.0]])
CAMERA = Intrinsics(1456, 1088, 1200.5, 1201.75, 730.25, 540.5, tuple(D[0]))

ROS = """\
# written by camera_calibration
image_width: 1456
image_height: 1088
camera_name: tower
camera_matrix:
  rows: 3
  cols: 3
  data: [1200.5, 0, 730.25, 0, 1201.75, 540.5, 0, 0, 1]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: [{data}]
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
"""


def ros(model: str = "plumb_bob", data: str = "-0.25, 0.08, 5e-4, -3e-4, 0.0") -> str:
    return ROS.format(model=model, count=len(data.split(",")), data=data)


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("suffix", ["yaml", "xml", "json"])
@pytest.mark.parametrize(
    "keys",
    [
        ("camera_matrix", "distortion_coefficients", "image_width", "image_height"),
        ("cameraMatrix", "dist_coeffs", "imageWidth", "imageHeight"),
        ("K", "D", "width", "height"),
    ],
)
def test_what_opencv_writes_is_read(tmp_path: Path, suffix: str, keys: tuple[str, str, str, str]) -> None:
    path = tmp_path / f"camera.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in zip(keys, (K, D, 1456, 1088), strict=True):
        storage.write(key, value)
    storage.release()
    assert load_intrinsics(path) == CAMERA


def test_what_ros_writes_is_read(tmp_path: Path) -> None:
    assert load_intrinsics(written(tmp_path / "a.yaml", ros())) == CAMERA
    rational = load_intrinsics(
        written(tmp_path / "b.yaml", ros("rational_polynomial", "0.1, 0.02, 0, 0, 0.001, 0.1, 0.02, 0.001"))
    )
    assert len(rational.distortion) == 8 and rational.model == "pinhole"
    fisheye = load_intrinsics(written(tmp_path / "c.yaml", ros("equidistant", "0.01, -0.002, 0.0003, -0.0001")))
    assert fisheye.model == "fisheye" and fisheye.distortion == (0.01, -0.002, 0.0003, -0.0001)
    message = "height: 1088\nwidth: 1456\ndistortion_model: plumb_bob\nd: [-0.25, 0.08, 5e-4, -3e-4, 0]\n"
    message += "k: [1200.5, 0, 730.25, 0, 1201.75, 540.5, 0, 0, 1]\n"
    assert load_intrinsics(written(tmp_path / "d.yaml", message)) == CAMERA


def test_nested_lists_and_a_size_pair_are_read(tmp_path: Path) -> None:
    document = {"mtx": K.tolist(), "dist": D.tolist(), "image_size": [1456, 1088]}
    assert load_intrinsics(written(tmp_path / "a.json", json.dumps(document))) == CAMERA


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        CAMERA.without_distortion(),
        Intrinsics(640, 480, 600.0, 601.0, 320.0, 240.0, (0.01, -0.002, 0.0003, -0.0001), "fisheye"),
    ],
)
def test_what_is_saved_is_loaded_and_opencv_reads_it_too(tmp_path: Path, camera: Intrinsics) -> None:
    path = tmp_path / "camera.yaml"
    save_intrinsics(path, camera, {"rms_px": 0.12, "note": 'a "new" lens'})
    loaded = load_intrinsics(path)
    assert np.array_equal(loaded.matrix, camera.matrix) and loaded.model == camera.model
    assert [k for k in loaded.distortion if k] == [k for k in camera.distortion if k]
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert np.array_equal(storage.getNode("camera_matrix").mat(), camera.matrix)
    assert storage.getNode("rms_px").real() == 0.12
    assert [p.name for p in tmp_path.iterdir()] == ["camera.yaml"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("image_width: 1456\n", ""), "image_width, image_height: missing"),
        (("image_width: 1456", "image_width: wide"), "image_width: 'wide' is not a picture size"),
        (("camera_matrix", "camera_matricks"), "camera_matrix: missing"),
        (("1200.5, 0", ".nan, 0"), "camera_matrix: holds a number that is not finite"),
        (("1200.5, 0", "-1200.5, 0"), "camera_matrix: focal lengths -1200.5, 1201.75 must be positive"),
        (("1200.5, 0, 730.25", "1200.5, 0, 7302.5"), "camera_matrix: principal point 7302.5, 540.5 lies far outside"),
        (("1200.5, 0,", "1200.5, 3.5,"), "camera_matrix: is not of the form"),
        (("1200.5, 0,", "1200.5,"), "camera_matrix: rows 3 and cols 3 do not fit its 8 numbers"),
        (("1200.5, 0,", "abc, 0,"), "camera_matrix: is not a list of numbers"),
        (("plumb_bob", "magic"), "distortion_model: unknown model 'magic'"),
        (("distortion_coefficients", "coefficients"), "distortion_coefficients: missing"),
        (("-0.25, 0.08", "-0.25, .inf"), "distortion_coefficients: holds a number that is not finite"),
        (("plumb_bob", "equidistant"), "distortion_coefficients: has 5 coefficients; the fisheye model takes 4"),
        (("-0.25, 0.08", "-2.5, 0.08"), "distortion_coefficients: fold the picture's edge"),
    ],
)
def test_every_fault_is_named_with_file_and_key(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    assert change[0] in ros()
    path = written(tmp_path / "camera.yaml", ros().replace(*change))
    with pytest.raises(ConfigError) as caught:
        load_intrinsics(path)
    assert str(path) in caught.value.what and says in caught.value.what
    assert "sagnode calibrate" in caught.value.remedy


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    text = ros("magic").replace("1200.5", "-1").replace("image_width", "breadth")
    with pytest.raises(ConfigError) as caught:
        load_intrinsics(written(tmp_path / "camera.yaml", text))
    assert len(caught.value.faults) == 3


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"\xff\xd8\xff\xe0", "is not a text file"),
        (b"just words", "holds no keys"),
        (b"a: [1, 2\nb: 3", "is not valid YAML in line 2"),
        (b"{not json", "is not valid JSON"),
        (b"<opencv_storage><a>", "is not valid XML"),
        (b'<!DOCTYPE x [<!ENTITY a "b">]><x/>', "holds a document type"),
        (b"a: !!python/object/apply:os.system ['true']", "is not valid YAML"),
        (b"# " + b"x" * 1_100_000, "no calibration file"),
    ],
)
def test_what_is_no_calibration_file_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=says) as caught:
        load_intrinsics(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_and_a_directory_are_named(tmp_path: Path) -> None:
    for path, says in [(tmp_path / "none.yaml", "no such file"), (tmp_path, "cannot be read")]:
        with pytest.raises(ConfigError, match=says):
            load_intrinsics(path)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_mutated_files_give_a_camera_or_a_refusal(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    text = list(ros())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text) - 1))
        text[at] = data.draw(st.sampled_from(list("0123456789.-e[]{},:\n &*!'\"%#<")))
    path = written(tmp_path_factory.getbasetemp() / "mutated.yaml", "".join(text))
    try:
        camera = load_intrinsics(path)
    except ConfigError as error:
        assert str(path) in str(error)
    else:
        assert camera.fx > 0 and np.isfinite(camera.matrix).all()


def test_undistorting_puts_every_pixel_where_a_perfect_lens_would() -> None:
    camera = Intrinsics(160, 120, 150.0, 151.0, 81.0, 58.5, (-0.2, 0.05, 0.001, -0.0005, 0.0))
    u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))

    def world(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 128 + 60 * np.sin(9 * x) + 50 * np.cos(7 * y)

    from sagnode.geometry.camera import undistort

    seen = np.round(world(*undistort(camera, u, v))).astype(np.uint8)
    straight = undistort_image(camera, seen)
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    du, dv = distort(camera, x, y)
    inside = (np.abs(du * camera.fx + camera.cx - 79.5) < 78) & (np.abs(dv * camera.fy + camera.cy - 59.5) < 58)
    assert inside.mean() > 0.8
    assert float(np.abs(straight[inside] - world(x, y)[inside]).max()) < 2.0
    assert undistort_image(camera.without_distortion(), seen) is seen
    with pytest.raises(FrameError, match="160x120") as caught:
        undistort_image(camera, seen[:-1])
    assert caught.value.cause is Cause.BAD_FRAME


_NESTED = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 11)
)


@pytest.mark.parametrize(
    "text",
    [
        _NESTED + ros().replace("[1200.5, 0, 730.25, 0, 1201.75, 540.5, 0, 0, 1]", "*a10"),
        _NESTED + ros().replace("data: [-0.25, 0.08, 5e-4, -3e-4, 0.0]", "data: *a10"),
        _NESTED + ros().replace("rows: 3\n  cols: 3", "rows: *a10\n  cols: *a10"),
        _NESTED + ros().replace("image_width: 1456", "image_width: *a10"),
        _NESTED + ros("*a10"),
        "within: &within [*within]\n" + ros().replace("[1200.5, 0, 730.25, 0, 1201.75, 540.5, 0, 0, 1]", "*within"),
        ros() + "deep: " + "[" * 50_000,
    ],
)
def test_a_few_lines_that_stand_for_thousands_of_millions_of_numbers_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_intrinsics(written(tmp_path / "bomb.yaml", text))
    assert len(str(refused.value)) < 1000
