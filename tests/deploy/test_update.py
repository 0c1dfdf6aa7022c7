"""deploy/update.py installs only what is signed, for this system, later, and not tried in vain. Real openssl and dpkg;
a shell script stands in for the installer, which tests/platform runs on a booted machine."""

from __future__ import annotations

import hashlib
import importlib.util
import platform
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
if not (shutil.which("openssl") and shutil.which("dpkg")):
    pytest.skip("openssl and dpkg are needed", allow_module_level=True)
NUMBER = platform.freedesktop_os_release().get("VERSION_ID", "")
ARCH = subprocess.run(["dpkg", "--print-architecture"], capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture(scope="module")
def update() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sagnode_update", ROOT / "deploy" / "update.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["sagnode_update"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


class Place:
    """A unit, and where its releases come from."""

    def __init__(self, root: Path) -> None:
        self.root, self.offered, self.state = root, root / "offered", root / "state"
        self.current = root / "current"
        (self.current / "venv" / "bin").mkdir(parents=True)
        self.offered.mkdir()
        self.runs("1.2.0")
        self.installs("exit 0")
        for name in ("update", "other"):
            key = root / f"{name}.key"
            subprocess.run(
                ["openssl", "genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256", "-out", key],
                check=True,
                capture_output=True,
            )
        subprocess.run(
            ["openssl", "pkey", "-in", root / "update.key", "-pubout", "-out", root / "update.pub"], check=True
        )
        self.configuration = root / "update.toml"
        self.configuration.write_text(f'from = "{self.offered}"\nkey = "update.pub"\n')

    def runs(self, version: str) -> None:
        command = self.current / "venv" / "bin" / "sagnode"
        command.write_text(f"#!/bin/sh\necho sagnode {version}\n")
        command.chmod(0o755)

    def installs(self, script: str) -> None:
        (self.current / "install.sh").write_text(f'echo "$2" >>{self.root}/calls\n[ -s "$2" ] || exit 9\n{script}\n')

    def offer(self, *versions: str, number: str = NUMBER, arch: str = ARCH, key: str = "update") -> None:
        lines = []
        for version in versions:
            file = self.offered / f"sagnode_{version}+deb{number}_{arch}.deb"
            file.write_text(f"package {version}")
            lines.append(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n")
        sums = self.offered / "SHA256SUMS"
        sums.write_text("".join(lines))
        words = ["openssl", "dgst", "-sha256", "-sign", self.root / f"{key}.key", "-out", f"{sums}.sig", sums]
        subprocess.run(words, check=True)

    @property
    def calls(self) -> list[str]:
        file = self.root / "calls"
        return [Path(line).name for line in file.read_text().splitlines()] if file.exists() else []


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


def test_the_latest_for_this_system_is_installed_and_the_package_not_kept(update: ModuleType, place: Place) -> None:
    place.offer("1.2.0", "1.10.0", "1.9.3", "1.11.0~rc1")
    said = update.update(update.read_source(place.configuration), place.current, place.state, only_look=True)
    assert "1.11.0~rc1 would follow 1.2.0" in said and place.calls == []
    assert "1.11.0~rc1 follows 1.2.0" in update.update(
        update.read_source(place.configuration), place.current, place.state
    )
    assert place.calls == [f"sagnode_1.11.0~rc1+deb{NUMBER}_{ARCH}.deb"]
    assert not list(place.state.glob("*.deb"))


@pytest.mark.parametrize(
    ("present", "offered", "number", "arch"),
    [
        ("1.2.0", ["1.1.9", "1.2.0"], NUMBER, ARCH),  # a list from before, shown again
        ("1.2.0rc2", ["1.2.0~rc1"], NUMBER, ARCH),
        ("1.2.0", ["9.0"], "99", ARCH),
        ("1.2.0", ["9.0"], NUMBER, "m68k"),
    ],
)
def test_nothing_older_and_nothing_for_other_machines(
    update: ModuleType, place: Place, present: str, offered: list[str], number: str, arch: str
) -> None:
    place.runs(present)
    place.offer(*offered, number=number, arch=arch)
    said = update.update(update.read_source(place.configuration), place.current, place.state)
    assert "is the latest" in said and place.calls == []


def test_what_is_not_signed_or_not_what_was_signed_is_refused(update: ModuleType, place: Place) -> None:
    source = update.read_source(place.configuration)
    place.offer("2.0", key="other")
    with pytest.raises(update.Fault, match="not signed with"):
        update.update(source, place.current, place.state)
    place.offer("2.0")
    (place.offered / "SHA256SUMS").write_text((place.offered / "SHA256SUMS").read_text().replace("_2.0", "_3.0"))
    with pytest.raises(update.Fault, match="not signed with"):
        update.update(source, place.current, place.state)
    place.offer("2.0")
    (place.offered / f"sagnode_2.0+deb{NUMBER}_{ARCH}.deb").write_text("package of somebody else")
    with pytest.raises(update.Fault, match="is not the one that SHA256SUMS tells of"):
        update.update(source, place.current, place.state)
    (place.offered / "SHA256SUMS.sig").unlink()
    with pytest.raises(update.Fault, match=r"SHA256SUMS\.sig: .*No such file"):
        update.update(source, place.current, place.state)
    assert place.calls == []


def test_a_list_cannot_name_a_file_elsewhere(update: ModuleType) -> None:
    sha = "a" * 64
    for name in ("../sagnode_9.0+deb12_amd64.deb", "sagnode_9.0/../x+deb12_amd64.deb", "/etc/passwd", "x.deb"):
        assert update.releases(f"{sha}  {name}\n", "12", "amd64") == []
    assert len(update.releases(f"{sha}  sagnode_9.0+deb12_amd64.deb\n", "12", "amd64")) == 1


def test_a_release_that_did_not_run_is_not_tried_again_but_the_next_one_is(update: ModuleType, place: Place) -> None:
    source = update.read_source(place.configuration)
    place.installs("exit 1")
    place.offer("2.0")
    with pytest.raises(update.Fault, match=r"2\.0 was not installed .* 1\.2\.0 goes on"):
        update.update(source, place.current, place.state)
    assert "that ran here" in update.update(source, place.current, place.state)
    assert len(place.calls) == 1
    place.installs("exit 0")
    place.offer("2.0", "2.0.1")
    assert "2.0.1 follows" in update.update(source, place.current, place.state)


def test_more_than_anything_that_can_be_a_release_is_not_taken(
    update: ModuleType, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    place.offer("2.0")
    monkeypatch.setattr(update, "SUMS_MAX_BYTES", 10)
    with pytest.raises(update.Fault, match="more than 10 bytes"):
        update.update(update.read_source(place.configuration), place.current, place.state)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('from = "http://a.example"\nkey = "update.pub"', 'must be "https://'),
        ('from = "https://a.example"\nkey = "nowhere.pub"', "key must name the file"),
        ('from = "https://a.example"', "key must name the file"),
        ('from = "/x"\nkey = "update.pub"\nforce = true', "force is no key here"),
        ("from = ", "update.toml: "),
    ],
)
def test_a_configuration_with_faults_is_told(update: ModuleType, place: Place, text: str, told: str) -> None:
    place.configuration.write_text(text)
    with pytest.raises(update.Fault, match=told):
        update.read_source(place.configuration)
    place.configuration.unlink()
    with pytest.raises(update.Fault, match=r"docs/install\.md"):
        update.read_source(place.configuration)
