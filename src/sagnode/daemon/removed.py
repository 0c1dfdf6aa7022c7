"""A journal whose file was removed, or replaced by another, while it was open.

SQLite goes on with the file that it has open and says nothing, and all of it is gone with the process. So the journal
looks before it writes, and puts back what is in the open file.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from sagnode.daemon import journal_table as table
from sagnode.daemon.files import sync_directory
from sagnode.daemon.journal_file import remove


class Removal:
    """Watches the name of an open journal.

    Args:
        path: the journal's file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(f"{path.name}.part")
        self._copy = path.with_name(f"{path.name}.removed")
        """Whole, and on the disk."""
        self._opened: tuple[int, int] | None = None

    def opened(self) -> None:
        """The file of this name is the one that is open."""
        self._opened = _identity(self._path)

    def happened(self) -> bool:
        """Whether the name stands for nothing, or for another file; on another disk it says nothing of this one."""
        if self._opened is None or _identity(self._path) == self._opened:
            return False
        directory = _identity(self._path.parent)
        return directory is None or directory[0] == self._opened[0]

    def save(self, db: sqlite3.Connection) -> None:
        """Copy what is in the open file, whose name is gone.

        Raises:
            OSError, sqlite3.Error: the disk refuses.
        """
        remove(self._part)
        db.execute("VACUUM INTO ?", (str(self._part),))
        with self._part.open("rb") as stream:
            os.fsync(stream.fileno())
        self._part.rename(self._copy)
        sync_directory(self._path.parent)

    def put_back(self) -> bool:
        """Before the journal is opened: give the copy its name, where nothing else has it; whether that was done.

        Raises:
            OSError: the disk refuses.
        """
        if self._path.exists() or not self._copy.exists():
            return False
        remove(self._path)  # a log of the removed file is in the copy, and would be taken for the copy's own
        self._copy.rename(self._path)
        sync_directory(self._path.parent)
        return True

    def rows(self, chunk: int) -> Iterator[list[tuple[Any, ...]]]:
        """What the copy holds, where another file has the name.

        Raises:
            sqlite3.Error: it cannot be read.
        """
        if self._copy.exists():
            with closing(sqlite3.connect(self._copy, isolation_level=None)) as db:
                yield from table.sound_rows(db, chunk)

    def forget(self) -> None:
        """All of it is in the journal.

        Raises:
            OSError: the disk refuses.
        """
        remove(self._copy)


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino
