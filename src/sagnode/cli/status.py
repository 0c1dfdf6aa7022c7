"""``sagnode status``: what a technician wants at a glance.

Imports nothing that takes time, so that it answers at once on a Raspberry Pi; :mod:`sagnode.daemon.report` finds out.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from sagnode.daemon.places import configured_state_dir, usual_state_dir
from sagnode.daemon.report import duration, examine, moment
from sagnode.digits import decimals
from sagnode.errors import ConfigError

DESCRIPTION = """Tell what the node is doing: last readings, camera, broker, disk, clock. Answers also when the daemon
hangs or does not run; without --config and --state-dir it looks at the user's own node, or else at the installed
service."""
EPILOG = """exit codes: 0 fine; 1 degraded (not running, a reading invalid or stale, broker down, disk in trouble);
2 usage or no such configuration"""
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


def _state_dir(args: argparse.Namespace) -> Path:
    if args.state_dir is not None:
        _look_into(args.state_dir)
        if not args.state_dir.is_dir():
            raise ConfigError(f"{args.state_dir}: no such directory", "give the node's state directory, or --config")
        return Path(args.state_dir)
    if args.config is not None:
        return configured_state_dir(args.config)
    return usual_state_dir()


def _look_into(state_dir: Path) -> None:
    """Raises ConfigError where this user may not; what is not there at all is told elsewhere."""
    try:
        os.scandir(state_dir).close()
    except PermissionError:
        what = f"{state_dir} is closed to this user"
        raise ConfigError(what, "sudo sagnode status, or once: sudo adduser USER sagnode, and log in again") from None
    except OSError:
        return


def _headline(page: dict[str, Any], *, running: bool) -> str:
    unit = page.get("unit")
    name = "/".join(unit[key] for key in ("utility", "line", "span", "unit")) if unit else "unknown unit"
    up = page["health"].get("uptime_s")
    state = f"running, up {duration(up)}" if running else "not running"
    return f"{name}   {state}   sagnode {page.get('software_version', '?')}"


def _readings(page: dict[str, Any]) -> Iterator[str]:
    rows = []
    for conductor, reading in page["readings"].items():
        when = f"{duration(reading['age_s'])} ago" if reading["age_s"] is not None else moment(reading["acquired_at"])
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
    yield "landmarks", _landmarks(page)
    yield "broker", health.get("broker", "")
    ends = health.get("certificate_ends_at")
    yield "certificate", f"ends {moment(ends)}" if ends else ""
    depth, oldest = health.get("outbox_depth"), health.get("outbox_oldest_s")
    waits = "" if depth is None else f"{depth} readings wait" if depth else "empty"
    yield "outbox", waits + (f", the oldest for {duration(oldest)}" if depth and oldest is not None else "")
    yield "journal", health.get("journal", "")
    disk, memory, heat = (health.get(key) for key in ("disk_free_mb", "memory_available_mb", "cpu_temperature_c"))
    yield "disk", "" if disk is None else f"{_bytes(disk)} free"
    yield "memory", "" if memory is None else f"{_bytes(memory)} available"
    throttled = {True: ", throttled", False: "", None: ""}[health.get("throttled")]
    yield "processor", "" if heat is None else f"{heat:.0f} °C{throttled}"
    clock = page.get("clock")
    trust = "" if clock is None else f"{'' if clock['synced'] else 'not '}synchronised (says: {clock['source']})"
    yield "clock", f"{trust}; virtual, node shows {moment(page['now'])}" if page.get("virtual_clock") else trust
    yield "next", moment(page["next_slot"]) if page.get("next_slot") else ""
    if "readings_made" in health:
        yield "made", f"{health['readings_made']} readings, {health['readings_invalid']} invalid"


def _landmarks(page: dict[str, Any]) -> str:
    """By which pictures landmarks are recognised, and how old those are."""
    landmarks = page["health"].get("landmarks")
    if landmarks is None:
        return ""
    now = datetime.fromisoformat(page["now"])

    def age(key: str) -> str:
        return duration(max(0.0, (now - datetime.fromisoformat(landmarks[key])).total_seconds()))

    taken = "of unknown age"
    since = landmarks.get("reference_taken_at")
    # a picture from the future says nothing, as where frames of the past are replayed
    if since is not None and datetime.fromisoformat(since) <= now:
        # a copied file is younger than its picture
        least = "at least " if landmarks.get("reference_taken_from") == "modified" else ""
        taken = f"{least}{age('reference_taken_at')} old"
    kept = f"{landmarks['appearances']} appearances kept"
    if landmarks["appearances"] and landmarks.get("newest_at") and landmarks.get("oldest_at"):
        kept += f", {age('newest_at')} to {age('oldest_at')} old"
    used = max((reading.get("landmarks_by_appearance") or 0 for reading in page["readings"].values()), default=0)
    return f"reference picture {taken}; {kept}" + (f"; {used} found by them" if used else "")


def _interval(reading: dict[str, Any], stem: str) -> str:
    value, lo, hi = (reading.get(f"{stem}_{part}") for part in ("m", "lo", "hi"))
    if value is None or lo is None or hi is None:
        return "-"
    digits = decimals(hi - lo)
    return f"{value:.{digits}f} [{lo:.{digits}f} {hi:.{digits}f}] m"


def _bytes(megabytes: float) -> str:
    return f"{megabytes / 1000:.1f} GB" if megabytes >= 1000 else f"{megabytes:.0f} MB"
