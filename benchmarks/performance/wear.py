"""Bytes that a reading writes to the disk."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from performance.frames import shot
from performance.plan import Plan
from performance.process import written_bytes
from performance.running import broker_table, journalled, stand_in_daemon
from sagnode.demo.broker import EmbeddedBroker

PATH = ":".join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"])
"""Where file systems are made and mounted: an administrator's programs, even where the path has none of them."""
CARD_MB = 256
SECTOR = 512


def measure(plan: Plan) -> dict[str, Any]:
    """Bytes written for each reading, by the kernel's account of the process and by a block device's own counters."""
    cycles = plan.written_readings
    conductors = len(shot("tower", plan.folder).alone(9).conductors)
    with _card(plan.folder) as (folder, device), EmbeddedBroker(plan.folder / "broker") as broker:
        state = folder / "state"
        state.mkdir()
        os.sync()
        began = _written(device)
        by_process = 0
        with stand_in_daemon(plan, state, cycles, broker_table(broker), flush=folder) as (process, _):
            while process.poll() is None:
                with contextlib.suppress(OSError, ValueError):
                    by_process = max(by_process, written_bytes(process.pid))
                time.sleep(0.05)
        os.sync()
        requests, sectors = (after - before for after, before in zip(_written(device), began, strict=True))
        readings = journalled(state)
        if readings < cycles * conductors:
            raise RuntimeError(f"{readings} readings in the journal, {cycles * conductors} expected")
        payload = _payload(state / "journal.sqlite")
        size = (state / "journal.sqlite").stat().st_size
    result: dict[str, Any] = {
        "cycles": cycles,
        "conductors": conductors,
        "json_bytes": payload / cycles,
        "journal_bytes": size / cycles,
        "process_bytes": by_process / cycles,
    }
    if device is not None:
        result |= {"device_bytes": sectors * SECTOR / cycles, "device_requests": requests / cycles}
    return result


def _payload(journal: Path) -> int:
    """Bytes of all readings themselves."""
    with contextlib.closing(sqlite3.connect(f"file:{journal}?mode=ro", uri=True)) as db:
        return int(db.execute("SELECT sum(length(CAST(json AS BLOB))) FROM readings").fetchone()[0])


@contextlib.contextmanager
def _card(folder: Path) -> Iterator[tuple[Path, str | None]]:
    """An ext4 file system of its own on a loop device, as a card has; a plain folder where that is not allowed."""
    mount = folder / "card"
    mount.mkdir(exist_ok=True)
    image = folder / "card.img"
    if os.geteuid() != 0 or shutil.which("mkfs.ext4", path=PATH) is None:
        plain = folder / "card-plain"
        shutil.rmtree(plain, ignore_errors=True)
        plain.mkdir()
        yield plain, None
        return
    with image.open("wb") as file:
        file.truncate(CARD_MB << 20)
    everywhere = os.environ | {"PATH": PATH}
    quiet = {"check": True, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": everywhere}
    # tables made at once, so that the kernel does not write them in the background while we count
    options = ["-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0"]
    subprocess.run(["mkfs.ext4", *options, str(image)], **quiet)
    shown = subprocess.run(
        ["losetup", "--find", "--show", str(image)], check=True, capture_output=True, text=True, env=everywhere
    ).stdout.strip()
    try:
        subprocess.run(["mount", "-o", "noatime", shown, str(mount)], **quiet)
        try:
            yield mount, Path(shown).name
        finally:
            subprocess.run(["umount", str(mount)], **quiet)
    finally:
        subprocess.run(["losetup", "--detach", shown], **quiet)
        image.unlink()


def _written(device: str | None) -> tuple[int, int]:
    """Write requests and sectors of a block device so far (Documentation/block/stat.rst)."""
    if device is None:
        return 0, 0
    fields = Path(f"/sys/block/{device}/stat").read_text(encoding="ascii").split()
    return int(fields[4]), int(fields[6])
