"""Where the node keeps things: is it there, may the node write to it, is there room, is the journal sound?"""

from __future__ import annotations

import contextlib
import os
import pwd
import sqlite3
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from sagnode.daemon.journal_file import SCHEMA_VERSION
from sagnode.daemon.own_disk import OwnDisk
from sagnode.daemon.places import SERVICE_STATE
from sagnode.doctor.findings import Finding, fault, ok, skipped, warning
from sagnode.errors import DiskError

SERVICE_USER = "sagnode"
ROOM_MB = 500.0
"""Less free than this and the journal's and the pictures' quotas may not fit (storage.keep_mb, pictures_keep_mb)."""
FULL_MB = 20.0
"""Less than this and readings are soon kept in memory only."""
_DIRECTORY = "state directory"


def check_state(state_dir: Path, *, running: bool) -> Iterator[Finding]:
    """The state directory, the space on its disk, and the journal in it.

    Args:
        state_dir: of the node; it need not exist yet where its parent may be written to.
        running: whether a daemon holds it now; its journal is then in use and only looked at.
    """
    other = SERVICE_STATE if SERVICE_STATE.is_dir() and state_dir.absolute() != SERVICE_STATE else None
    try:
        OwnDisk(state_dir, other).expect()
    except DiskError as error:
        yield fault(_DIRECTORY, error.what, error.remedy)
        return
    yield _directory(state_dir)
    yield _space(state_dir)
    yield _journal(state_dir / "journal.sqlite", running=running)


def _directory(state_dir: Path) -> Finding:
    owner = f"chown -R {SERVICE_USER}: {state_dir}"
    try:
        found = state_dir.stat()
    except FileNotFoundError:
        standing = next(parent for parent in state_dir.absolute().parents if parent.exists())
        if os.access(standing, os.W_OK | os.X_OK):
            return ok(_DIRECTORY, f"{state_dir} is not there yet; it is made at the first start")
        return fault(_DIRECTORY, f"{state_dir} is not there, and {standing} may not be written to", "make it, then own")
    except OSError as error:
        return fault(_DIRECTORY, f"{state_dir}: {error.strerror}", "run doctor as the service's user, or as root")
    if not stat.S_ISDIR(found.st_mode):
        return fault(_DIRECTORY, f"{state_dir} is not a directory", "move it away, or set storage.state_dir")
    if os.geteuid() == 0:
        # Root may write anywhere; what counts is whether the service may.
        user = _service_user()
        if user is not None and found.st_uid != user.pw_uid:
            name = _user_name(found.st_uid)
            return fault(_DIRECTORY, f"{state_dir} belongs to {name}, the service runs as {SERVICE_USER}", owner)
    try:
        with tempfile.TemporaryFile(dir=state_dir) as stream:
            stream.write(b"sagnode doctor")
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        return fault(
            _DIRECTORY, f"{state_dir} cannot be written to: {error.strerror}", f"mount -o remount,rw; or {owner}"
        )
    others = " (readable by everyone)" if found.st_mode & stat.S_IROTH else ""
    return ok(_DIRECTORY, f"{state_dir} can be written to{others}")


def _service_user() -> pwd.struct_passwd | None:
    with contextlib.suppress(KeyError):
        return pwd.getpwnam(SERVICE_USER)
    return None


def _user_name(uid: int) -> str:
    with contextlib.suppress(KeyError):
        return pwd.getpwuid(uid).pw_name
    return f"user {uid}"


def _space(state_dir: Path) -> Finding:
    standing = next((place for place in (state_dir, *state_dir.absolute().parents) if place.exists()), Path("/"))
    try:
        disk = os.statvfs(standing)
    except OSError as error:
        return fault("disk", f"{standing}: {error.strerror}", "check the card")
    free_mb, free_inodes = disk.f_bavail * disk.f_frsize / 1e6, disk.f_favail
    text = f"{free_mb:.0f} MB free at {standing}"
    if free_mb < FULL_MB:
        return fault("disk", text, "make room: journalctl --vacuum-size=50M, apt-get clean, old releases")
    if disk.f_files and free_inodes < 1000:
        return fault("disk", f"{text}, but only {free_inodes} files more", "remove small files; fsck the card")
    if free_mb < ROOM_MB:
        return warning("disk", text, "make room, or lower storage.keep_mb and storage.pictures_keep_mb")
    return ok("disk", text)


def _journal(path: Path, *, running: bool) -> Finding:
    """Opened for reading only: mending is the daemon's work."""
    if not path.exists():
        return skipped("journal", f"{path} is not there yet; it is made at the first start")
    try:
        with contextlib.closing(sqlite3.connect(f"file:{path.absolute()}?mode=ro", uri=True, timeout=2.0)) as db:
            version = db.execute("PRAGMA user_version").fetchone()[0]
            if version > SCHEMA_VERSION:
                text = f"{path} was written by a later sagnode (schema {version}, this one knows {SCHEMA_VERSION})"
                return fault("journal", text, "install that version again, or move the file away")
            verdict = "ok" if running else db.execute("PRAGMA quick_check(1)").fetchone()[0]
            kept, owed = db.execute(
                "SELECT count(*), count(*) FILTER (WHERE fate = 'pending') FROM readings"
            ).fetchone()
    except sqlite3.Error as error:
        mended = "the service sets a damaged journal aside when it starts and keeps what can be read"
        return fault("journal", f"{path}: {error}", mended)
    if verdict != "ok":
        return fault("journal", f"{path} is damaged: {verdict}", "restart the service; it saves what can be read")
    return ok("journal", f"{kept} readings in {path}, {owed} of them not delivered yet")
