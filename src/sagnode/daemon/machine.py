"""The machine under the node, read from /proc and /sys; what a machine does not have, or hides, is None.

The root is handed in, so that tests bring trees of their own.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

_STA_UNSYNC = 0x0040  # linux/timex.h
_TIME_ERROR = 5
_VCGENCMD_EVERY_S = 30.0


@dataclass(frozen=True)
class ClockTrust:
    """Whether the time of day can be believed, and who says so."""

    synced: bool
    source: str


class Machine:
    """Reads health figures.

    Args:
        root: file system root; ``/`` except in tests.
    """

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root
        self._vcgencmd: tuple[float, bool | None] = (float("-inf"), None)

    def boot_id(self) -> str:
        """Identifies this boot; empty when the kernel does not tell."""
        return self._text("proc/sys/kernel/random/boot_id") or ""

    def cpu_temperature_c(self) -> float | None:
        """Of the processor; its own zone where one is named so, else the hottest."""
        readings: dict[str, float] = {}
        for zone in sorted(self._root.glob("sys/class/thermal/thermal_zone*")):
            milli = _number(self._text(zone / "temp"))
            if milli is not None:
                readings[self._text(zone / "type") or zone.name] = milli / 1000
        named = [value for name, value in readings.items() if "cpu" in name or "pkg" in name]
        return max(named or readings.values(), default=None)

    def throttled(self) -> bool | None:
        """Whether a Raspberry Pi is short of voltage or too hot now (not: was at some time)."""
        for file in self._root.glob("sys/devices/platform/soc*/soc*firmware/get_throttled"):
            bits = _number(self._text(file), base=16)
            if bits is not None:
                return bool(bits & 0xF)
        for monitor in self._root.glob("sys/class/hwmon/hwmon*"):
            if self._text(monitor / "name") == "rpi_volt":
                alarm = _number(self._text(monitor / "in0_lcrit_alarm"))
                return None if alarm is None else bool(alarm)
        return self._ask_vcgencmd()

    def memory_available_mb(self) -> float | None:
        """What programs may still take without swapping."""
        for line in (self._text("proc/meminfo") or "").splitlines():
            if line.startswith("MemAvailable:"):
                kilobytes = _number(line.split()[1])
                return None if kilobytes is None else kilobytes / 1000
        return None

    def disk_free_mb(self, directory: Path) -> float | None:
        """Free for an ordinary user on the file system of a directory."""
        try:
            stat = os.statvfs(directory)
        except OSError:
            return None
        return stat.f_bavail * stat.f_frsize / 1e6

    def disk_size_mb(self, directory: Path) -> float | None:
        """Of the file system of a directory."""
        try:
            stat = os.statvfs(directory)
        except OSError:
            return None
        return stat.f_blocks * stat.f_frsize / 1e6

    def clock_trust(self) -> ClockTrust:
        """The kernel knows (any NTP client tells it); systemd-timesyncd's mark is asked where the kernel may not be."""
        unsynced = _kernel_says_unsynced()
        if unsynced is not None:
            return ClockTrust(not unsynced, "kernel")
        if (self._root / "run/systemd/timesync/synchronized").exists():
            return ClockTrust(True, "systemd-timesyncd")
        return ClockTrust(False, "nobody says")

    def _ask_vcgencmd(self) -> bool | None:
        asked_at, answer = self._vcgencmd
        if time.monotonic() - asked_at < _VCGENCMD_EVERY_S:
            return answer
        answer = None
        program = shutil.which("vcgencmd")
        if program and (self._root / "dev/vcio").exists():
            with contextlib.suppress(OSError, subprocess.TimeoutExpired):
                said = subprocess.run(
                    [program, "get_throttled"], capture_output=True, text=True, timeout=2, check=False
                )
                bits = _number(said.stdout.strip().rpartition("=")[2], base=16)
                answer = None if bits is None else bool(bits & 0xF)
        self._vcgencmd = (time.monotonic(), answer)
        return answer

    def _text(self, path: Path | str) -> str | None:
        try:
            return (self._root / path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None


def _number(text: str | None, base: int = 10) -> int | None:
    try:
        return None if text is None else int(text, base)
    except ValueError:
        return None


class _Timex(ctypes.Structure):
    """``struct timex`` of adjtimex(2), with room behind for what later kernels add."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    )


def _kernel_says_unsynced() -> bool | None:
    """adjtimex(2) in reading only, which needs no privilege; None where a filter forbids even that."""
    timex = _Timex()
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    except (OSError, AttributeError):
        return None
    if state < 0:
        return None
    return state == _TIME_ERROR or bool(timex.status & _STA_UNSYNC)
