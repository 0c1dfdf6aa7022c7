"""Sequence numbers that never repeat, even when the journal that counted them is lost.

A small file beside the journal holds a ceiling: every number up to it may have been used. It is raised by a block,
and forced to the disk, before a number above it is given out; one write for a thousand readings. Normally the journal
itself says which number is next. When it is damaged, missing or older than the file, counting goes on above the
ceiling: a consumer sees a gap, never the same number twice. So it does after a power cut: a card that says "written"
too early may have forgotten the last readings, and nothing in the file tells. The ceiling is raised by another block
before a journal that is not trusted is opened or mended, for a kill in the midst leaves one that looks trustworthy.
"""

from __future__ import annotations

import contextlib
import zlib
from pathlib import Path

from sagnode.daemon.files import write_atomic

BLOCK = 1000
_GREATEST = 2**53
"""The greatest whole number that every reader of JSON knows exactly."""


class Ceiling:
    """The file with the ceiling.

    Args:
        path: where it is kept; two copies, so that one damaged file is no harm.
        elsewhere: where it is kept too, on another disk, as far as that one takes it.
    """

    def __init__(self, path: Path, elsewhere: Path | None = None) -> None:
        self._paths = _copies(path)
        self._elsewhere = _copies(elsewhere) if elsewhere else ()
        self._here = max(_read(p) for p in self._paths)
        self.value = max(self._here, *(_read(p) for p in self._elsewhere), 0)
        """Numbers up to this one may have been used; 0 on a new node."""
        self._floor: int | None = None

    def cover(self, number: int) -> None:
        """Raise the ceiling so that ``number`` may be used.

        Raises:
            OSError: the disk refuses; the number must not be used.
        """
        if number > self._here:
            value = max(self.value, -(-number // BLOCK) * BLOCK)
            text = f"{value} {_check(value)}\n"
            for path in self._paths:
                write_atomic(path, text)
            with contextlib.suppress(OSError):
                for path in self._elsewhere:
                    write_atomic(path, text)
            self.value = self._here = value

    def distrust(self) -> None:
        """The journal may not hold everything that was ever committed to it: go on above all that may have been used.

        Durable before anything is done to the journal, for whoever opens what a half-done repair leaves cannot tell.

        Raises:
            OSError: the disk refuses.
        """
        if self._floor is None:
            floor = self.value
            self.cover(floor + 1)
            self._floor = floor

    def next_after(self, newest: int | None) -> int:
        """The next number to use; ``newest`` is the highest one in the journal, None when it is empty or gone."""
        following = (newest or 0) + 1
        if self._floor is not None:
            return max(following, self._floor + 1)
        # In a journal that has everything the newest number lies in the last block that was set apart.
        return following if following > self.value - BLOCK else self.value + 1


class Marks:
    """Whether the journal was closed in an orderly way, or its process ended with the power.

    Args:
        path: a small file that is there, with the boot's id, while the journal is open.
        boot_id: of this boot; empty when it is not known, and then nothing is told.
    """

    def __init__(self, path: Path, boot_id: str) -> None:
        self._path = path
        self._boot_id = boot_id
        self.power_failed = False
        """Another boot of the machine left the journal open."""
        with contextlib.suppress(OSError, ValueError):
            self.power_failed = bool(boot_id) and path.read_text(encoding="ascii").strip() != boot_id

    def opened(self) -> None:
        """The journal is open, and numbers go on above what the power may have taken; :class:`OSError` is no harm."""
        self.power_failed = False
        if self._boot_id:
            with contextlib.suppress(OSError):
                write_atomic(self._path, f"{self._boot_id}\n")

    def closed(self) -> None:
        """Everything is on the disk."""
        if self._boot_id:
            with contextlib.suppress(OSError):
                self._path.unlink(missing_ok=True)


def _copies(path: Path) -> tuple[Path, Path]:
    return path, path.with_name(path.name + ".copy")


def _read(path: Path) -> int:
    try:
        value, *check = path.read_text(encoding="ascii").split()
        number = int(value)
    except (OSError, ValueError):
        return 0
    # A digit that flips would let the count leap, or go back; a file without its checksum is refused the leap alone.
    sound = check == [_check(number)] if check else True
    return number if sound and 0 <= number <= _GREATEST else 0


def _check(value: int) -> str:
    return f"{zlib.crc32(str(value).encode()):08x}"
