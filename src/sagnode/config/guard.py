"""Who else may change what is measured, or read what is secret: owners and modes of the files of a configuration."""

from __future__ import annotations

import os
import pwd
import stat
from collections.abc import Iterator
from pathlib import Path

from sagnode.config.lines import KeyPath
from sagnode.config.load import LoadedNode, LoadedSpan

Exposure = tuple[Path, KeyPath, str]
"""The file that names it, the key there (empty: that file itself), and a sentence with the remedy."""


def exposures(loaded: LoadedNode | LoadedSpan, *, user: int | None = None) -> Iterator[Exposure]:
    """Everything about the configuration's files that trusts more people than it needs to.

    Args:
        loaded: what was read; its file names are absolute.
        user: whose own files are trusted beside root's; by default the one that asks.
    """
    trusted = {0, os.geteuid() if user is None else user}
    span_path = loaded.span_path if isinstance(loaded, LoadedNode) else loaded.path
    camera = loaded.span.camera
    believed: list[tuple[Path, KeyPath, Path | None]] = [
        (span_path, (), span_path),
        (span_path, ("camera", "intrinsics"), camera.intrinsics),
        (span_path, ("camera", "reference_image"), camera.reference_image),
    ]
    if isinstance(loaded, LoadedNode):
        believed.insert(0, (loaded.path, (), loaded.path))
        mqtt = loaded.node.mqtt
        if mqtt is not None and mqtt.tls is not None:
            believed.append((loaded.path, ("mqtt", "tls", "ca_file"), mqtt.tls.ca_file))
    for names_it, key, file in believed:
        text = _changeable(file, trusted) if file else None
        if text:
            yield names_it, key, text
    if isinstance(loaded, LoadedNode):
        yield from _readable_secrets(loaded)


def _changeable(file: Path, trusted: set[int]) -> str | None:
    """Why others than the trusted may change a file, which is also so where they may put another in its place."""
    for place in (file, file.parent):
        try:
            status = place.stat()
        except OSError:  # that it cannot be read is told elsewhere
            return None
        if status.st_mode & stat.S_IWOTH and not (place is not file and status.st_mode & stat.S_ISVTX):
            return f"everybody may write to {place}, and so change what is measured; chmod o-w {place}"
        if status.st_uid not in trusted:
            return f"{place} belongs to {_name(status.st_uid)}, who may change what is measured; chown root {place}"
    return None


def _readable_secrets(loaded: LoadedNode) -> Iterator[Exposure]:
    mqtt = loaded.node.mqtt
    secrets: list[tuple[KeyPath, Path | None]] = []
    if mqtt is not None:
        secrets = [(("mqtt", "password_file"), mqtt.password_file)]
        secrets += [(("mqtt", "tls", "key_file"), mqtt.tls.key_file)] if mqtt.tls else []
    for key, file in secrets:
        try:
            mode = file.stat().st_mode if file else 0
        except OSError:
            continue
        if mode & (stat.S_IROTH | stat.S_IWOTH | stat.S_IWGRP):
            yield loaded.path, key, f"{file} is a secret with mode {mode & 0o777:04o}; chmod 0640 {file} at most"


def _name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"
