"""The machine, seen through trees of its own; systemctl through one that answers as systemd does."""

from pathlib import Path

import pytest

from sagnode.doctor.findings import Level
from sagnode.doctor.system import check_system, versions

MANAGER = "RuntimeWatchdogUSec=15s\n"
UNIT = "LoadState=loaded\nUnitFileState=enabled\nActiveState=active\nSubState=running\nWatchdogUSec=2min\n"


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A root, and the answers of systemctl show for the manager and for the unit."""
    root = tmp_path / "root"
    (root / "proc/sys/kernel/random").mkdir(parents=True)
    (root / "proc/meminfo").write_text("MemAvailable:     900000 kB\n")

    def make(manager="", unit="", files=()):
        bin_ = tmp_path / "bin"
        bin_.mkdir(exist_ok=True)
        (tmp_path / "manager").write_text(manager)
        (tmp_path / "unit").write_text(unit)
        (bin_ / "systemctl").write_text(
            f'#!/bin/sh\n[ "$1" = show ] || exit 1\nif [ -n "$2" ]; then cat {tmp_path}/unit; '
            f"else cat {tmp_path}/manager; fi\n"
        )
        (bin_ / "systemctl").chmod(0o755)
        monkeypatch.setenv("PATH", f"{bin_}:/usr/bin:/bin")
        if manager:
            (root / "run/systemd/system").mkdir(parents=True, exist_ok=True)
        for name, text in files:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)
        return {finding.check: finding for finding in check_system(root)}

    return make


WATCHDOG = ("sys/class/watchdog/watchdog0/identity", "Broadcom BCM2835 Watchdog timer\n")


def test_a_well_kept_machine(machine):
    found = machine(MANAGER, UNIT, [WATCHDOG, ("sys/class/thermal/thermal_zone0/temp", "48000\n")])
    assert found["hardware watchdog"].text == "Broadcom BCM2835 Watchdog timer, fed by systemd, 15s"
    assert found["service"].text == "sagnode.service is active (running), enabled"
    assert found["service watchdog"].text == "2min"
    for check in ("hardware watchdog", "service", "service watchdog", "processor", "memory", "versions"):
        assert found[check].level is Level.OK, found[check]


def test_what_is_missing_is_told_with_its_remedy(machine):
    found = machine("RuntimeWatchdogUSec=0\n", UNIT.replace("=enabled", "=disabled"), [WATCHDOG])
    assert "RuntimeWatchdogSec=15" in found["hardware watchdog"].remedy
    assert found["service"].remedy == "systemctl enable sagnode.service"
    failed = machine(MANAGER, UNIT.replace("active", "failed") + "Result=watchdog\n")["service"]
    assert failed.level is Level.FAULT and "result watchdog" in failed.text
    assert "not set" in machine(MANAGER, UNIT.replace("2min", "0"))["service watchdog"].text
    assert "not installed" in machine(MANAGER, "LoadState=not-found\n")["service"].text
    hot = [("sys/class/thermal/thermal_zone0/temp", "86000\n"), ("proc/meminfo", "MemAvailable: 90000 kB\n")]
    found = machine(MANAGER, UNIT, hot)
    assert found["processor"].level is found["memory"].level is Level.WARNING


def test_without_systemd_nothing_is_claimed(machine):
    found = machine()
    assert found["service"].level is Level.SKIPPED
    assert found["hardware watchdog"].level is Level.WARNING


@pytest.mark.parametrize(
    ("why", "level", "remedy"),
    [
        ("", Level.OK, ""),
        ("left out, as SAGNODE_NATIVE=0 says", Level.WARNING, "SAGNODE_NATIVE"),
        (
            "they were not built when sagnode was installed",
            Level.WARNING,
            "install the Debian package, or: apt install gcc",
        ),
    ],
)
def test_whether_the_compiled_kernels_are_in_use(machine, monkeypatch, why, level, remedy):
    monkeypatch.setattr("sagnode.doctor.system.why_not", why)
    found = machine()["compiled kernels"]
    assert found.level is level and remedy in found.remedy and why in found.text


def test_versions_name_the_board(tmp_path):
    (tmp_path / "proc/device-tree").mkdir(parents=True)
    (tmp_path / "proc/device-tree/model").write_text("Raspberry Pi 5 Model B Rev 1.0\0")
    assert versions(Path(tmp_path)).text.endswith("Raspberry Pi 5 Model B Rev 1.0")
