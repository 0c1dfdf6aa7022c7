"""Pictures are read whole or refused with one line; nothing in between."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.capture import images
from sagnode.capture.images import MAX_PIXELS, decode_grey, read_grey, to_grey8
from sagnode.errors import FrameError
from sagnode.quality import Cause


def scene(height: int = 120, width: int = 160) -> np.ndarray:
    """A smooth picture with detail everywhere, so that lost data shows."""
    noise = np.random.default_rng(7).integers(0, 256, (height, width, 3), np.uint8)
    return cv2.GaussianBlur(noise, (7, 7), 1.5)


def encoded(kind: str, picture: np.ndarray, *options: int) -> bytes:
    ok, data = cv2.imencode(kind, picture, list(options))
    assert ok
    return data.tobytes()


COLOUR = scene()
GREY = COLOUR[..., 1].copy()
LUMA = cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY)
JPEG = encoded(".jpg", COLOUR)
PROGRESSIVE = encoded(".jpg", COLOUR, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
PNG = encoded(".png", COLOUR)
PGM = encoded(".pgm", GREY)


@pytest.mark.parametrize(
    ("data", "expected", "tolerance"),
    [
        (PNG, LUMA, 0),
        (encoded(".png", GREY), GREY, 0),
        (encoded(".png", np.dstack([COLOUR, GREY])), LUMA, 0),
        (encoded(".png", GREY.astype(np.uint16) * 257), GREY, 0),
        (encoded(".tif", COLOUR), LUMA, 0),
        (encoded(".tif", GREY.astype(np.uint16) * 257), GREY, 0),
        (encoded(".pgm", GREY), GREY, 0),
        (encoded(".ppm", COLOUR), LUMA, 0),
        (JPEG, LUMA, 24),
        (PROGRESSIVE, LUMA, 24),
        (JPEG + bytes(64), LUMA, 24),
        (JPEG[:-2] + bytes(9) + JPEG[-2:], LUMA, 24),
        (JPEG[:-2] + bytes(9) + b"\xff" * 7 + JPEG[-2:], LUMA, 24),
    ],
)
def test_every_kind_gives_the_same_luma(data: bytes, expected: np.ndarray, tolerance: int) -> None:
    grey = decode_grey(data, "here")
    assert grey.dtype == np.uint8 and grey.flags.c_contiguous
    assert int(np.abs(grey.astype(int) - expected).max()) <= tolerance


def test_a_pgm_is_scaled_by_the_maximum_it_states() -> None:
    samples = (GREY.astype(int) * 1023 // 255).astype(">u2")
    grey = decode_grey(b"P5\n# ten bits\n160 120\n1023\n" + samples.tobytes(), "here")
    assert int(np.abs(grey.astype(int) - GREY).max()) <= 1


def test_sixteen_bits_are_scaled_by_a_constant_and_not_by_the_brightest_pixel() -> None:
    deep = GREY.astype(np.uint16) * 100
    with_lamp = deep.copy()
    with_lamp[0, 0] = 65535
    assert np.array_equal(to_grey8(deep, "a")[1:], to_grey8(with_lamp, "b")[1:])


def test_twelve_bits_without_scaling_are_refused_and_not_shown_black() -> None:
    with pytest.raises(FrameError, match="12-bit") as caught:
        to_grey8(GREY.astype(np.uint16) * 16, "frame.png")
    assert caught.value.cause is Cause.DARK


def test_one_wrong_bit_that_the_decoder_stumbles_over_is_damage() -> None:
    """A bit that makes a code longer or shorter shifts all that follows, and leaves a few bytes over at the end."""
    jpeg = encoded(".jpg", GREY)
    whole = decode_grey(jpeg, "whole").astype(int)
    start = jpeg.index(b"\xff\xda") + 14
    shifted = 0
    for at in np.random.default_rng(5).integers(8 * start, 8 * (len(jpeg) - 2), 400).tolist():
        data = bytearray(jpeg)
        data[at // 8] ^= 1 << at % 8
        pixels, said = images._decode(bytes(data), "frame")
        few = [re.search(r" (\d+) extraneous", line) for line in said]
        if few and few[0] and int(few[0][1]) <= 16 and pixels is not None:
            shifted += int(np.abs(pixels - whole).max()) > 24
            with pytest.raises(FrameError, match="damaged"):
                decode_grey(bytes(data), "frame")
    assert shifted >= 20


HALF = len(JPEG) // 2
RESTARTS = encoded(".jpg", COLOUR, cv2.IMWRITE_JPEG_RST_INTERVAL, 2)
RESTART = RESTARTS.index(b"\xff\xd4")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "empty"),
        (b"no picture at all", "not a JPEG"),
        (b"\xff\xd8", "cut off"),
        (JPEG[:HALF], "cut off"),
        (PROGRESSIVE[: len(PROGRESSIVE) * 2 // 3], "cut off"),
        (JPEG[:HALF] + b"\xff\xd9", "damaged"),
        (JPEG[:HALF] + bytes(400) + JPEG[HALF + 400 :], "damaged"),
        (JPEG[:-2] + b"\x5a" * 9 + JPEG[-2:], "damaged"),
        (JPEG[:-2] + bytes(100) + JPEG[-2:], "damaged"),
        (RESTARTS[:RESTART] + bytes(9) + RESTARTS[RESTART:], "damaged"),
        (PNG[: len(PNG) // 2], "cut off"),
        (PNG[:-12], "cut off"),
        (PNG[:5000] + bytes([PNG[5000] ^ 1]) + PNG[5001:], "checksum"),
        (encoded(".tif", COLOUR)[:-200], "cut off"),
        (b"P5 160 120 255\n" + bytes(100), "cut off"),
        (PGM[:5000] + bytes(8) + PGM[5000:], "8 bytes more"),
        (encoded(".tif", COLOUR.astype(np.float32)), "float32"),
        (encoded(".png", GREY[:8, :8]), "8x8"),
    ],
)
def test_what_is_not_a_whole_picture_is_refused(data: bytes, says: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(FrameError, match=says) as caught:
        decode_grey(data, "picture a.jpg")
    assert caught.value.cause is Cause.BAD_FRAME
    assert str(caught.value).startswith("picture a.jpg")
    assert caught.value.remedy
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""  # the decoders' own words stay out of a user's sight


def test_the_same_pgm_is_read_without_bytes_too_many() -> None:
    assert np.array_equal(decode_grey(PGM, "here"), GREY)


@pytest.mark.parametrize("hushed", [False, True])
@pytest.mark.parametrize("picture", [GREY, COLOUR], ids=["grey", "colour"])
@pytest.mark.parametrize("compression", [5, 8, 32946], ids=["lzw", "deflate", "old-deflate"])
def test_damage_in_a_packed_tiff_is_damage(compression: int, picture: np.ndarray, hushed: bool) -> None:
    """OpenCV hands on what could not be unpacked as rows of anything, and libtiff looks at no checksum."""
    whole = encoded(".tif", picture, cv2.IMWRITE_TIFF_COMPRESSION, compression)
    expected = picture if picture.ndim == 2 else LUMA
    assert np.array_equal(decode_grey(whole, "whole"), expected)
    log = getattr(cv2.utils, "logging", cv2)
    before = log.getLogLevel()
    if hushed:
        log.setLogLevel(0)
    try:
        for at in range(200, len(whole) - 600, 997):
            with pytest.raises(FrameError, match="is damaged"):
                decode_grey(whole[:at] + bytes(30) + whole[at + 30 :], "frame")
    finally:
        log.setLogLevel(before)


@pytest.mark.parametrize("compression", [1, 5], ids=["none", "lzw"])
def test_a_tag_that_libtiff_does_not_know_is_no_damage(compression: int, capfd: pytest.CaptureFixture[str]) -> None:
    tiff = encoded(".tif", GREY, cv2.IMWRITE_TIFF_COMPRESSION, compression)
    (directory,) = struct.unpack_from("<I", tiff, 4)
    (count,) = struct.unpack_from("<H", tiff, directory)
    entries = tiff[directory + 2 : directory + 2 + 12 * count] + struct.pack("<HHII", 65000, 4, 1, 7)
    moved = tiff[:4] + struct.pack("<I", len(tiff)) + tiff[8:] + struct.pack("<H", count + 1) + entries + bytes(4)
    assert np.array_equal(decode_grey(moved, "frame"), GREY)
    assert capfd.readouterr().err == ""


HOLED = JPEG[:HALF] + bytes(400) + JPEG[HALF + 400 :]
IN_A_PROCESS = """
import os, resource, signal, sys
from sagnode.capture.images import read_grey
from sagnode.errors import FrameError
answers = os.dup(1)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
{before}
for path in sys.argv[1:]:
    try:
        said = f"read {{read_grey(path).shape}}"
    except FrameError as error:
        said = str(error)
    os.write(answers, (said + chr(10)).encode())
