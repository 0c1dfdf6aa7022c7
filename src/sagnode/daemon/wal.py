"""Whether a write-ahead log lost committed transactions to damage, which SQLite itself passes over in silence.

SQLite replays frames up to the first whose checksum fails and takes the rest for a torn tail. When a frame behind that
point still bears the log's own salts, something was there that is not any more: with ``synchronous=FULL`` that may be a
committed reading. Format: https://www.sqlite.org/fileformat2.html#the_write_ahead_log
"""

from __future__ import annotations

import struct
from pathlib import Path

_HEADER = 32
_FRAME_HEADER = 24
_MAGIC = {0x377F0682: "<", 0x377F0683: ">"}  # the last bit says how the checksums read their words


def lost_frames(path: Path) -> bool:
    """True when the log at ``path`` holds frames of its own generation that SQLite will not replay."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return False
    if len(data) < _HEADER + _FRAME_HEADER:
        return False
    magic, _, page, _, salt1, salt2, check1, check2 = struct.unpack(">8I", data[:_HEADER])
    order = _MAGIC.get(magic)
    if order is None or page not in {2**n for n in range(9, 17)}:
        return True  # frames follow a header that cannot be read
    sums = _checksum(data[: _HEADER - 8], (0, 0), order)
    if sums != (check1, check2):
        return True
    valid = True
    for start in range(_HEADER, len(data) - _FRAME_HEADER - page + 1, _FRAME_HEADER + page):
        frame = data[start : start + _FRAME_HEADER + page]
        _, _, s1, s2, c1, c2 = struct.unpack(">6I", frame[:_FRAME_HEADER])
        if s1 != salt1 and s2 != salt2:  # left over from before the last reset; one flipped salt does not hide a frame
            valid = False
            continue
        sums = _checksum(frame[_FRAME_HEADER:], _checksum(frame[:8], sums, order), order)
        if not valid or (s1, s2) != (salt1, salt2) or sums != (c1, c2):
            return True
    return False


def _checksum(data: bytes, start: tuple[int, int], order: str) -> tuple[int, int]:
    s0, s1 = start
    words = struct.unpack(f"{order}{len(data) // 4}I", data)
    for first, second in zip(words[::2], words[1::2], strict=True):
        s0 = (s0 + first + s1) & 0xFFFFFFFF
        s1 = (s1 + second + s0) & 0xFFFFFFFF
    return s0, s1
