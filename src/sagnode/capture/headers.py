"""What a picture file says of itself before it is decoded: kind, size, whether all of it is there, when it was taken.

OpenCV decodes half a JPEG without a word and takes any size that a header claims. So the few container formats that a
node meets are walked here first: JPEG (ITU-T T.81, Annex B), PNG (W3C PNG, 3rd edition), TIFF 6.0 and binary PGM/PPM.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_LONE = frozenset((0x01, *range(0xD0, 0xD8)))
# In entropy-coded data ff 00 is a byte of data and ff d0..d7 a restart: any other marker ends the scan.
_END_OF_SCAN = re.compile(rb"\xff+[\x01-\xcf\xd8-\xfe]")
_PNM = re.compile(rb"P([56])(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,5})\s")
_PNM_HEAD = 4096  # bytes; comments may be long, and a file of nothing but blanks longer
_TIFF_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 7: 1}
_TIFF_TAGS = frozenset({256, 257, 258, 259, 262, 273, 277, 279, 324, 325})
_AT_ONCE = 1 << 20  # bytes
_TIFF_DEFLATE = frozenset({8, 32946})
_EXIF_POINTER = frozenset({0x8769})
_EXIF_TIMES = frozenset({0x9003, 0x9011, 0x9291})
_PNG_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 4, 6: 4}  # as decoded: a palette and grey with alpha are widened

MAX_PARTS = 100_000
"""More segments or chunks than this are no picture of a camera, but work for its own sake."""
MAX_SCANS = 32
"""Progressive JPEGs have some ten scans; each is a pass over the whole picture."""


class DamagedError(ValueError):
    """The bytes are not a whole picture; the text says what is wrong with them."""


@dataclass(frozen=True)
class Header:
    """Kind and size of a picture, px.

    Args:
        kind: name of the format.
        width: columns.
        height: rows.
        full_scale: sample value of white where the file states it.
        pixel_bytes: what one pixel takes when it is decoded.
        padding: zero bytes at the end of a JPEG's last scan.
    """

    kind: str
    width: int
    height: int
    full_scale: int | None = None
    pixel_bytes: int = 3
    padding: int = 0


def read_header(data: bytes) -> Header:
    """Walk a file's structure from its first byte to its last.

    Raises:
        DamagedError: not a known kind, cut off, or contradicting itself.
    """
    if not data:
        raise DamagedError("is empty")
    if data.startswith(b"\xff\xd8"):
        return _jpeg(data)
    if data.startswith(_PNG_SIGNATURE):
        return _png(data)
    if data[:4] in {b"II*\0", b"MM\0*"}:
        return _tiff(data)
    if data[:2] in {b"P5", b"P6"}:
        return _pnm(data)
    raise DamagedError("is not a JPEG, PNG, TIFF or binary PGM/PPM picture")


def exif_taken(data: bytes) -> tuple[str, str | None, str | None] | None:
    """DateTimeOriginal, SubSecTimeOriginal and OffsetTimeOriginal of a JPEG, as written; None where there is none."""
    try:
        for marker, body, _ in _jpeg_segments(data):
            if marker == 0xE1 and body.startswith(b"Exif\0\0"):
                return _exif_of_tiff(body[6:])
    except DamagedError:
        return None
    return None


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Markers with their segments up to the end of the image, and where each begins; scans are passed over."""
    at = 2
    for _ in range(MAX_PARTS):
        if at + 2 > len(data):
            raise DamagedError("is cut off: the JPEG ends before its end marker")
        if data[at] != 0xFF:
            raise DamagedError(f"is damaged: no JPEG marker at byte {at}")
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        if marker == 0xD9:
            yield marker, b"", at
            return
        at += 2
        if marker in _JPEG_LONE:
            continue
        if at + 2 > len(data):
            raise DamagedError("is cut off: the JPEG ends before its end marker")
        (length,) = struct.unpack_from(">H", data, at)
        if length < 2 or at + length > len(data):
            raise DamagedError(f"is cut off: a JPEG segment at byte {at} leaves the file")
        yield marker, data[at + 2 : at + length], at - 2
        at += length
        if marker == 0xDA:
            end = _END_OF_SCAN.search(data, at)
            if end is None:
                raise DamagedError("is cut off: the JPEG ends before its end marker")
            at = end.end() - 2
    raise DamagedError(f"has more than {MAX_PARTS} JPEG segments")


def _jpeg(data: bytes) -> Header:
    size: tuple[int, int] | None = None
    scans = end = 0
    for marker, body, end in _jpeg_segments(data):  # noqa: B007 - the last one is the end of the image
        if marker in _JPEG_SOF and size is None:
            if len(body) < 6:
                raise DamagedError("is damaged: its JPEG frame header is too short")
            height, width = struct.unpack_from(">HH", body, 1)
            size = width, height
        scans += marker == 0xDA
        if scans > MAX_SCANS:
            raise DamagedError(f"has more than {MAX_SCANS} JPEG scans")
    if size is None or not scans:
        raise DamagedError("is damaged: a JPEG without picture data")
    # before a marker any number of ff may stand (T.81, B.1.1.2)
    last = data[max(0, end - 1000) : end].rstrip(b"\xff")
    return Header("JPEG", *size, padding=len(last) - len(last.rstrip(b"\0")))


