"""The directory of overlays: the latest of each conductor, in memory where systemd gives a runtime directory."""

from __future__ import annotations

import logging
from pathlib import Path

from sagnode.daemon.logs import Seldom
from sagnode.daemon.machine import Machine

log = logging.getLogger(__name__)

RESERVE_MB = 50.0
"""Below this much free space there are no pictures: the journal needs it more."""
RESERVE_SHARE = 0.25
"""On a small file system, such as the one in memory, so much of it is the reserve."""


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
        if self._lacking_mb() > 0:
            free = self._machine.disk_free_mb(self._directory)
            self._complaints.error(f"pictures {self._directory}: only {free:.0f} MB free; readings go on without them")
            return None
        return self._directory

    def _thin_out(self) -> None:
        """Delete the oldest until the rest keep to the quota and leave the reserve free."""
        # Half-written ones count too: a full disk, or a killed worker, leaves them.
        files = sorted((f.stat().st_mtime, f.stat().st_size, f) for f in self._directory.glob("*.jpg*"))
        surplus = max(sum(size for _, size, _ in files) - self._quota, self._lacking_mb() * 1e6)
        for _, size, file in files:
            if surplus <= 0:
                break
            file.unlink(missing_ok=True)
            surplus -= size

    def _lacking_mb(self) -> float:
        """So much is missing from the reserve; 0 when it is free, or nobody knows."""
        free = self._machine.disk_free_mb(self._directory)
        size = self._machine.disk_size_mb(self._directory)
        if free is None or size is None:
            return 0.0
        return max(0.0, min(RESERVE_MB, RESERVE_SHARE * size) - free)
