"""The machine and its service manager: clock, watchdogs, service, heat and voltage, compiled code, versions."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
import shutil
import sqlite3
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path

from sagnode import __version__
from sagnode.daemon.machine import Machine
from sagnode.doctor.findings import Finding, fault, ok, skipped, warning
from sagnode.native import why_not

UNIT = "sagnode.service"
PACKAGES = ("numpy", "opencv-python-headless", "pydantic", "paho-mqtt", "apscheduler", "PyYAML")
_MEMORY_MB = 150.0


def check_system(root: Path = Path("/")) -> Iterator[Finding]:
    """Everything around the node.

    Args:
        root: file system root; ``/`` except in tests.
    """
    machine = Machine(root)
    yield _clock(machine)
    manager = systemd_properties("") if (root / "run/systemd/system").is_dir() else {}
    unit = systemd_properties(UNIT) if manager else {}
    yield _hardware_watchdog(root, manager)
    yield from _service(manager, unit)
    yield _processor(machine)
    yield _memory(machine)
    yield _kernels()
    yield versions(root)


def systemd_properties(unit: str) -> dict[str, str]:
    """``systemctl show`` of a unit, or of the manager itself for an empty name; empty where systemd does not answer."""
    program = shutil.which("systemctl")
    if program is None:
        return {}
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        said = subprocess.run(
            [program, "show", *([unit] if unit else [])], capture_output=True, text=True, timeout=10, check=False
        )
        return dict(line.split("=", 1) for line in said.stdout.splitlines() if "=" in line)
    return {}


def _clock(machine: Machine) -> Finding:
    trust = machine.clock_trust()
    if trust.synced:
        return ok("clock", f"synchronised (says: {trust.source})")
    remedy = "timedatectl; readings say clock_synced = false until then, and a wrong clock makes TLS fail"
    return warning("clock", f"not synchronised (says: {trust.source})", remedy)


def _hardware_watchdog(root: Path, manager: Mapping[str, str]) -> Finding:
    check = "hardware watchdog"
    found = sorted(root.glob("sys/class/watchdog/watchdog*/identity"))
    if not found:
        return warning(check, "none on this machine", "a kernel that hangs stays so; on a Pi: dtparam=watchdog=on")
    name = found[0].read_text(encoding="utf-8", errors="replace").strip()
    if not manager:
        return skipped(check, f"{name}; systemd does not run here, so nobody is known to feed it")
    fed = manager.get("RuntimeWatchdogUSec", "0")
    if fed in {"0", "infinity", ""}:
        remedy = "put RuntimeWatchdogSec=15 into /etc/systemd/system.conf.d/watchdog.conf (section [Manager])"
        return warning(check, f"{name} is there, and systemd does not use it", remedy)
    return ok(check, f"{name}, fed by systemd, {fed}")


def _service(manager: Mapping[str, str], unit: Mapping[str, str]) -> Iterator[Finding]:
    if not manager:
        yield skipped("service", "systemd does not run here")
        return
    if unit.get("LoadState") != "loaded":
        yield warning("service", f"{UNIT} is not installed ({unit.get('LoadState', '?')})", "deploy/install.sh")
        return
    enabled, active = unit.get("UnitFileState", "?"), unit.get("ActiveState", "?")
    text = f"{UNIT} is {active} ({unit.get('SubState', '?')}), {enabled}"
    if enabled not in {"enabled", "enabled-runtime", "static"}:
        yield warning("service", f"{text}: it does not start with the machine", f"systemctl enable {UNIT}")
    elif active == "failed":
        remedy = f"journalctl -u sagnode -n 50; then systemctl reset-failed {UNIT} and start it"
        yield fault("service", f"{text}, result {unit.get('Result', '?')}", remedy)
    else:
        restarts = unit.get("NRestarts", "0")
        yield ok("service", text + (f", restarted {restarts} times by systemd" if restarts != "0" else ""))
    if unit.get("WatchdogUSec", "0") in {"0", "infinity", ""}:
        yield warning("service watchdog", "not set: a daemon that hangs stays so", "WatchdogSec=120 in the unit")
    else:
        yield ok("service watchdog", unit["WatchdogUSec"])


def _processor(machine: Machine) -> Finding:
    heat, throttled = machine.cpu_temperature_c(), machine.throttled()
    if heat is None and throttled is None:
        return skipped("processor", "neither a thermometer nor a voltage alarm on this machine")
    text = "no thermometer" if heat is None else f"{heat:.0f} °C"
    if throttled:
        remedy = "check the supply (5.1 V at the board) and the cooling"
        return warning("processor", f"{text}, throttled: too little voltage or too hot", remedy)
    if heat is not None and heat > 80.0:
        return warning("processor", text, "shade it, or let air through; it slows down above 80 °C")
    return ok("processor", text + (", not throttled" if throttled is False else ""))


def _memory(machine: Machine) -> Finding:
    free = machine.memory_available_mb()
    if free is None:
        return skipped("memory", "/proc/meminfo does not tell")
    if free < _MEMORY_MB:
        return warning("memory", f"{free:.0f} MB available", "end other programs; a frame needs some 100 MB to measure")
    return ok("memory", f"{free:.0f} MB available")


def _kernels() -> Finding:
    check = "compiled kernels"
    if not why_not:
        return ok(check, "in use")
    remedy = "install the Debian package, or: apt install gcc libc6-dev python3-dev, and sagnode anew"
    if "SAGNODE_NATIVE" in why_not:
        remedy = "take SAGNODE_NATIVE=0 out of the environment"
    return warning(check, f"not in use, so that a frame takes longer: {why_not}", remedy)


def versions(root: Path = Path("/")) -> Finding:
    """What runs here, in one line."""
    parts = [f"sagnode {__version__}", f"Python {platform.python_version()}", f"SQLite {sqlite3.sqlite_version}"]
    missing = []
    for package in PACKAGES:
        try:
            parts.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(package)
    system = _os_name(root)
    parts += [system, f"Linux {os.uname().release} {platform.machine()}"]
    board = root / "proc/device-tree/model"
    with contextlib.suppress(OSError):
        parts.append(board.read_text(encoding="utf-8", errors="replace").strip("\0\n "))
    text = ", ".join(parts)
    if missing:
        return fault("versions", f"{text}; not installed: {', '.join(missing)}", "install sagnode anew")
    return ok("versions", text)


def _os_name(root: Path) -> str:
    with contextlib.suppress(OSError):
        for line in (root / "etc/os-release").read_text(encoding="utf-8").splitlines():
            if line.startswith("PRETTY_NAME="):
                return line.partition("=")[2].strip('"')
    return platform.system()
