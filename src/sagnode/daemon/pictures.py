"""The directory of overlays: the latest of each conductor, in memory where systemd gives a runtime directory."""

from __future__ import annotations

import logging
from pathlib import Path

from sagnode.daemon.logs import Seldom
from sagnode.daemon.machine import Machine

log = logging.getLogger(__name__)

RESERVE_MB = 50.0
"""Below this much free space no pictures are written: the journal needs it more."""


class Pictures:
    """Says where the worker may write overlays, and keeps them within their quota.

    Args:
        directory: theirs alone.
        quota_mb: the oldest go when all together are larger.
        machine: for free space.
    """

    def __init__(self, directory: Path, quota_mb: float, machine: Machine) -> None:
        self._directory = directory
        self._quota = quota_mb * 1e6
        self._machine = machine
        self._complaints = Seldom(log)

    def room(self) -> Path | None:
        """The directory, or None when there is no room for pictures now."""
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            self._thin_out()
        except OSError as error:
            self._complaints.error(f"pictures {self._directory}: {error.strerror}; readings go on without them")
            return None
        free = self._machine.disk_free_mb(self._directory)
        if free is not None and free < RESERVE_MB:
            self._complaints.error(f"pictures {self._directory}: only {free:.0f} MB free; readings go on without them")
            return None
        return self._directory

    def _thin_out(self) -> None:
        files = sorted((f.stat().st_mtime, f.stat().st_size, f) for f in self._directory.glob("*.jpg"))
        total = sum(size for _, size, _ in files)
        for _, size, file in files:
            if total <= self._quota:
                break
            file.unlink(missing_ok=True)
            total -= size
