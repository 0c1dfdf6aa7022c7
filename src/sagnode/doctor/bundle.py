"""One file that a person far away can help with: findings, configuration, logs, last readings and pictures.

Every text passes :func:`sagnode.doctor.redact.redact`; key files and password files are never opened for packing.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import subprocess
import tarfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sagnode.config.load import LoadedNode, examine
from sagnode.daemon.journal_reader import Rows, Wanted
from sagnode.daemon.places import runtime_directory
from sagnode.doctor.redact import redact
from sagnode.errors import JournalError, SagnodeError

READINGS = 500
LOG_LINES = 3000
PICTURES_MB = 16.0
_TEXTS = {".toml", ".yaml", ".yml", ".json", ".txt", ".conf"}
_TEXT_MB = 2.0


def write_bundle(file: Path, document: dict[str, Any], config: Path, state_dir: Path) -> int:
    """Write a ``.tar.gz`` that only its owner may read; it appears whole or not at all.

    Args:
        file: to be written; one that is there is replaced.
        document: the findings.
        config: node file or its directory.
        state_dir: of the node.

    Returns:
        Bytes written.

    Raises:
        SagnodeError: it cannot be written.
    """
    known = _secrets(config)
    part = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        # A name that nobody else has made, and a mode from the first byte on.
        handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
        with os.fdopen(handle, "wb") as raw, tarfile.open(fileobj=raw, mode="w:gz") as archive:
            for name, content in _contents(document, config, state_dir):
                data = content if isinstance(content, bytes) else redact(content, known).encode()
                entry = tarfile.TarInfo(f"sagnode-bundle/{name}")
                entry.size, entry.mtime, entry.mode = len(data), int(time.time()), 0o600
                archive.addfile(entry, io.BytesIO(data))
        size = part.stat().st_size
        part.replace(file)
    except OSError as error:
        raise SagnodeError(f"bundle {file} cannot be written: {error.strerror}", "name another file") from error
    finally:
        part.unlink(missing_ok=True)
    return size


def _contents(document: dict[str, Any], config: Path, state_dir: Path) -> Iterator[tuple[str, str | bytes]]:
    yield "doctor.json", json.dumps(document, indent=2, ensure_ascii=False)
    yield from _configuration(config)
    runtime = runtime_directory() or Path("/run/sagnode")
    for place in (state_dir, runtime):
        text = _text(place / "status.json")
        if text is not None:
            yield f"status-{place.name}.json", text
    yield "readings.jsonl", _readings(state_dir / "journal.sqlite")
    for name, words in _COMMANDS:
        yield f"{name}.txt", _said(words)
    for name in ("proc/meminfo", "proc/uptime", "proc/loadavg", "proc/mounts", "etc/os-release", "proc/cmdline"):
        yield f"machine/{name.rpartition('/')[2]}", _text(Path("/") / name) or ""
    yield from _pictures((state_dir / "pictures", runtime / "pictures"))


_COMMANDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("log", ("journalctl", "--no-pager", "-o", "short-iso", "-u", "sagnode", "-n", str(LOG_LINES))),
    ("kernel", ("journalctl", "--no-pager", "-o", "short-iso", "-k", "-n", "500")),
    ("unit", ("systemctl", "--no-pager", "show", "sagnode")),
    ("unit-file", ("systemctl", "--no-pager", "cat", "sagnode")),
    ("clock", ("timedatectl", "show-timesync", "--all")),
    ("video-devices", ("v4l2-ctl", "--list-devices")),
    ("libcamera", ("rpicam-hello", "--list-cameras")),
    ("disks", ("df", "-h")),
)


def _configuration(config: Path) -> Iterator[tuple[str, str]]:
    """The files of the configuration's own directory that are text of a known kind; a broken one is packed too."""
    directory = config if config.is_dir() else config.absolute().parent
    files = [file for file in sorted(directory.iterdir()) if file.suffix in _TEXTS] if directory.is_dir() else []
    loaded = examine(config).loaded
    if isinstance(loaded, LoadedNode):
        files += [loaded.path, loaded.span_path, loaded.span.camera.intrinsics]
        withheld = loaded.node.mqtt.password_file if loaded.node.mqtt else None
        files = [file for file in files if file != withheld]
    for file in dict.fromkeys(file.absolute() for file in files):
        text = _text(file)
        if text is not None:
            yield f"configuration/{file.name}", text


def _secrets(config: Path) -> set[str]:
    """Values that must not be seen anywhere, as far as this user may read them."""
    loaded = examine(config).loaded
    if not isinstance(loaded, LoadedNode) or loaded.node.mqtt is None or loaded.node.mqtt.password_file is None:
        return set()
    text = _text(loaded.node.mqtt.password_file) or ""
    return {line.strip() for line in text.splitlines()}


def _text(file: Path) -> str | None:
    """Of a plain file of bearable size."""
    with contextlib.suppress(OSError):
        if file.is_file():
            with file.open("rb") as stream:
                return stream.read(int(_TEXT_MB * 1e6)).decode("utf-8", "replace")
    return None


def _readings(journal: Path) -> str:
    if not journal.exists():
        return ""
    try:
        rows = [{**row.document, "delivery": row.delivery} for row in Rows(journal, Wanted(last=READINGS))]
    except JournalError as error:
        return json.dumps({"error": str(error)}) + "\n"
    return "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows)


def _said(words: tuple[str, ...]) -> str:
    program = shutil.which(words[0])
    if program is None:
        return f"({words[0]} is not installed here)\n"
    try:
        said = subprocess.run([program, *words[1:]], capture_output=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"({' '.join(words)}: {error})\n"
    return (said.stdout + said.stderr).decode("utf-8", "replace")


def _pictures(places: tuple[Path, ...]) -> Iterator[tuple[str, bytes]]:
    """The last overlays, newest first, as far as they fit."""
    found = [file for place in places if place.is_dir() for file in place.glob("*.jpg")]
    room = PICTURES_MB * 1e6
    with contextlib.suppress(OSError):
        for file in sorted(found, key=lambda file: file.stat().st_mtime, reverse=True):
            room -= file.stat().st_size
            if room < 0:
                return
            yield f"pictures/{file.name}", file.read_bytes()