"""


@pytest.mark.parametrize(
    ("before", "sound", "holed"),
    [
        ("", "read (120, 160)", "damaged: Corrupt JPEG data"),
        ("os.close(2)", "read (120, 160)", "damaged: Corrupt JPEG data"),
        ("for i in 0, 1, 2: os.close(i)", "read (120, 160)", "damaged: Corrupt JPEG data"),
        ("import tempfile; tempfile.tempdir = '/nowhere'", "read (120, 160)", "damaged: Corrupt JPEG data"),
        # nothing can be kept: then nothing is believed
        ("resource.setrlimit(resource.RLIMIT_FSIZE, (20, 20))", "could not be looked at for damage", "for damage"),
        ("resource.setrlimit(resource.RLIMIT_NOFILE, (answers + 2,) * 2)", "for damage: Too many", "for damage"),
    ],
    ids=["plain", "no-stderr", "no-streams", "no-temporary-directory", "no-room", "no-descriptors"],
)
def test_damage_is_known_wherever_the_decoder_may_write(tmp_path: Path, before: str, sound: str, holed: str) -> None:
    """libjpeg tells of lost data on standard error alone. A full disk there, or none, must not make them whole."""
    (tmp_path / "sound.jpg").write_bytes(JPEG)
    (tmp_path / "holed.jpg").write_bytes(HOLED)
    code = IN_A_PROCESS.format(before=before)
    words = [sys.executable, "-c", code, tmp_path / "sound.jpg", tmp_path / "holed.jpg"]
    of_sound, of_holed = subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=60).stdout.splitlines()
    assert sound in of_sound
    assert holed in of_holed


def test_a_bomb_is_refused_by_its_header() -> None:
    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 0, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")]
    png = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
    with pytest.raises(FrameError, match=f"at most {MAX_PIXELS // 1_000_000} megapixels"):
        decode_grey(png, "bomb")


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    device = Path("/dev/zero")
    for path, says in [(tmp_path / "none.png", "does not exist"), (tmp_path, "directory"), (device, "device")]:
        with pytest.raises(FrameError, match=says) as caught:
            read_grey(path)
        assert str(path) in str(caught.value)
    (tmp_path / "a.png").write_bytes(PNG)
    assert read_grey(tmp_path / "a.png").shape == (120, 160)


SEEDS = [JPEG, PROGRESSIVE, PNG, encoded(".tif", COLOUR), encoded(".pgm", GREY)]


@settings(max_examples=250, deadline=None)
@given(
    st.sampled_from(SEEDS),
    st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=8),
    st.floats(0, 1),
    st.binary(max_size=16),
)
def test_mutated_pictures_give_grey_or_one_line(
    seed: bytes, changes: list[tuple[float, int]], cut: float, tail: bytes
) -> None:
    data = bytearray(seed)
    for where, value in changes:
        data[int(where * (len(data) - 1))] = value
    mutated = bytes(data[: int(cut * len(data))] if cut < 0.5 else data) + tail
    try:
        grey = decode_grey(mutated, "mutated")
    except FrameError as error:
        assert str(error).startswith("mutated")
    else:
        assert grey.ndim == 2 and grey.dtype == np.uint8
