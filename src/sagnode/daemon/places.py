"""Where a node keeps things; imported by ``sagnode status`` too, so it imports next to nothing."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

from sagnode.errors import ConfigError

JOURNAL = "journal.sqlite"
"""In the state directory."""
SERVICE_CONFIG = Path("/etc/sagnode")
"""Where the installed service has its configuration."""
VOLATILE = "volatile"
"""In the runtime directory: stands in for a state directory that is of no use."""
SERVICE_STATE = Path("/var/lib/sagnode")
"""Where the installed service keeps its state; looked at when the user has none of his own."""
SERVICE_RUNTIME = Path("/run/sagnode")


def configuration(named: Path | None) -> Path:
    """What ``--config`` names, else the installed service's.

    Raises:
        ConfigError: nothing is named, and no service is installed.
    """
    if named is None and not SERVICE_CONFIG.exists():
        raise ConfigError(f"{SERVICE_CONFIG}: no such file or directory", "name the node file with --config")
    return named or SERVICE_CONFIG


def state_directory(configured: Path | None) -> Path:
    """Of the configuration, else systemd's, else the user's."""
    if configured is not None:
        return configured
    return _given_state() or Path.home() / ".local" / "state" / "sagnode"


def other_service_state(state_dir: Path) -> Path | None:
    """The state directory that systemd gives, where the configuration names another one."""
    given = _given_state()
    return given if given is not None and given.absolute() != state_dir.absolute() else None


def _given_state() -> Path | None:
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None


def runtime_directory() -> Path | None:
    """The directory in memory that systemd gives, where there is one."""
    given = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None


def usual_state_dir() -> Path:
    """The user's own, or the installed service's where the user has none."""
    own = state_directory(None)
    return own if own.is_dir() or not SERVICE_STATE.is_dir() else SERVICE_STATE


def configured_state_dir(path: Path) -> Path:
    """From the node file alone, unchecked: who asks how a node is must be answered although its files are broken.

    Raises:
        ConfigError: the file cannot be read, or is not TOML.
    """
    file = path / "node.toml" if path.is_dir() else path
    try:
        storage = tomllib.loads(file.read_text(encoding="utf-8")).get("storage", {})
    except OSError as error:
        raise ConfigError(f"{file}: {error.strerror}", "give the node file, or --state-dir") from error
    except ValueError as error:
        raise ConfigError(f"{file}: {error}", f"mend it; see: sagnode config check --config {file}") from error
    named = storage.get("state_dir") if isinstance(storage, dict) else None
    if isinstance(named, str):
        return file.absolute().parent / named
    return usual_state_dir()
