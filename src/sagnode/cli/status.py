"""``sagnode status``: what a technician wants at a glance.

Reads what the daemon wrote (``status.json``) and the journal beside it; imports nothing that takes time, so that it
answers at once on a Raspberry Pi, also when the daemon does not run or hangs.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import json
import os
import sqlite3
import sys
import time
import tomllib
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sagnode.daemon.places import runtime_directory, state_directory
from sagnode.errors import ConfigError

HELP = "what the node is doing: last readings, camera, broker, disk, clock"
EPILOG = """exit codes: 0 fine; 1 degraded (not running, a reading invalid or stale, broker down, disk in trouble);
2 usage or no such configuration"""
SERVICE_STATE = Path("/var/lib/sagnode")
SERVICE_RUNTIME = Path("/run/sagnode")
SILENT_S = 60.0
"""The daemon shows itself every ten seconds; so long without is a trouble."""
DISK_LOW_MB = 100.0
CERTIFICATE_DAYS = 30.0
"""A tower is not visited overnight."""
_WATCH_S = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which node, and how to show it."""
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--config", type=Path, metavar="PATH", help="node file, for its state directory")
    place.add_argument("--state-dir", type=Path, metavar="DIR", help="the state directory itself")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="everything, as JSON")
    form.add_argument("--watch", action="store_true", help="show it again every two seconds until Ctrl-C")


def run(args: argparse.Namespace) -> int:
    """Look, and show."""
    state_dir = _state_dir(args)
    _look_into(state_dir)
    while args.watch:
        report = examine(state_dir)
        sys.stdout.write("\x1b[H\x1b[2J" + "\n".join(lines(report)) + "\n")
        sys.stdout.flush()
        time.sleep(_WATCH_S)
    report = examine(state_dir)
    print(json.dumps(report, indent=2, ensure_ascii=False) if args.json else "\n".join(lines(report)))
    return 1 if report["problems"] else 0


def examine(state_dir: Path) -> dict[str, Any]:
    """Everything that can be found out about the node with this state directory.

    Returns:
        ``verdict`` (fine or degraded), ``problems`` (a sentence each), ``running``, and ``status``: what the daemon
        wrote last, with ``age_s`` added to each reading; null when it never wrote anything.
    """
    page = _page(state_dir)
    running = _runs(state_dir, page)
    journal = _journal(state_dir / "journal.sqlite")
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
    problems = list(_problems(page, running=running, known=known, state_dir=state_dir))
    return {
        "schema_version": "sagnode.status-report/1",
        "verdict": "degraded" if problems else "fine",
        "problems": problems,
        "running": running,
        "state_dir": str(state_dir),
        "status": page if known or page["readings"] else None,
    }


def lines(report: dict[str, Any]) -> Iterator[str]:
    """The report for a screen."""
    page = report["status"]
    if page is not None:
        yield _headline(page, running=report["running"])
        yield ""
        yield from _readings(page)
        yield ""
        yield from (f"{name:<11} {text}" for name, text in _health(page) if text)
        yield ""
    if not report["problems"]:
        yield "fine"
    for problem in report["problems"]:
        yield f"degraded: {problem}"


# -- finding


def _state_dir(args: argparse.Namespace) -> Path:
    if args.state_dir is not None:
        _look_into(args.state_dir)
        if not args.state_dir.is_dir():
            raise ConfigError(f"{args.state_dir}: no such directory", "give the node's state directory, or --config")
        return Path(args.state_dir)
    if args.config is not None:
        return configured_state_dir(args.config)
    own = state_directory(None)
    return own if own.is_dir() or not SERVICE_STATE.is_dir() else SERVICE_STATE


def _look_into(state_dir: Path) -> None:
    """Raises ConfigError where this user may not; what is not there at all is told elsewhere."""
    try:
        os.scandir(state_dir).close()
    except PermissionError:
        what = f"{state_dir} is closed to this user"
        raise ConfigError(what, "sudo sagnode status, or once: sudo adduser USER sagnode, and log in again") from None
    except OSError:
        return


def configured_state_dir(path: Path) -> Path:
    """From the node file alone and without checking it: status must answer although the configuration is broken.

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
    own = state_directory(None)
    return own if own.is_dir() or not SERVICE_STATE.is_dir() else SERVICE_STATE


def _page(state_dir: Path) -> dict[str, Any] | None:
    """What the daemon with this state directory wrote last."""
    pages = []
    for directory in (state_dir, runtime_directory(), SERVICE_RUNTIME):
        if directory is not None:
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # a page of another version, or none
                page = json.loads((directory / "status.json").read_text(encoding="utf-8"))
                float(page["written_at"])
                if directory == state_dir or Path(page["state_dir"]) == state_dir.absolute():
                    pages.append(page)
    return max(pages, key=lambda page: float(page["written_at"]), default=None)


def _runs(state_dir: Path, page: dict[str, Any] | None) -> bool:
    """Whether a daemon holds the state directory's lock; where that cannot be seen, whether its process is there."""
    try:
        with (state_dir / "lock").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except FileNotFoundError:
        return False
    except OSError:
        same_boot = page is not None and page.get("boot_id") == _boot_id()
        return same_boot and page is not None and page["state"] == "running" and Path(f"/proc/{page['pid']}").exists()
    return False


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


