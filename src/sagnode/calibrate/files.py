"""Calibration files: intrinsics from OpenCV's FileStorage (YAML, XML, JSON) and ROS camera_info YAML.

Keys are compared without case and underscores, and the names that common calibration programs use are all known:
``camera_matrix``/``cameraMatrix``/``K``/``mtx``, ``distortion_coefficients``/``dist_coeffs``/``D``/``dist`` and so on.
What a wrong file could do (a plausible but false clearance) is worse than a refusal, so everything is checked here.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sagnode.calibrate.documents import MAX_BYTES, NotReadableError, parse_document
from sagnode.calibrate.keys import CALIBRATE, Keys
from sagnode.errors import ConfigError
from sagnode.geometry.camera import Intrinsics, distort, undistort

GOOD_RMS_PX = 0.5
"""Reprojection errors beyond it are those of blurred pictures, of a board that is not flat, or of another lens."""


def load_intrinsics(path: Path | str) -> Intrinsics:
    """Read and check a calibration file.

    Returns:
        Intrinsics with trailing zero coefficients as they stand in the file.

    Raises:
        ConfigError: the file is missing or unreadable, a key is missing or misshapen, a number is not finite, a focal
            length is not positive, the principal point lies far outside the frame, the distortion model is unknown, or
            the distortion folds the frame's edge back on itself; ``faults`` names each with file and key.
    """
    path = Path(path)
    found = Keys(path, _read(path))
    width, height = found.size()
    fx, fy, cx, cy = found.matrix()
    model, distortion = found.lens()
    found.raise_faults()
    if not (-0.5 * width <= cx <= 1.5 * width and -0.5 * height <= cy <= 1.5 * height):
        found.fault("camera_matrix", f"principal point {cx:.6g}, {cy:.6g} lies far outside {width}x{height} px")
    found.raise_faults()
    with np.errstate(all="ignore"):  # coefficients that overflow are found, and told, as any that fold
        intrinsics = Intrinsics(width, height, fx, fy, cx, cy, distortion, model)
        _check_invertible(found, intrinsics)
    found.raise_faults()
    return intrinsics


def stated_error(path: Path | str) -> tuple[str, float] | None:
    """The reprojection error that a calibration file says it was made with: its key and px; None where it says none.

    Raises:
        ConfigError: the file is missing or unreadable.
    """
    path = Path(path)
    return Keys(path, _read(path)).error()


def save_intrinsics(path: Path | str, intrinsics: Intrinsics, notes: Mapping[str, float | str] | None = None) -> None:
    """Write OpenCV FileStorage YAML, all at once; ``notes`` become further keys (errors, date, camera).

    Raises:
        ConfigError: the file cannot be written.
    """
    path = Path(path)
    # k1 and k2 alone are a model too, but no file format's: trailing zeros change nothing
    length = 4 if intrinsics.model == "fisheye" else 5 if len(intrinsics.distortion) <= 5 else 8
    distortion = (*intrinsics.distortion, *(0.0,) * length)[:length]
    lines = [
        "%YAML:1.0",
        "---",
        *(f"{key}: {_scalar(value)}" for key, value in (notes or {}).items()),
        f"image_width: {intrinsics.width}",
        f"image_height: {intrinsics.height}",
        *_matrix_lines("camera_matrix", intrinsics.matrix.tolist()),
        f"distortion_model: {'fisheye' if intrinsics.model == 'fisheye' else 'pinhole'}",
        *_matrix_lines("distortion_coefficients", [list(distortion)]),
        "",
    ]
    part = path.with_name(path.name + ".part")
    try:
        part.write_text("\n".join(lines), encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}", "check the directory and its rights") from None


def _scalar(value: float | str) -> str:
    return '"' + value.replace("\\", "/").replace('"', "'") + '"' if isinstance(value, str) else repr(value)


def _matrix_lines(key: str, rows: list[list[float]]) -> list[str]:
    data = ", ".join(repr(float(x)) for row in rows for x in row)
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {len(rows)}",
        f"   cols: {len(rows[0])}",
        "   dt: d",
        f"   data: [ {data} ]",
    ]


def _read(path: Path) -> dict[str, object]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"intrinsics {path}: has {path.stat().st_size} bytes, no calibration file", CALIBRATE)
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(f"intrinsics {path}: no such file", f"check the path, or {CALIBRATE}") from None
    except UnicodeDecodeError:
        raise ConfigError(
            f"intrinsics {path}: is not a text file", "give OpenCV YAML, XML or JSON, or ROS YAML"
        ) from None
    except OSError as error:
        raise ConfigError(
            f"intrinsics {path}: cannot be read: {error.strerror}", "check the path and its rights"
        ) from None
    try:
        return parse_document(text)
    except NotReadableError as error:
        raise ConfigError(
            f"intrinsics {path}: {error}", "give OpenCV YAML, XML or JSON, or ROS camera_info YAML"
        ) from None


def _check_invertible(found: Keys, intrinsics: Intrinsics) -> None:
    """Every pixel of the frame's border must come from one direction only."""
    if not any(intrinsics.distortion):
        return
    w, h = intrinsics.width - 1.0, intrinsics.height - 1.0
    edge = np.linspace(0.0, 1.0, 17)
    u = np.concatenate([edge * w, edge * w, np.zeros(17), np.full(17, w)])
    v = np.concatenate([np.zeros(17), np.full(17, h), edge * h, edge * h])
    x, y = distort(intrinsics, *undistort(intrinsics, u, v))
    off = np.hypot(x * intrinsics.fx + intrinsics.cx - u, y * intrinsics.fy + intrinsics.cy - v)
    worst = float(np.max(np.nan_to_num(off, nan=np.inf, posinf=np.inf)))
    if not worst < 0.01:
        found.fault(
            "distortion_coefficients",
            "fold the picture's edge back on itself; wrong order of coefficients, or a calibration whose views do not"
            " reach the corners",
        )
