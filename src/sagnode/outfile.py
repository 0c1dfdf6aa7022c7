"""Files that a user asked for: whole under their name, or not there under it."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, BinaryIO, TextIO


def whole(path: Path) -> AbstractContextManager[BinaryIO]:
    """A stream into a file beside ``path``, which takes its place at the end; what fails before leaves that as it was.

    Links are followed. A pipe or a device, as /dev/stdout, is written to as it stands.

    Raises:
        OSError: the disk does not take it.
    """
    return _whole(path, "wb")


def whole_text(path: Path, *, keep_interrupted: bool = False) -> AbstractContextManager[TextIO]:
    """The same for text in UTF-8 with the newlines that are written.

    Args:
        path: the file.
        keep_interrupted: what there is takes its place when the user interrupts, too.

    Raises:
        OSError: the disk does not take it.
    """
    return _whole(path, "w", keep_interrupted=keep_interrupted, encoding="utf-8", newline="")


@contextlib.contextmanager
def _whole(path: Path, mode: str, *, keep_interrupted: bool = False, **how: Any) -> Iterator[Any]:
    place = Path(os.path.realpath(path))
    if path.absolute().is_relative_to("/dev") or (place.exists() and not place.is_file()):
        with path.open(mode, **how) as stream:
            yield stream
        return
    beside = place.with_name(f".{place.name}.{os.getpid()}.part")
    try:
        with beside.open(mode, **how) as stream:
            interrupted = None
            try:
                yield stream
            except KeyboardInterrupt as interrupt:
                if not keep_interrupted:
                    raise
                interrupted = interrupt
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(place)
    finally:
        # where all went well there is no such file any more
        with contextlib.suppress(OSError):
            beside.unlink()
    if interrupted is not None:
        raise interrupted