def _problems(page: dict[str, Any], *, running: bool, known: bool, state_dir: Path) -> Iterator[str]:
    if not known:
        yield f"no daemon has run with {state_dir}" if not running else "the daemon has not shown itself yet"
        return
    health = page["health"]
    if not running:
        ended = page["state"]
        yield "the daemon is not running" + (f" ({ended})" if ended != "running" else " (it ended without a word)")
    elif page["age_s"] is None or page["age_s"] > max(SILENT_S, 2 * page["deadline_s"]):
        yield f"the daemon has not shown itself for {_duration(page['age_s'])}"
    yield from _reading_problems(page, running=running)
    for alarm in page.get("alarms", ()):
        yield f"alarm: {alarm['kind']} of {alarm['conductor']} since {_moment(alarm['since'])}: {alarm['text']}"
    if health.get("trend", "ok") != "ok":
        yield f"trend: {health['trend']}"
    if running and page["broker_connected"] is False:
        yield f"broker: {health['broker']}"
    yield from _certificate_problems(health)
    if page["waiting_in_memory"] or health["journal"] != "ok":
        yield f"journal: {health['journal']}"
    if health["disk_free_mb"] is not None and health["disk_free_mb"] < DISK_LOW_MB:
        yield f"disk: only {health['disk_free_mb']:.0f} MB free"
    if health["throttled"]:
        yield "processor throttled: too little voltage or too hot"
    if health["configuration"] != "ok":
        yield f"configuration: {health['configuration']}"


def _certificate_problems(health: dict[str, Any]) -> Iterator[str]:
    left = _seconds_until(health.get("certificate_ends_at"))
    if left is not None and left < CERTIFICATE_DAYS * 86400:
        when = f"ends in {_duration(left)}" if left > 0 else f"ended {_duration(-left)} ago"
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
        elif running and page["gap_s"] is not None and (reading["age_s"] or 0) > 2 * page["gap_s"] + page["deadline_s"]:
            yield f"{conductor}: last reading is stale, {_duration(reading['age_s'])} old"


# -- showing


def _headline(page: dict[str, Any], *, running: bool) -> str:
    unit = page.get("unit")
    name = "/".join(unit[key] for key in ("utility", "line", "span", "unit")) if unit else "unknown unit"
    up = page["health"].get("uptime_s")
    state = f"running, up {_duration(up)}" if running else "not running"
    return f"{name}   {state}   sagnode {page.get('software_version', '?')}"


def _readings(page: dict[str, Any]) -> Iterator[str]:
    rows = []
    for conductor, reading in page["readings"].items():
        when = f"{_duration(reading['age_s'])} ago" if reading["age_s"] is not None else _moment(reading["acquired_at"])
        rows.append(
            (
                conductor,
                f"sag {_interval(reading, 'sag')}",
                f"clearance {_interval(reading, 'clearance')}",
                reading["validity"],
                when,
                [f"{reason['cause']}: {reason['text']}" for reason in reading["reasons"]],
            )
        )
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(5)]
    for row in rows:
        yield "  ".join(f"{row[i]:<{widths[i]}}" for i in range(5)).rstrip()
        yield from (f"{'':<{widths[0]}}  {reason}" for reason in row[5])
    for conductor in page["conductors"]:
        if conductor not in page["readings"]:
            yield f"{conductor}  no reading yet"


def _health(page: dict[str, Any]) -> Iterator[tuple[str, str]]:
    health = page["health"]
    yield "camera", health.get("camera", "")
    yield "lens", (health.get("lens") or {}).get("text", "")
    yield "broker", health.get("broker", "")
    ends = health.get("certificate_ends_at")
    yield "certificate", f"ends {_moment(ends)}" if ends else ""
    depth, oldest = health.get("outbox_depth"), health.get("outbox_oldest_s")
    waits = "" if depth is None else f"{depth} readings wait" if depth else "empty"
    yield "outbox", waits + (f", the oldest for {_duration(oldest)}" if depth and oldest is not None else "")
    yield "journal", health.get("journal", "")
    disk, memory, heat = (health.get(key) for key in ("disk_free_mb", "memory_available_mb", "cpu_temperature_c"))
    yield "disk", "" if disk is None else f"{_bytes(disk)} free"
    yield "memory", "" if memory is None else f"{_bytes(memory)} available"
    throttled = {True: ", throttled", False: "", None: ""}[health.get("throttled")]
    yield "processor", "" if heat is None else f"{heat:.0f} °C{throttled}"
    clock = page.get("clock")
    trust = "" if clock is None else f"{'' if clock['synced'] else 'not '}synchronised (says: {clock['source']})"
    yield "clock", f"{trust}; virtual, node shows {_moment(page['now'])}" if page.get("virtual_clock") else trust
    yield "next", _moment(page["next_slot"]) if page.get("next_slot") else ""
    if "readings_made" in health:
        yield "made", f"{health['readings_made']} readings, {health['readings_invalid']} invalid"


def _interval(reading: dict[str, Any], stem: str) -> str:
    value, lo, hi = (reading.get(f"{stem}_{part}") for part in ("m", "lo", "hi"))
    return "-" if value is None or lo is None or hi is None else f"{value:.2f} [{lo:.2f} {hi:.2f}] m"


def _moment(text: str) -> str:
    return datetime.fromisoformat(text).astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _bytes(megabytes: float) -> str:
    return f"{megabytes / 1000:.1f} GB" if megabytes >= 1000 else f"{megabytes:.0f} MB"


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "an unknown time"
    whole = int(seconds)
    for size, unit, smaller, small in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole >= size:
            rest = whole % size // smaller
            return f"{whole // size} {unit}" + (f" {rest} {small}" if rest else "")
    return f"{whole} s"