def _png(data: bytes) -> Header:
    at, size, pixels, pixel_bytes = len(_PNG_SIGNATURE), None, 0, 0
    for _ in range(MAX_PARTS):
        if at + 12 > len(data):
            raise DamagedError("is cut off: the PNG ends before its end chunk")
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            raise DamagedError(f"is cut off: PNG chunk {_word(kind)} at byte {at} leaves the file")
        if zlib.crc32(data[at + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise DamagedError(f"is damaged: PNG chunk {_word(kind)} at byte {at} fails its checksum")
        if size is None:
            if kind != b"IHDR" or length != 13:
                raise DamagedError("is damaged: a PNG that does not begin with its header")
            size = struct.unpack_from(">II", data, at + 8)
            depth, colour = data[at + 16], data[at + 17]
            pixel_bytes = _PNG_CHANNELS.get(colour, 4) * (2 if depth > 8 else 1)
        pixels += kind == b"IDAT"
        if kind == b"IEND":
            if not pixels:
                raise DamagedError("is damaged: a PNG without picture data")
            return Header("PNG", size[0], size[1], pixel_bytes=pixel_bytes)
        at = end
    raise DamagedError(f"has more than {MAX_PARTS} PNG chunks")


def _word(kind: bytes) -> str:
    return kind.decode("ascii") if kind.isalpha() else "?"


def _pnm(data: bytes) -> Header:
    head = _PNM.match(data[:_PNM_HEAD])
    if head is None:
        raise DamagedError("is damaged: its PGM/PPM header cannot be read")
    width, height, white = (int(head[i]) for i in (2, 3, 4))
    if not 0 < white <= 65535:
        raise DamagedError(f"is damaged: its PGM/PPM maximum is {white}")
    pixel_bytes = (1 if head[1] == b"5" else 3) * (1 if white < 256 else 2)
    wanted = width * height * pixel_bytes
    got = len(data) - head.end()
    if got < wanted:
        raise DamagedError(f"is cut off: {got} of {wanted} bytes of picture data")
    if got > wanted:  # where they came in nobody knows: all behind them is shifted
        raise DamagedError(f"is damaged: {got - wanted} bytes more than its {wanted} of picture data")
    return Header("PGM" if head[1] == b"5" else "PPM", width, height, white, pixel_bytes)


def _tiff(data: bytes) -> Header:
    tags = _ifd(data, None, _TIFF_TAGS)
    try:
        width, height = tags[256][0], tags[257][0]
        offsets, counts = tags.get(273) or tags[324], tags.get(279) or tags[325]
    except (KeyError, IndexError):
        raise DamagedError("is damaged: a TIFF without size or picture data") from None
    if len(offsets) != len(counts) or any(o + n > len(data) for o, n in zip(offsets, counts, strict=True)):
        raise DamagedError("is cut off: TIFF picture data leaves the file")
    bits = max(tags.get(258) or (1,), default=1)
    samples = max(tags.get(277) or (1,), default=1)
    palette = 3 in (tags.get(262) or ())
    if not _TIFF_DEFLATE.isdisjoint(tags.get(259) or ()):
        parts = (data[o : o + n] for o, n in zip(offsets, counts, strict=True))
        _check_sums(parts, (width + 1024) * (height + 1024) * -(-bits // 8) * samples)
    return Header("TIFF", width, height, pixel_bytes=max(3 if palette else 1, -(-bits // 8) * samples))


def _check_sums(parts: Iterator[bytes], most: int) -> None:
    """Refuse deflated data that fail the checksum at their end: libtiff does not read as far.

    Args:
        parts: each with a checksum of its own.
        most: bytes that they may unpack to; tiles may reach over the picture's edge.
    """
    for part in parts:
        unpacker = zlib.decompressobj()
        left = part
        while not unpacker.eof:
            try:
                unpacked = len(unpacker.decompress(left, _AT_ONCE))
            except zlib.error:
                raise DamagedError("is damaged: its deflated data fail their checksum") from None
            left = unpacker.unconsumed_tail
            most -= unpacked
            if most < 0 or not (unpacked or unpacker.eof):
                raise DamagedError("is damaged: its deflated data are of another size than the picture")


def _exif_of_tiff(data: bytes) -> tuple[str, str | None, str | None] | None:
    if data[:4] not in {b"II*\0", b"MM\0*"}:
        return None
    pointer = _ifd(data, None, _EXIF_POINTER).get(0x8769)
    if not pointer:
        return None
    exif = _ifd(data, pointer[0], _EXIF_TIMES)
    taken = _text(exif.get(0x9003))
    return None if taken is None else (taken, _text(exif.get(0x9291)), _text(exif.get(0x9011)))


def _text(values: tuple[int, ...] | None) -> str | None:
    if values is None or any(value > 255 for value in values):  # numbers where text belongs
        return None
    return bytes(values).split(b"\0")[0].decode("ascii", "replace").strip() or None


def _ifd(data: bytes, at: int | None, wanted: frozenset[int]) -> dict[int, tuple[int, ...]]:
    """Those tags of an image file directory that hold whole numbers or text (text as its bytes).

    A tag that comes twice counts the first time, as libtiff has it. Others than the wanted are not even looked at: each
    of sixty thousand entries may claim the whole file for its value.
    """
    order = "<" if data[:2] == b"II" else ">"
    try:
        where = struct.unpack_from(order + "I", data, 4)[0] if at is None else at
        (entries,) = struct.unpack_from(order + "H", data, where)
        tags: dict[int, tuple[int, ...]] = {}
        for i in range(entries):
            tag, kind, count = struct.unpack_from(order + "HHI", data, where + 2 + 12 * i)
            width = _TIFF_SIZES.get(kind)
            if tag not in wanted or tag in tags or width is None or width * count > len(data):
                continue
            place = where + 10 + 12 * i
            if width * count > 4:
                place = struct.unpack_from(order + "I", data, place)[0]
            tags[tag] = struct.unpack_from(f"{order}{count}{'BHI'[width // 2]}", data, place)
    except struct.error:
        raise DamagedError("is cut off: a TIFF directory leaves the file") from None
    return tags
