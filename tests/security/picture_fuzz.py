"""Throws damaged and hostile pictures at the reader of pictures, in a process of its own with bounded memory.

    python tests/security/picture_fuzz.py [COUNT [SEED]]

Prints how many were read and how many refused, by reason. Anything but an 8-bit grey picture or a FrameError is an
uncaught error; a crash of OpenCV ends the process with a signal. Both fail.
"""

import collections
import itertools
import random
import re
import resource
import struct
import sys
import zlib

import cv2
import numpy as np

from sagnode.capture.headers import exif_taken
from sagnode.capture.images import MAX_PIXELS, MIN_SIDE, decode_grey
from sagnode.errors import FrameError
from sagnode.worker.confine import limit_growth

MEMORY_MB = 600
EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)


def seeds():
    """Whole pictures of every kind that is read."""
    rng = np.random.default_rng(1)
    grey = cv2.GaussianBlur(rng.integers(0, 256, (60, 80), dtype=np.uint8), (0, 0), 3)
    colour = cv2.merge([grey, 255 - grey, grey])
    deep = grey.astype(np.uint16) * 257
    exif = (
        b"Exif\0\0II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x1a\0\0\0\0\0\0\0"
        b"\x02\0\x03\x90\x02\0\x14\0\0\0\x38\0\0\0\x11\x90\x02\0\x07\0\0\0\x4c\0\0\0\0\0\0\0"
        b"2026:06:21 04:00:00\0+02:00\0"
    )
    made = {}
    for name, options in {
        "jpeg": [],
        "progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
        "restart": [cv2.IMWRITE_JPEG_RST_INTERVAL, 2],
    }.items():
        jpeg = cv2.imencode(".jpg", colour, options)[1].tobytes()
        made[name] = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
    for name, picture in {"grey": grey, "colour": colour, "deep": deep}.items():
        made[f"png {name}"] = cv2.imencode(".png", picture)[1].tobytes()
        made[f"pnm {name}"] = cv2.imencode(".ppm" if picture.ndim == 3 else ".pgm", picture)[1].tobytes()
        for compression in (1, 5, 8, 32773):  # none, LZW, deflate, PackBits
            options = [cv2.IMWRITE_TIFF_COMPRESSION, compression]
            made[f"tiff {name} {compression}"] = cv2.imencode(".tiff", picture, options)[1].tobytes()
    return made


def mutated(data, rng):
    """A few of: bytes changed, a number set to an extreme, a stretch cut out, doubled, or moved; checksums mended."""
    body = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(body)) if rng.random() < 0.5 else rng.randrange(min(len(body), 200))
        match rng.randrange(6):
            case 0:
                body[at] = rng.randrange(256)
            case 1:
                body[at] ^= 1 << rng.randrange(8)
            case 2:
                form = rng.choice((">H", "<H", ">I", "<I"))
                value = rng.choice(EXTREMES) & (0xFFFF if form[1] == "H" else 0xFFFFFFFF)
                number = struct.pack(form, value)
                body[at : at + len(number)] = number
            case 3:
                del body[at : at + rng.choice((1, 2, 7, 100, 100_000))]
            case 4:
                body[at:at] = body[at : at + rng.choice((1, 4, 12, 50))] * rng.choice((1, 2, 100))
            case 5:
                there = rng.randrange(len(body))
                body[at : at + 12] = body[there : there + 12]
        if not body:
            return b""
    return mended(bytes(body)) if data[:4] == b"\x89PNG" and rng.random() < 0.7 else bytes(body)


def mended(png):
    """With right checksums, so that more than the checksum is tried."""
    out, at = bytearray(png), 8
    while at + 12 <= len(png):
        (length,) = struct.unpack_from(">I", png, at)
        if at + 12 + length > len(png):
            break
        struct.pack_into(">I", out, at + 8 + length, zlib.crc32(png[at + 4 : at + 8 + length]))
        at += 12 + length
    return bytes(out)


