"""When a picture file was taken: from its name, else its EXIF, else its modification time. Always UTC.

A name or an EXIF without an offset is taken as UTC: a node's camera has no other clock, and a guess of the local zone
would be wrong twice a year.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Literal

from sagnode.capture.headers import exif_taken

Origin = Literal["name", "exif", "modified"]

_NAME = re.compile(
    r"(?<!\d)(\d{4})[-_.]?(\d{2})[-_.]?(\d{2})[T_ -]?(\d{2})[-_:.h]?(\d{2})[-_:.m]?(\d{2})"
    r"(?:[.,](\d{1,6}))?(\+\d{2}:?\d{2})?(?!\d)"
)
_EXIF = re.compile(r"(\d{4}):(\d{2}):(\d{2}) (\d{2}):(\d{2}):(\d{2})")
_OFFSET = re.compile(r"([+-])(\d{2}):?(\d{2})")
_EXIF_LIMIT = 256 * 1024  # EXIF stands in the first segments, each at most 64 KiB


def taken_at(path: Path) -> tuple[datetime, Origin]:
    """Time of a picture file, and where it was found.

    Names are such as ``20260621T113000Z.png`` or ``cam1_2026-06-21_11-30-00.5.jpg``.

    Raises:
        OSError: the file is gone or cannot be read.
    """
    named = name_time(path.stem)
    if named is not None:
        return named, "name"
    if path.suffix.lower() in {".jpg", ".jpeg"}:
        with path.open("rb") as file:
            exif = exif_time(file.read(_EXIF_LIMIT))
        if exif is not None:
            return exif, "exif"
    return datetime.fromtimestamp(path.stat().st_mtime, UTC), "modified"


def name_time(stem: str) -> datetime | None:
    """The time in a file name without its extension, or None."""
    found = _NAME.search(stem)
    if found is None:
        return None
    return _time(found.groups()[:6], found[7], found[8])


def exif_time(data: bytes) -> datetime | None:
    """DateTimeOriginal of a JPEG's first bytes, or None."""
    exif = exif_taken(data)
    if exif is None:
        return None
    original, fraction, offset = exif
    found = _EXIF.fullmatch(original)
    return None if found is None else _time(found.groups(), fraction, offset)


def _time(parts: tuple[str | None, ...], fraction: str | None, offset: str | None) -> datetime | None:
    """UTC of year, month, day, hour, minute, second with a decimal fraction; None where that is no date."""
    try:
        year, month, day, hour, minute, second = (int(part or "") for part in parts)
        micro = int((fraction or "").strip()[:6].ljust(6, "0")) if fraction else 0
        zone = _zone(offset)
        return datetime(year, month, day, hour, minute, second, micro, tzinfo=zone).astimezone(UTC)
    except (ValueError, OverflowError):
        return None


def _zone(offset: str | None) -> timezone:
    found = _OFFSET.fullmatch(offset or "")
    if found is None:
        return UTC
    ahead = timedelta(hours=int(found[2]), minutes=int(found[3]))
    return timezone(ahead if found[1] == "+" else -ahead)
