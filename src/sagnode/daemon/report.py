"""What can be found out about a node from outside: what its daemon wrote (``status.json``), its lock, its journal.

Imports nothing that takes time, so that ``sagnode status`` answers at once on a Raspberry Pi, also when the daemon does
not run or hangs.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import sqlite3
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sagnode.daemon.places import JOURNAL, VOLATILE
from sagnode.daemon.status_page import Shown, find_page

SILENT_S = 60.0
"""The daemon shows itself every ten seconds; so long without is a trouble."""
DISK_LOW_MB = 100.0
CERTIFICATE_DAYS = 30.0
"""A tower is not visited overnight."""


def examine(state_dir: Path) -> dict[str, Any]:
    """Everything that can be found out about the node with this state directory.

    Returns:
        ``verdict`` (fine or degraded), ``problems`` (a sentence each), ``running``, and ``status``: what the daemon
        wrote last, with ``age_s`` added to each reading; null when it never wrote anything.
    """
    shown = find_page(state_dir)
    page = shown.page
    homes = _homes(state_dir, shown)
    held = {home: _is_held(home / "lock") for home in homes}
    # Where a lock cannot be seen, the process counts.
    running = True in held.values() or (None in held.values() and _is_there(page))
    journal = _journal(next((home for home in homes if held[home]), state_dir) / JOURNAL)
    if page is None:
        page = {"readings": journal["readings"], "health": {}, "conductors": list(journal["readings"])}
        known = False
    else:
        known = True
        same_boot = page.get("boot_id") == _boot_id()
        page["age_s"] = time.monotonic() - page["written_monotonic_s"] if same_boot else None
        for reading in page["readings"].values():
            aged = same_boot and not page["virtual_clock"]
            reading["age_s"] = time.monotonic() - reading["recorded_monotonic_s"] if aged else None
    if journal["depth"] is not None:
        page["health"]["outbox_depth"] = journal["depth"]
    if known:
        problems = list(_problems(page, running=running))
    elif shown.not_understood is not None:
        remedy = "restart the service" if running else "it goes with the next start"
        problems = [f"{shown.not_understood} is damaged, or was written by another version of sagnode; {remedy}"]
    elif running:
        problems = ["the daemon has not shown itself yet"]
    else:
        problems = [f"no daemon has run with {state_dir}; --config or --state-dir names another"]
    return {
        "schema_version": "sagnode.status-report/1",
        "verdict": "degraded" if problems else "fine",
        "problems": problems,
        "running": running,
        "state_dir": str(state_dir),
        "status": page if known or page["readings"] else None,
    }


# -- finding


def _homes(state_dir: Path, shown: Shown) -> list[Path]:
    """Where the daemon may keep its journal: the state directory, and what stands in for it in memory."""
    if shown.directory is None or shown.directory == state_dir:
        return [state_dir]
    return [state_dir, shown.directory / VOLATILE]


def _is_held(lock: Path) -> bool | None:
    """Whether a daemon holds this lock; None where that cannot be seen."""
    try:
        with lock.open() as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except FileNotFoundError:
        return False
    except OSError:
        return None
    return False


def _is_there(page: dict[str, Any] | None) -> bool:
    """Whether the process is there that wrote the page."""
    same_boot = page is not None and page.get("boot_id") == _boot_id()
    return same_boot and page is not None and page["state"] == "running" and Path(f"/proc/{page['pid']}").exists()


def _boot_id() -> str:
    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    return ""


def _journal(path: Path) -> dict[str, Any]:
    """Depth of the outbox, and the newest reading of each conductor; nulls where it cannot be read."""
    nothing: dict[str, Any] = {"depth": None, "readings": {}}
    if not path.exists():
        return nothing
    try:
        with contextlib.closing(sqlite3.connect(f"file:{path.absolute()}?mode=ro", uri=True, timeout=0.5)) as db:
            depth = db.execute("SELECT count(*) FROM readings WHERE fate = 'pending'").fetchone()[0]
            rows = db.execute("SELECT json FROM readings ORDER BY sequence DESC LIMIT 50").fetchall()
    except sqlite3.Error:
        return nothing
    readings: dict[str, Any] = {}
    for (text,) in reversed(rows):
        with contextlib.suppress(ValueError, KeyError):
            message = json.loads(text)
            quality = message["quality"]
            readings[message["conductor"]] = {
                **message,
                "validity": quality["validity"],
                "reasons": quality["reasons"],
                "age_s": None,
            }
    return {"depth": depth, "readings": dict(sorted(readings.items()))}


# -- judging


def _problems(page: dict[str, Any], *, running: bool) -> Iterator[str]:
    health = page["health"]
    if not running:
        ended = page["state"]
        yield "the daemon is not running" + (f" ({ended})" if ended != "running" else " (it ended without a word)")
    elif page["age_s"] is None or page["age_s"] > max(SILENT_S, 2 * page["deadline_s"]):
        yield f"the daemon has not shown itself for {duration(page['age_s'])}"
    yield from _reading_problems(page, running=running)
    for alarm in page.get("alarms", ()):
        yield f"alarm: {alarm['kind']} of {alarm['conductor']} since {moment(alarm['since'])}: {alarm['text']}"
    if health.get("trend", "ok") != "ok":
        yield f"trend: {health['trend']}"
    if running and page.get("broker_connected") is False:
        yield f"broker: {health['broker']}"
    elif running and health.get("delivery", "ok") != "ok":
        yield f"delivery: {health['delivery']}"
    yield from _certificate_problems(health)
    if page["waiting_in_memory"] or health["journal"] != "ok":
        yield f"journal: {health['journal']}"
    if health.get("disk_free_mb") is not None and health["disk_free_mb"] < DISK_LOW_MB:
        yield f"disk: only {health['disk_free_mb']:.0f} MB free"
    if health.get("throttled"):
        yield "processor throttled: too little voltage or too hot"
    if health["configuration"] != "ok":
        yield f"configuration: {health['configuration']}"


def _certificate_problems(health: dict[str, Any]) -> Iterator[str]:
    left = _seconds_until(health.get("certificate_ends_at"))
    if left is not None and left < CERTIFICATE_DAYS * 86400:
        when = f"ends in {duration(left)}" if left > 0 else f"ended {duration(-left)} ago"
        yield f"certificate: mqtt.tls.cert_file {when}; renew it: sagnode-enrol request"


def _seconds_until(moment: str | None) -> float | None:
    return None if moment is None else (datetime.fromisoformat(moment) - datetime.now(UTC)).total_seconds()


def _reading_problems(page: dict[str, Any], *, running: bool) -> Iterator[str]:
    for conductor in page["conductors"]:
        reading = page["readings"].get(conductor)
        if reading is None:
            yield f"{conductor}: no reading since the start"
        elif reading["validity"] == "invalid":
            causes = ", ".join(reason["cause"] for reason in reading["reasons"])
            yield f"{conductor}: last reading invalid ({causes})"
        elif (
            running
            and page.get("gap_s") is not None
            and (reading["age_s"] or 0) > 2 * page["gap_s"] + page["deadline_s"]
        ):
            yield f"{conductor}: last reading is stale, {duration(reading['age_s'])} old"


# -- words


def moment(text: str) -> str:
    """A time in RFC 3339, for a person to read."""
    return datetime.fromisoformat(text).astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def duration(seconds: float | None) -> str:
    """A length of time, for a person to read; None is not known."""
    if seconds is None:
        return "an unknown time"
    whole = int(seconds)
    for size, unit, smaller, small in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole >= size:
            rest = whole % size // smaller
            return f"{whole // size} {unit}" + (f" {rest} {small}" if rest else "")
    return f"{whole} s"