def hostile():
    """Small files that ask for much: each must be refused, or cost no more than a picture of the size allowed."""

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    def png(width, height, depth, colour, raw_bytes):
        body = zlib.compressobj(9)
        raw = b"".join(body.compress(bytes(1 << 20)) for _ in range(raw_bytes >> 20)) + body.flush()
        head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
        return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", raw) + chunk(b"IEND", b"")

    yield "png that claims 4 Gpx", png(65500, 65500, 8, 0, 1 << 20)
    yield "png 64 Mpx of 4 x 16 bit", png(8000, 8000, 16, 6, 16 << 20)
    yield "png whose data unpack to 200 times its picture", png(100, 100, 8, 0, 200 << 20)
    text = zlib.compress(bytes(100 << 20), 9)
    good = png(100, 100, 8, 0, 1 << 20)
    yield "png with a comment that unpacks to 100 MB", good[:33] + chunk(b"zTXt", b"c\0\0" + text) + good[33:]
    yield "png with a million chunks", good[:33] + chunk(b"tEXt", b"") * 1_000_000 + good[33:]
    jpeg = cv2.imencode(".jpg", np.zeros((64, 64), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    at = jpeg.rindex(b"\xff\xda")
    yield "jpeg with 20 000 scans", jpeg[:at] + jpeg[at:-2] * 20_000 + jpeg[-2:]
    sof = jpeg.index(b"\xff\xc2")
    yield "jpeg that claims 4 Gpx", jpeg[: sof + 5] + b"\xff\xdc\xff\xdc" + jpeg[sof + 9 :]
    yield "jpeg with a million segments", jpeg[:2] + b"\xff\xfe\x00\x02" * 1_000_000 + jpeg[2:]
    pixels = bytes(100)
    entries = b"".join(struct.pack("<HHII", 1000 + i, 1, 700_000, 8) for i in range(60_000))
    yield (
        "tiff whose 60 000 entries each claim the file",
        b"II*\0\x08\0\0\0" + struct.pack("<H", 60_000) + entries + pixels,
    )
    sizes = [(256, 20), (257, 20), (258, 8), (259, 1), (262, 1), (273, 200), (277, 1), (278, 20), (279, 400)]
    for first, second in itertools.permutations((sizes, [(256, 60_000), (257, 60_000)])):
        both = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in (*first, *second))
        count = struct.pack("<H", len(first) + len(second))
        yield "tiff that gives its size twice", b"II*\0\x08\0\0\0" + count + both + bytes(1000)
    yield "pgm that claims 10^18 px", b"P5 999999999 999999999 255\n" + bytes(1000)
    yield "pgm of nothing but blanks", b"P5" + b" " * 30_000_000
    yield "tiff that points at itself", b"II*\0\x00\0\0\0" + bytes(100)


def verdict(data):
    """Why a picture was refused, or that it was read."""
    try:
        exif_taken(data)
        picture = decode_grey(data, "it")
    except FrameError as error:
        assert str(error).count("\n") == 0
        return re.sub(r"[0-9]+|'.*'|: .*", "#", error.what)[:60]
    assert picture.dtype == np.uint8
    assert picture.ndim == 2
    assert min(picture.shape) >= MIN_SIDE
    assert picture.size <= MAX_PIXELS
    return "read"


def main(count, seed):
    """All of it; the outcome as a table."""
    limit_growth(MEMORY_MB)
    rng, whole = random.Random(seed), seeds()
    for name, data in whole.items():
        assert verdict(data) == "read", name
    for name, data in hostile():
        print(f"{len(data):>10} bytes  {name}: {verdict(data)}")
    tally = collections.Counter()
    names = sorted(whole)
    for i in range(count):
        data = mutated(whole[names[i % len(names)]], rng)
        try:
            tally[verdict(data)] += 1
        except Exception:
            print(f"seed {seed}, input {i}, {names[i % len(names)]}: {data.hex()[:4000]}")
            raise
    for reason, times in tally.most_common():
        print(f"{times:>10}  {reason}")
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(f"{count} damaged pictures, 0 uncaught errors, {most} MB at most")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5000, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
