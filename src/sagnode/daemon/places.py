"""Where a node keeps things; imported by ``sagnode status`` too, so it imports next to nothing."""

from __future__ import annotations

import os
from pathlib import Path


def state_directory(configured: Path | None) -> Path:
    """Of the configuration, else systemd's, else the user's."""
    if configured is not None:
        return configured
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else Path.home() / ".local" / "state" / "sagnode"


def runtime_directory() -> Path | None:
    """The directory in memory that systemd gives, where there is one."""
    given = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None
