"""Whether the disk is there that the state directory is meant to lie on.

A mount point whose disk is missing is an empty directory, and so is the state of a new node: counting would begin anew,
and what is recorded disappears below the disk when that comes back. Two things outside the disk know better: what
``/etc/fstab`` says should be mounted there, and a mark that the service leaves in its own directory when it finds the
state directory on another disk than that one. The mark is for mounts that fstab does not know.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from sagnode.daemon.files import write_atomic
from sagnode.errors import DiskError

FSTAB = Path("/etc/fstab")
_MARK = "state-disk"
_NO_DISKS = {"swap", "tmpfs", "proc", "sysfs", "overlay"}


class OwnDisk:
    """The disk of one state directory.

    Args:
        state_dir: the state directory.
        service_dir: another directory that the service has in any case; None where the state directory is that one.
        fstab: what is to be mounted, as in fstab(5).
    """

    def __init__(self, state_dir: Path, service_dir: Path | None = None, fstab: Path = FSTAB) -> None:
        self._state_dir = state_dir.resolve()
        self._mark = service_dir / _MARK if service_dir else None
        self._fstab = fstab

    def expect(self) -> None:
        """Look before anything is made in the state directory.

        Raises:
            DiskError: it would not lie on its disk.
        """
        for source, place in self._mounts():
            if not _is_mount_point(place):
                raise DiskError(
                    f"state directory {self._state_dir}: {source} is not mounted on {place}",
                    f"look whether the disk is there (lsblk) and mount it: mount {place}. What is kept in memory"
                    " follows within a minute, or when the service is restarted",
                )
        if self._mark is not None and self._marked() == str(self._state_dir) and not self._is_elsewhere():
            raise DiskError(
                f"state directory {self._state_dir}: the disk is missing on which it lay",
                f"mount it (lsblk, findmnt); or, if it is to lie here from now on, delete {self._mark} and restart"
                " the service",
            )

    def found(self) -> None:
        """The state directory is in use; remember whether it lies on a disk of its own. No disk's refusal is harm."""
        if self._mark is None:
            return
        with contextlib.suppress(OSError):
            if self._is_elsewhere() and self._marked() != str(self._state_dir):
                write_atomic(self._mark, f"{self._state_dir}\n")

    def _mounts(self) -> Iterator[tuple[str, Path]]:
        """Source and mount point of each line of fstab that the state directory lies below."""
        with contextlib.suppress(OSError, ValueError):
            for line in self._fstab.read_text(encoding="utf-8").splitlines():
                words = line.partition("#")[0].split()
                if len(words) < 3 or words[2] in _NO_DISKS or "bind" in ",".join(words[3:4]).split(","):
                    continue
                place = Path(_unescaped(words[1]))
                if place != Path("/") and self._state_dir.is_relative_to(place):
                    yield _unescaped(words[0]), place

    def _marked(self) -> str | None:
        with contextlib.suppress(OSError, ValueError):
            if self._mark is not None:
                return self._mark.read_text(encoding="utf-8").strip()
        return None

    def _is_elsewhere(self) -> bool:
        """Whether it lies on another file system than the service's own directory."""
        there = self._state_dir
        while not there.exists():
            there = there.parent
        return self._mark is not None and there.stat().st_dev != self._mark.parent.stat().st_dev


def _is_mount_point(place: Path) -> bool:
    """By the number of the file system alone: a service's own view of the disks has mounts that are none."""
    try:
        return place.stat().st_dev != place.parent.stat().st_dev
    except OSError:
        return False


def _unescaped(word: str) -> str:
    """Blanks and tabs stand in fstab as octal numbers."""
    for code, character in ((r"\040", " "), (r"\011", "\t"), (r"\134", "\\")):
        word = word.replace(code, character)
    return word
