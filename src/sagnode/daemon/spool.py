"""Readings that the journal's disk refuses, kept in a small file elsewhere so that they outlive the process.

One burst a line with a checksum before it; a line that was cut short by a kill is passed over. The directory is the
one in memory that systemd gives (``RuntimeDirectoryPreserve=yes`` keeps it over a restart of the service); without it
the state directory, which may refuse too: then the readings are in the process's memory only, and health says so.
"""

from __future__ import annotations

import json
import logging
import zlib
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from sagnode.daemon.logs import Seldom
from sagnode.message import Reading, ReadingHeader

log = logging.getLogger(__name__)

SPOOL_MAX_BYTES = 16_000_000


class Spool:
    """The file.

    Args:
        path: of it; its directory exists.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._complaints = Seldom(log)

    def keep(self, readings: Sequence[ReadingHeader]) -> bool:
        """Add a burst; False when this place refuses too."""
        text = json.dumps([reading.model_dump_json() for reading in readings])
        line = f"{zlib.crc32(text.encode()):08x} {text}\n".encode()
        try:
            if self._path.exists() and self._path.stat().st_size + len(line) > SPOOL_MAX_BYTES:
                raise OSError(27, "it is as large as it may become")
            with self._path.open("ab", buffering=0) as stream:
                return stream.write(line) == len(line)
        except OSError as error:
            self._complaints.error(f"{self._path}: {error.strerror}; readings wait in the process's memory only")
            return False

    def load(self) -> list[list[ReadingHeader]]:
        """The bursts that another process left here, oldest first."""
        try:
            lines = self._path.read_bytes().split(b"\n")
        except FileNotFoundError:
            return []
        except OSError as error:
            log.error("%s: %s; what it holds is not read", self._path, error.strerror)
            return []
        return [burst for line in lines if (burst := _burst(line))]

    def clear(self) -> None:
        """All of it is in the journal."""
        try:
            self._path.unlink(missing_ok=True)
        except OSError as error:
            # What is read again at the next start is found in the journal then, and not recorded twice.
            self._complaints.error(f"{self._path}: {error.strerror}; it stays")


def _burst(line: bytes) -> list[ReadingHeader]:
    crc, _, text = line.partition(b" ")
    if not text or f"{zlib.crc32(text):08x}".encode() != crc:
        return []
    try:
        return [Reading.model_validate_json(reading) for reading in json.loads(text)]
    except (ValidationError, ValueError, TypeError, RecursionError):  # written by another version
        log.error("a burst in the spool is not understood; passed over")
        return []
