"""The files that put sagnode on a machine: unit, installer, set-up. What needs a whole machine is in bare_root.sh."""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
UNIT = ROOT / "systemd" / "sagnode.service"
PLACES = ("scripts/setup", "scripts/check", ".ci/run", "deploy/install.sh", "tests/platform/*.sh", "deploy/debian/p*")
SCRIPTS = sorted(path for place in PLACES for path in ROOT.glob(place))


def ran(*words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, timeout=60, env={**os.environ, **environment}
    )


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The shipped unit with a command that exists here; nothing else is changed."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed, so the unit cannot be checked here")
    lines = UNIT.read_text().splitlines()
    assert sum(line.startswith("ExecStart=") for line in lines) == 1
    path = tmp_path / "sagnode.service"
    path.write_text("\n".join("ExecStart=/bin/true" if x.startswith("ExecStart=") else x for x in lines) + "\n")
    return path


def test_systemd_understands_every_line_of_the_unit(unit: Path) -> None:
    result = ran("systemd-analyze", "verify", unit)
    assert result.returncode == 0, result.stderr
    assert "sagnode.service" not in result.stderr, result.stderr  # warnings name the unit
    unit.write_text(unit.read_text().replace("PrivateTmp=yes", "PrivateTemp=yes"))
    assert "PrivateTemp" in ran("systemd-analyze", "verify", unit).stderr  # and this check can fail


def test_the_service_is_exposed_to_little(unit: Path) -> None:
    result = ran("systemd-analyze", "security", "--offline=true", "--threshold=13", unit)
    assert result.returncode == 0, result.stdout[-2000:]


@pytest.mark.parametrize("name", sorted(path.name for path in UNIT.parent.glob("sagnode-*")))
def test_systemd_understands_the_other_units_too(name: str, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed, so the unit cannot be checked here")
    for path in UNIT.parent.glob("sagnode*"):
        (tmp_path / path.name).write_text(path.read_text().replace("/usr/local/bin/sagnode", "/bin/true"))
    result = ran("systemd-analyze", "verify", tmp_path / name)
    assert result.returncode == 0 and name not in result.stderr, result.stderr


def test_the_unit_lets_the_cameras_in_and_keeps_the_daemon_alive() -> None:
    lines = UNIT.read_text().splitlines()
    for line in [
        "Type=notify",
        "OOMPolicy=continue",
        "RestartPreventExitStatus=2",
        "DeviceAllow=char-video4linux rw",
        "DeviceAllow=char-dma_heap rw",
        "SupplementaryGroups=video",
    ]:
        assert line in lines
    assert not any(line.startswith("PrivateDevices") for line in lines)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_scripts_are_executable_and_parse(script: Path) -> None:
    assert os.access(script, os.X_OK)
    shell = script.read_text().splitlines()[0].removeprefix("#!").split("/")[-1]
    assert ran(shell, "-n", script).returncode == 0
    if shutil.which("shellcheck"):
        result = ran("shellcheck", "--severity=warning", script)
        assert result.returncode == 0, result.stdout


@pytest.mark.parametrize("suite", ["bookworm", "trixie"])
def test_constraints_lie_within_what_the_package_asks_for(suite: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = {Requirement(line).name.lower(): Requirement(line).specifier for line in project["dependencies"]}
    lines = (ROOT / "deploy" / f"constraints-{suite}.txt").read_text().splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    assert {pin.name for pin in pins} == {"numpy", "opencv-python-headless"}
    for pin in pins:
        lowest = next(part.version for part in pin.specifier if part.operator in {"==", ">="})
        assert asked[pin.name.lower()].contains(lowest), pin


@pytest.mark.parametrize("suite", ["bookworm", "trixie"])
def test_the_lock_has_a_hash_for_everything_and_keeps_to_the_constraints(suite: str) -> None:
    text = (ROOT / "deploy" / f"requirements-{suite}.txt").read_text().replace(" \\\n", " ")
    entries = [line.split() for line in text.splitlines() if not line.startswith("#")]
    locked = dict(entry[0].split("==") for entry in entries)
    assert all(len(entry) > 1 and all(word.startswith("--hash=sha256:") for word in entry[1:]) for entry in entries)
    # Two machines: what is compiled has a wheel for each.
    assert all(len(entry) == 3 for entry in entries if entry[0].split("==")[0] in {"numpy", "opencv-python-headless"})
    lines = (ROOT / "deploy" / f"constraints-{suite}.txt").read_text().splitlines()
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    for wanted in [Requirement(line) for line in [*lines, *asked] if not line.startswith("#")]:
        assert wanted.specifier.contains(locked[wanted.name.lower()]), wanted


def test_the_installer_says_beforehand_what_it_would_do_and_does_none_of_it() -> None:
    if not Path("/etc/debian_version").exists():
        pytest.skip("not a Debian machine")
    places = [Path("/opt"), Path("/opt/sagnode/releases"), Path("/usr/local/bin"), Path("/etc/systemd/system")]

    def standing() -> list[list[Path]]:
        return [sorted(place.iterdir()) if place.is_dir() else [] for place in places]

    before = standing()
    result = ran("bash", ROOT / "deploy/install.sh", "--dry-run")
    if "not supported" in result.stderr:
        pytest.skip(result.stderr.strip())
    assert result.returncode == 0, result.stderr
    unit = "/etc/systemd/system/sagnode.service"
    for what in ["python3 -m venv", "--require-hashes", "/usr/local/bin/sagnode", unit]:
        assert what in result.stdout
    assert standing() == before


def test_wrong_words_are_answered_with_the_usage() -> None:
    for words in [("bash", ROOT / "deploy/install.sh", "--wat"), ("sh", ROOT / "scripts/setup", "wat")]:
        result = ran(*words)
        assert result.returncode == 2
        assert "--dry-run" in result.stderr or "usage: scripts/setup" in result.stderr


def test_an_old_python_is_refused_with_a_remedy(tmp_path: Path) -> None:
    old = tmp_path / "python3.9"
    old.write_text('#!/bin/sh\ncase "$1" in -V) echo Python 3.9.2 ;; *) exit 1 ;; esac\n')
    old.chmod(0o755)
    result = ran("sh", ROOT / "scripts/setup", "demo", PYTHON=str(old))
    assert result.returncode == 1
    assert "Python 3.9.2; sagnode needs 3.11 or later" in result.stderr
    missing = ran("sh", ROOT / "scripts/setup", "demo", PYTHON="/nowhere/python3")
    assert missing.returncode == 1 and "no /nowhere/python3" in missing.stderr
