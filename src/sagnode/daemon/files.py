"""Small files that survive a power cut: written beside, synchronised, renamed, and the directory synchronised too."""

from __future__ import annotations

import os
from pathlib import Path


def write_atomic(path: Path, text: str, *, durable: bool = True) -> None:
    """Replace a file in one step; readers see the old or the new one, never half of either.

    Args:
        path: the file.
        text: its new content.
        durable: also force it to the disk; leave out for what may be lost with the power, such as a status page.

    Raises:
        OSError: the disk is full, read-only or gone.
    """
    beside = path.with_name(path.name + ".part")
    with beside.open("w", encoding="utf-8") as stream:
        stream.write(text)
        if durable:
            stream.flush()
            os.fsync(stream.fileno())
    beside.replace(path)
    if durable:
        sync_directory(path.parent)


def sync_directory(directory: Path) -> None:
    """Force a directory's entries to the disk; a rename is only then sure."""
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
