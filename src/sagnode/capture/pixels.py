"""8-bit grey out of a camera's buffer, by the pixel format that was negotiated.

Formats are named as V4L2 (four characters) or as libcamera names them. libcamera's ``RGB888`` lies in memory as B, G,
R, for it names the bits of a little-endian word; V4L2's ``RGB3`` lies as R, G, B.
"""

from __future__ import annotations

import re
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.images import decode_grey
from sagnode.capture.port import GreyImage
from sagnode.errors import FrameError
from sagnode.quality import Cause

Buffer = NDArray[np.uint8]

_LUMA_FIRST = frozenset({"GREY", "R8", "NV12", "NV21", "YU12", "YV12", "YUV420", "YVU420", "YUV422", "422P"})
_PACKED_LUMA = {"YUYV": 0, "YVYU": 0, "UYVY": 1, "VYUY": 1}
_COLOUR = {
    "BGR3": (3, cv2.COLOR_BGR2GRAY),
    "RGB3": (3, cv2.COLOR_RGB2GRAY),
    "RGB888": (3, cv2.COLOR_BGR2GRAY),
    "BGR888": (3, cv2.COLOR_RGB2GRAY),
    "XRGB8888": (4, cv2.COLOR_BGRA2GRAY),
    "XBGR8888": (4, cv2.COLOR_RGBA2GRAY),
}
_JPEG = frozenset({"MJPG", "JPEG", "MJPEG"})
_DEEP_GREY = {"Y10": 10, "Y12": 12, "Y16": 16, "R10": 10, "R12": 12, "R16": 16}
_RAW = re.compile(r"S(RGGB|BGGR|GRBG|GBRG)(8|10|12|14|16)(_CSI2P)?|R(10|12)_CSI2P")
_BAYER = {
    "RGGB": cv2.COLOR_BayerRGGB2GRAY,
    "BGGR": cv2.COLOR_BayerBGGR2GRAY,
    "GRBG": cv2.COLOR_BayerGRBG2GRAY,
    "GBRG": cv2.COLOR_BayerGBRG2GRAY,
}


def known_format(name: str) -> bool:
    """Whether :func:`grey_of_buffer` can read it."""
    name = name.strip()
    return (
        name in _LUMA_FIRST | _JPEG
        or name in _PACKED_LUMA
        or name in _COLOUR
        or name in _DEEP_GREY
        or _RAW.fullmatch(name) is not None
    )


def row_bytes(name: str, width: int) -> int:
    """Bytes of one row of the first plane without padding; 0 for compressed formats."""
    name = name.strip()
    if name in _JPEG:
        return 0
    if name in _LUMA_FIRST:
        return width
    if name in _PACKED_LUMA or name in _DEEP_GREY:
        return 2 * width
    if name in _COLOUR:
        return _COLOUR[name][0] * width
    bits, packed = _raw_layout(name)
    return (width * bits + 7) // 8 if packed or bits == 8 else 2 * width


def grey_of_buffer(data: Buffer, name: str, width: int, height: int, stride: int, source: str) -> GreyImage:
    """The picture in a camera's buffer.

    Args:
        data: the buffer's bytes, flat.
        name: pixel format.
        width: of the picture, px.
        height: of the picture, px.
        stride: bytes from row to row in the first plane; 0 where rows follow without padding.
        source: names the camera in errors.

    Returns:
        8-bit grey (height, width), an own copy. Bayer mosaics are interpolated, deeper samples scaled by their constant
        full scale (10 bits: 1023).

    Raises:
        FrameError: (bad-frame) too few bytes, a damaged JPEG, or an unknown format.
    """
    name = name.strip()
    if not known_format(name):
        remedy = 'choose an uncompressed stream (picamera2: stream = "main"; V4L2: pixel_format GREY, YUYV or MJPG)'
        raise FrameError(f"{source}: pixel format {name} is not known", remedy, Cause.BAD_FRAME)
    if name in _JPEG:
        grey = decode_grey(data.tobytes(), source)
        if grey.shape != (height, width):
            what = f"{source}: its JPEG is {grey.shape[1]}x{grey.shape[0]} px, not {width}x{height}"
            raise FrameError(what, "set the size that the camera gives", Cause.BAD_FRAME)
        return grey
    rows = _rows(data, row_bytes(name, width), height, stride, source)
    return np.array(_grey_of_rows(rows, name, width), order="C", dtype=np.uint8)


def _grey_of_rows(rows: Buffer, name: str, width: int) -> NDArray[Any]:
    if name in _LUMA_FIRST:
        return rows
    if name in _PACKED_LUMA:
        return rows[:, _PACKED_LUMA[name] :: 2]
    if name in _COLOUR:
        channels, conversion = _COLOUR[name]
        return cv2.cvtColor(np.ascontiguousarray(rows).reshape(len(rows), width, channels), conversion)
    if name in _DEEP_GREY:
        return _scaled(_words(rows), _DEEP_GREY[name])
    bits, packed = _raw_layout(name)
    samples: NDArray[Any] = _unpacked(rows, bits, width) if packed else rows if bits == 8 else _words(rows)
    if name.startswith("S"):
        samples = cv2.cvtColor(np.ascontiguousarray(samples), _BAYER[name[1:5]])
    return samples if bits == 8 else _scaled(samples, bits)


def _rows(data: Buffer, wanted: int, height: int, stride: int, source: str) -> Buffer:
    """(height, wanted) bytes, cut out of rows that may be padded."""
    stride = stride or wanted
    if stride < wanted or data.size < stride * (height - 1) + wanted:
        what = f"{source}: the frame has {data.size} of {stride * height} bytes"
        raise FrameError(what, "check the camera's cable and power, and its size and pixel format", Cause.BAD_FRAME)
    return np.lib.stride_tricks.as_strided(data, (height, wanted), (stride, 1), writeable=False)


def _words(rows: Buffer) -> NDArray[np.uint16]:
    return np.ascontiguousarray(rows).view("<u2").astype(np.uint16, copy=False)


def _scaled(samples: NDArray[np.uint16], bits: int) -> NDArray[Any]:
    return cv2.convertScaleAbs(samples, alpha=255.0 / (2**bits - 1))


def _raw_layout(name: str) -> tuple[int, bool]:
    """Bits a sample, and whether they are packed as MIPI CSI-2 packs them."""
    found = _RAW.fullmatch(name)
    if found is None:
        raise ValueError(name)
    return int(found[2] or found[4]), name.endswith("_CSI2P")


def _unpacked(rows: Buffer, bits: int, width: int) -> NDArray[np.uint16]:
    """MIPI CSI-2 RAW10 and RAW12: the upper eight bits of 4 (2) samples, then one byte with all their lower bits."""
    together = 4 if bits == 10 else 2
    low = bits - 8
    groups = -(-width // together)
    padded = np.zeros((len(rows), groups * (together + 1)), np.uint8)
    padded[:, : rows.shape[1]] = rows
    if width % together:  # the row ends inside a group: its low bits are the last byte
        padded[:, -1] = rows[:, -1]
    group = padded.reshape(len(rows), groups, together + 1)
    shifts = np.arange(together, dtype=np.uint16) * low
    lows = (group[:, :, -1:].astype(np.uint16) >> shifts) & (2**low - 1)
    samples = (group[:, :, :together].astype(np.uint16) << low) | lows
    return np.ascontiguousarray(samples.reshape(len(rows), -1)[:, :width])
