"""The page that a daemon shows of itself (``status.json``): its shape, and which file of it counts.

Whoever asks may be of another version than the daemon that wrote it, and a file may hold anything; so it is looked over
before it is believed. Imports nothing that takes time.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sagnode.daemon.places import SERVICE_RUNTIME, runtime_directory

STATUS_FILE = "status.json"
STATUS_SCHEMA = "sagnode.status-file/1"


@dataclass(frozen=True)
class Shown:
    """What the daemon with a state directory has written."""

    page: dict[str, Any] | None
    """None where there is none that can be understood."""
    directory: Path | None = None
    """Where it lies."""
    not_understood: Path | None = None
    """A page that was written here by another version, or is damaged; where there is no other one."""


def find_page(state_dir: Path) -> Shown:
    """The newest page of the daemon with this state directory."""
    found: list[Shown] = []
    not_understood = None
    for directory in (state_dir, runtime_directory(), SERVICE_RUNTIME):
        if directory is None:
            continue
        file = directory / STATUS_FILE
        page = None
        with contextlib.suppress(OSError):
            text = file.read_text(encoding="utf-8", errors="replace")
            with contextlib.suppress(ValueError, RecursionError):
                page = json.loads(text)
            named = page.get("state_dir") if isinstance(page, dict) else None
            if directory != state_dir and named != str(state_dir.absolute()):
                continue
            if _fits(page, _PAGE):
                found.append(Shown(page, directory))
            else:
                not_understood = not_understood or file
    best = max(found, key=lambda shown: float(shown.page["written_at"]) if shown.page else 0.0, default=None)
    return best or Shown(None, not_understood=not_understood)


# -- its shape: a test of the value, a dictionary of those that are needed, or a list of one for all its members.
# A key with a question mark may be absent or null.


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _flag(value: object) -> bool:
    return isinstance(value, bool)


def _text(value: object) -> bool:
    return isinstance(value, str)


def _time(value: object) -> bool:
    with contextlib.suppress(ValueError, OverflowError):
        return isinstance(value, str) and datetime.fromisoformat(value).tzinfo is not None
    return False


Shape = Callable[[object], bool] | dict[str, Any] | list[Any]

_READING: Shape = {
    "acquired_at": _time,
    "recorded_monotonic_s": _number,
    "validity": _text,
    "reasons": [{"cause": _text, "text": _text}],
    "landmarks_by_appearance?": _number,
    **{f"{stem}_{part}?": _number for stem in ("sag", "clearance") for part in ("m", "lo", "hi")},
}
_LANDMARKS: Shape = {
    "reference_taken_at?": _time,
    "reference_taken_from?": _text,
    "appearances": _number,
    "oldest_at?": _time,
    "newest_at?": _time,
}
_HEALTH: Shape = {
    "broker": _text,
    "journal": _text,
    "configuration": _text,
    "disk_free_mb?": _number,
    "throttled?": _flag,
    "uptime_s?": _number,
    "trend?": _text,
    "delivery?": _text,
    "camera?": _text,
    "lens?": {"text": _text},
    "landmarks?": _LANDMARKS,
    "certificate_ends_at?": _time,
    "outbox_depth?": _number,
    "outbox_oldest_s?": _number,
    "memory_available_mb?": _number,
    "cpu_temperature_c?": _number,
    "readings_made": _number,
    "readings_invalid": _number,
}
_PAGE: Shape = {
    "schema_version": lambda value: value == STATUS_SCHEMA,
    "state": _text,
    "pid": _number,
    "unit": {"utility": _text, "line": _text, "span": _text, "unit": _text},
    "written_at": _number,
    "written_monotonic_s": _number,
    "now": _time,
    "virtual_clock": _flag,
    "clock": {"synced": _flag, "source": _text},
    "next_slot?": _time,
    "gap_s?": _number,
    "deadline_s": _number,
    "broker_connected?": _flag,
    "waiting_in_memory": _number,
    "conductors": [_text],
    "readings": lambda value: isinstance(value, dict) and all(_fits(one, _READING) for one in value.values()),
    "alarms?": [{"kind": _text, "conductor": _text, "since": _time, "text": _text}],
    "health": _HEALTH,
}


def _fits(value: object, shape: Shape) -> bool:
    if isinstance(shape, list):
        return isinstance(value, list) and all(_fits(one, shape[0]) for one in value)
    if isinstance(shape, dict):
        return isinstance(value, dict) and all(_has(value, key, inner) for key, inner in shape.items())
    return shape(value)


def _has(value: dict[str, Any], key: str, shape: Shape) -> bool:
    name = key.removesuffix("?")
    if name != key and value.get(name) is None:
        return True
    return name in value and _fits(value[name], shape)
