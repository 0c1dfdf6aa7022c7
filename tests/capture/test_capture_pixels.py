"""Grey out of camera buffers: every layout gives back the luma that was put in; faulty frames are refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from sagnode.capture.checks import check_frame
from sagnode.capture.pixels import grey_of_buffer, known_format, row_bytes
from sagnode.errors import FrameError
from sagnode.quality import Cause

W, H, PAD = 48, 34, 16
LUMA = cv2.GaussianBlur(np.random.default_rng(3).integers(0, 256, (H, W), np.uint8), (5, 5), 1.0)
COLOUR = cv2.GaussianBlur(np.random.default_rng(4).integers(0, 256, (H, W, 3), np.uint8), (5, 5), 1.0)
COLOUR_LUMA = cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY)


def padded(rows: np.ndarray) -> np.ndarray:
    """Rows of bytes with the padding that camera drivers add."""
    return np.hstack([rows, np.full((len(rows), PAD), 170, np.uint8)]).reshape(-1)


def with_chroma(plane_rows: int) -> np.ndarray:
    return np.vstack([LUMA, np.full((plane_rows, W), 128, np.uint8)])


def interleaved(luma_at: int) -> np.ndarray:
    rows = np.full((H, 2 * W), 90, np.uint8)
    rows[:, luma_at::2] = LUMA
    return rows


def words(samples: np.ndarray) -> np.ndarray:
    return samples.astype("<u2").view(np.uint8).reshape(H, -1)


DEEP = LUMA.astype(int)


def csi2_raw10(samples: np.ndarray) -> np.ndarray:
    """As MIPI CSI-2 says: bytes 0..3 are bits 9..2 of four samples, byte 4 holds their bits 1..0, first one lowest."""
    out = []
    for row in samples.tolist():
        line: list[int] = []
        for i in range(0, len(row), 4):
            group = row[i : i + 4]
            line += [s >> 2 for s in group] + [sum((s & 3) << (2 * k) for k, s in enumerate(group))]
        out.append(line)
    return np.array(out, np.uint8)


def csi2_raw12(samples: np.ndarray) -> np.ndarray:
    a, b = samples[:, 0::2], samples[:, 1::2]
    return np.stack([a >> 4, b >> 4, (a & 15) | ((b & 15) << 4)], axis=-1).reshape(H, -1).astype(np.uint8)


@pytest.mark.parametrize(
    ("name", "rows", "expected", "tolerance"),
    [
        ("GREY", LUMA, LUMA, 0),
        ("NV12", with_chroma(H // 2), LUMA, 0),
        ("YUV420", with_chroma(H // 2), LUMA, 0),
        ("YUYV", interleaved(0), LUMA, 0),
        ("UYVY", interleaved(1), LUMA, 0),
        ("BGR3", COLOUR.reshape(H, -1), COLOUR_LUMA, 0),
        ("RGB3", COLOUR[..., ::-1].reshape(H, -1), COLOUR_LUMA, 0),
        ("RGB888", COLOUR.reshape(H, -1), COLOUR_LUMA, 0),
        ("BGR888", COLOUR[..., ::-1].reshape(H, -1), COLOUR_LUMA, 0),
        ("XRGB8888", np.dstack([COLOUR, LUMA]).reshape(H, -1), COLOUR_LUMA, 0),
        ("XBGR8888", np.dstack([COLOUR[..., ::-1], LUMA]).reshape(H, -1), COLOUR_LUMA, 0),
        ("Y10 ", words(DEEP * 1023 // 255), LUMA, 1),
        ("Y16 ", words(DEEP * 257), LUMA, 0),
        ("R10_CSI2P", csi2_raw10(DEEP * 1023 // 255), LUMA, 1),
        ("R12_CSI2P", csi2_raw12(DEEP * 4095 // 255), LUMA, 1),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
@pytest.mark.parametrize("pad", [False, True])
def test_luma_comes_out_as_it_went_in(
    name: str, rows: np.ndarray, expected: np.ndarray, tolerance: int, pad: bool
) -> None:
    data = padded(rows) if pad else np.ascontiguousarray(rows).reshape(-1)
    stride = row_bytes(name, W) + PAD if pad else 0
    grey = grey_of_buffer(data, name, W, H, stride, "camera")
    assert grey.shape == (H, W) and grey.dtype == np.uint8 and grey.flags.c_contiguous
    assert int(np.abs(grey.astype(int) - expected).max()) <= tolerance


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_a_mosaic_of_a_grey_world_is_that_world(pattern: str, bits: int) -> None:
    ramp = np.broadcast_to(np.linspace(20, 220, W), (H, W))
    full = 2**bits - 1
    samples = np.round(ramp / 255 * full).astype(np.uint16)
    rows = samples.astype(np.uint8) if bits == 8 else words(samples)
    grey = grey_of_buffer(rows.reshape(-1), f"S{pattern}{bits}", W, H, 0, "camera")
    assert float(np.abs(grey[2:-2, 2:-2] - ramp[2:-2, 2:-2]).max()) < 3.0


def test_the_two_colours_of_a_mosaic_are_not_swapped() -> None:
    mosaic = np.zeros((H, W), np.uint8)
    mosaic[0::2, 0::2] = 250  # red sites of RGGB
    red = grey_of_buffer(mosaic.reshape(-1), "SRGGB8", W, H, 0, "camera")
    blue = grey_of_buffer(mosaic.reshape(-1), "SBGGR8", W, H, 0, "camera")
    assert abs(int(red[10:20, 10:20].mean()) - 0.299 * 250) < 3  # Rec. 601 weights
    assert abs(int(blue[10:20, 10:20].mean()) - 0.114 * 250) < 3


def test_motion_jpeg_is_decoded_whole_or_refused() -> None:
    jpeg = cv2.imencode(".jpg", LUMA, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].reshape(-1)
    grey = grey_of_buffer(jpeg, "MJPG", W, H, 0, "camera")
    assert int(np.abs(grey.astype(int) - LUMA).max()) < 12
    for fill in (0, 255, 90):  # drivers hand on their whole buffer, whatever is in the rest of it
        whole_buffer = np.concatenate([jpeg, np.full(500, fill, np.uint8)])
        assert np.array_equal(grey_of_buffer(whole_buffer, "MJPG", W, H, 0, "camera"), grey)
    with pytest.raises(FrameError, match="cut off"):
        grey_of_buffer(jpeg[: len(jpeg) // 2], "MJPG", W, H, 0, "camera")
    with pytest.raises(FrameError, match="48x34"):
        grey_of_buffer(jpeg, "MJPG", 640, 480, 0, "camera")


def test_short_buffers_and_unknown_formats_are_refused() -> None:
    with pytest.raises(FrameError, match="of 1632 bytes") as caught:
        grey_of_buffer(LUMA.reshape(-1)[:-1], "GREY", W, H, 0, "camera /dev/video0")
    assert caught.value.cause is Cause.BAD_FRAME and "/dev/video0" in str(caught.value)
    assert not known_format("RGGB_PISP_COMP1")
    with pytest.raises(FrameError, match="RGGB_PISP_COMP1 is not known"):
        grey_of_buffer(LUMA.reshape(-1), "RGGB_PISP_COMP1", W, H, 0, "camera")


def other(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(20, 230, (96, 64), np.uint8)


def test_a_sound_frame_passes_and_so_does_one_with_a_burnt_out_sky() -> None:
    check_frame(other(1), other(2), "camera")
    burnt = other(3)
    burnt[:40] = 255
    check_frame(burnt, other(2), "camera")


@pytest.mark.parametrize(
    ("image", "previous", "cause", "says"),
    [
        (np.zeros((96, 64), np.uint8), None, Cause.DARK, "black"),
        (np.full((96, 64), 255, np.uint8), None, Cause.OVEREXPOSED, "every pixel is 255"),
        (np.full((96, 64), 128, np.uint8), None, Cause.BAD_FRAME, "every pixel is 128"),
        (other(1), other(1), Cause.STALE_FRAME, "same frame again"),
        (np.vstack([other(1)[:60], other(2)[60:]]), other(2), Cause.BAD_FRAME, "rows 60 to 95 are the last one's"),
        (np.vstack([other(2)[:60], other(1)[60:]]), other(2), Cause.BAD_FRAME, "rows 0 to 59 are the last one's"),
        (
            np.vstack([other(1)[:60], np.zeros((36, 64), np.uint8)]),
            other(2),
            Cause.BAD_FRAME,
            "lower 36 rows are all 0",
        ),
    ],
)
def test_what_a_faulty_camera_delivers_is_refused(
    image: np.ndarray, previous: np.ndarray | None, cause: Cause, says: str
) -> None:
    with pytest.raises(FrameError, match=says) as caught:
        check_frame(image, previous, "camera")
    assert caught.value.cause is cause
