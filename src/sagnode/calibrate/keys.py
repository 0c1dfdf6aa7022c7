"""The keys of a calibration file, by whatever names the program that wrote it gives them, and the faults in them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from sagnode.errors import ConfigError

_MATRIX_KEYS = ("cameramatrix", "k", "intrinsicmatrix", "mtx")
_DISTORTION_KEYS = ("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoeff", "distortion", "dist", "d")
_WIDTH_KEYS, _HEIGHT_KEYS = ("imagewidth", "width"), ("imageheight", "height")
_SIZE_KEYS = ("imagesize", "imgsize", "resolution")
_MODEL_KEYS = ("distortionmodel", "cameramodel", "model")
_ERROR_KEYS = (
    "avgreprojectionerror",
    "rmspx",
    "rms",
    "rmserror",
    "reprojectionerror",
    "rmsreprojectionerror",
    "meanreprojectionerror",
)
_PINHOLE = {"", "plumbbob", "radtan", "rationalpolynomial", "pinhole", "brown", "opencv", "none"}
_FISHEYE = {"equidistant", "fisheye", "kannalabrandt", "kannalabrandt4"}
CALIBRATE = "make it anew with: sagnode calibrate"


def _plain(key: str) -> str:
    return key.lower().replace("_", "").replace("-", "")


class Keys:
    """The file's keys, and the faults found in them."""

    def __init__(self, path: Path, document: Mapping[str, object]) -> None:
        self._path = path
        self._by_plain = {_plain(key): (key, value) for key, value in document.items()}
        self._faults: list[str] = []

    def fault(self, key: str, text: str) -> None:
        """Note a fault of a key."""
        self._faults.append(f"intrinsics {self._path}: {key}: {text}")

    def raise_faults(self) -> None:
        """Raise all that were noted, as one :class:`ConfigError`."""
        if self._faults:
            first = self._faults[0]
            more = f" (and {len(self._faults) - 1} more)" if len(self._faults) > 1 else ""
            raise ConfigError(first + more, f"mend the file, or {CALIBRATE}", tuple(self._faults))

    def _find(self, names: tuple[str, ...]) -> tuple[str, object] | None:
        return next((self._by_plain[name] for name in names if name in self._by_plain), None)

    def _numbers(self, key: str, value: object) -> list[float] | None:
        """A flat list of finite numbers, with its shape checked against rows and cols where they are given."""
        rows, cols = None, None
        if isinstance(value, Mapping):
            rows, cols = value.get("rows"), value.get("cols")
            value = value.get("data")
        flat = _flatten(value)
        if flat is None:
            self.fault(key, "is not a list of numbers")
            return None
        if rows is not None and cols is not None and str(len(flat)) != str(_product(rows, cols)):
            self.fault(key, f"rows {rows} and cols {cols} do not fit its {len(flat)} numbers")
            return None
        if not all(math.isfinite(x) for x in flat):
            self.fault(key, "holds a number that is not finite")
            return None
        return flat

    def size(self) -> tuple[int, int]:
        """Width and height, px; 1x1 after a fault."""
        both = self._find(_SIZE_KEYS)
        pair = [self._find(_WIDTH_KEYS), self._find(_HEIGHT_KEYS)]
        if all(pair):
            named = [p for p in pair if p]
        elif both:
            flat = _flatten(both[1])
            named = [(both[0], x) for x in flat] if flat and len(flat) == 2 else []
        else:
            named = []
        if len(named) != 2:
            self.fault("image_width, image_height", "missing; intrinsics mean nothing without the size they belong to")
            return 1, 1
        size = []
        for key, value in named:
            flat = _flatten([value])
            if not flat or not math.isfinite(flat[0]) or flat[0] != int(flat[0]) or not 16 <= flat[0] <= 65535:
                self.fault(key, f"{value!r} is not a picture size; a whole number of pixels from 16 is expected")
            else:
                size.append(int(flat[0]))
        return (size[0], size[1]) if len(size) == 2 else (1, 1)

    def matrix(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy; ones after a fault."""
        entry = self._find(_MATRIX_KEYS)
        none = (1.0, 1.0, 0.0, 0.0)
        if entry is None:
            self.fault("camera_matrix", "missing (also looked for: cameraMatrix, K, intrinsic_matrix, mtx)")
            return none
        key, value = entry
        flat = self._numbers(key, value)
        if flat is None:
            return none
        if len(flat) != 9:
            self.fault(key, f"has {len(flat)} numbers; a 3x3 matrix has 9")
            return none
        fx, skew, cx, low, fy, cy, *last = flat
        if fx <= 0 or fy <= 0:
            self.fault(key, f"focal lengths {fx:.6g}, {fy:.6g} must be positive")
        if abs(skew) > 1e-6 * abs(fx) or low != 0 or last != [0.0, 0.0, 1.0]:
            self.fault(key, "is not of the form fx 0 cx / 0 fy cy / 0 0 1")
        return fx, fy, cx, cy

    def error(self) -> tuple[str, float] | None:
        """Key and value of the reprojection error; None where there is none, or no number."""
        entry = self._find(_ERROR_KEYS)
        number = None if entry is None else _number(entry[1])
        return (entry[0], number[0]) if entry is not None and number else None

    def lens(self) -> tuple[Literal["pinhole", "fisheye"], tuple[float, ...]]:
        """Distortion model and coefficients."""
        entry = self._find(_MODEL_KEYS)
        word = _plain(str(entry[1])).replace(" ", "") if entry and entry[1] is not None else ""
        if word not in _PINHOLE | _FISHEYE:
            key, value = entry or ("", "")
            self.fault(
                key, f"unknown model {value!r}; plumb_bob, rational_polynomial, equidistant and fisheye are known"
            )
            return "pinhole", ()
        model: Literal["pinhole", "fisheye"] = "fisheye" if word in _FISHEYE else "pinhole"
        coefficients = self._find(_DISTORTION_KEYS)
        if coefficients is None:
            self.fault("distortion_coefficients", "missing; a lens without distortion has five zeros")
            return model, ()
        key, value = coefficients
        flat = self._numbers(key, value)
        if flat is None:
            return model, ()
        while len(flat) > 8 and flat[-1] == 0:  # thin prism and tilt that are not used
            flat.pop()
        allowed = {0, 4} if model == "fisheye" else {0, 4, 5, 8}
        if len(flat) not in allowed:
            counts = "4" if model == "fisheye" else "4, 5 or 8 (thin prism and tilt are not modelled)"
            self.fault(key, f"has {len(flat)} coefficients; the {model} model takes {counts}")
            return model, ()
        return model, tuple(flat)


def _product(rows: object, cols: object) -> int:
    flat = _flatten([rows, cols])
    product = flat[0] * flat[1] if flat is not None and len(flat) == 2 else math.nan
    return int(product) if math.isfinite(product) else -1


def _flatten(value: object) -> list[float] | None:
    """Numbers of nested lists; None when something else is in it. YAML 1.1 takes ``1e-3`` for text, hence ``str``."""
    if isinstance(value, list):
        flat: list[float] = []
        for item in value:
            part = _flatten(item) if isinstance(item, list) else _number(item)
            if part is None:
                return None
            flat += part
        return flat
    return None


def _number(item: object) -> list[float] | None:
    if isinstance(item, bool) or not isinstance(item, int | float | str):
        return None
    try:
        return [float(item)]
    except (ValueError, OverflowError):
        return None
