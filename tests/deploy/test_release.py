"""What a release is built with. That a package carries the module, and works, is in tests/platform/package_here.py."""

from __future__ import annotations

import sysconfig
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SUITES = ("bookworm", "trixie")


@pytest.fixture
def deploy(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script deploy/release.py; its neighbours are attributes of it."""
    monkeypatch.syspath_prepend(str(ROOT / "deploy"))
    import release

    return release


@pytest.fixture
def with_compiler(deploy: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """As if it had been downloaded before; 100 MB are too much for these tests."""
    monkeypatch.setattr(deploy.compiler, "ROOT", tmp_path)
    version = deploy.compiler.LOCK.read_text().split("ziglang==")[1].split()[0]
    directory = tmp_path / "build" / f"compiler-{version}"
    directory.mkdir(parents=True)
    return directory


@pytest.mark.parametrize("suite", SUITES)
def test_what_builds_is_not_what_runs(deploy: ModuleType, suite: str) -> None:
    parts = [deploy._part(deploy.SUITES[suite], build_tools=tools) for tools in (True, False)]
    names = [{line.split("==")[0] for line in part.splitlines() if "==" in line} for part in parts]
    assert names[0] == {"setuptools", "packaging"}
    assert {"numpy", "opencv-python-headless"} < names[1] and not names[0] & names[1]
    assert all(part.count("==") <= part.count("--hash=sha256:") for part in parts)


def test_the_compiler_is_one_wheel_for_each_machine() -> None:
    lines = [line for line in (ROOT / "deploy/requirements-compiler.txt").read_text().splitlines() if line[0] != "#"]
    assert (
        lines[0].startswith("ziglang==") and [line.split(":")[0].strip() for line in lines[1:]] == ["--hash=sha256"] * 2
    )


@pytest.mark.skipif(not Path(sysconfig.get_path("include"), "Python.h").is_file(), reason="no Python.h on this machine")
@pytest.mark.parametrize(("arch", "machine"), [("arm64", "aarch64"), ("amd64", "x86_64")])
def test_it_compiles_for_the_other_machine(
    deploy: ModuleType, with_compiler: Path, tmp_path: Path, arch: str, machine: str
) -> None:
    environment = deploy.compiler.environment(arch, tmp_path)
    assert environment["CC"] == f"{with_compiler}/ziglang/zig cc -target {machine}-linux-gnu.2.28"
    assert environment["LDSHARED"].startswith(environment["CC"]) and " -s " in environment["LDSHARED"]
    assert (tmp_path / "include" / "Python.h").is_file()
    # Debian's asks for another one, which is there for one processor alone.
    assert "linux-gnu" not in (tmp_path / "include" / "pyconfig.h").read_text().split("#define")[0]
    # What Debian's control file promises of the machine, and what was compiled for, are the same C library.
    assert f"libc6 (>= {deploy.compiler.GLIBC})" in (ROOT / "deploy/debian/control").read_text()


def test_a_release_without_the_kernels_is_no_secret(
    deploy: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """PyPI's part is played by a function here: what pip builds with a compiler that fails, as it was seen to."""
    monkeypatch.setattr(sysconfig, "get_path", lambda _name: str(tmp_path / "no-headers"))
    seen = []

    def pip(*words: str | Path, environment: dict[str, str] | None = None) -> str:
        if words[0] == "wheel":
            seen.append(environment)
            with zipfile.ZipFile(tmp_path / "sagnode-1-cp311-abi3-manylinux_2_28_aarch64.whl", "w") as wheel:
                wheel.writestr("sagnode/native/__init__.py", "")
        return ""

    monkeypatch.setattr(deploy, "pip", pip)
    assert deploy.make_wheel(deploy.SUITES["trixie"], "arm64", tmp_path).exists()
    said = capsys.readouterr().err
    assert "WARNING: arm64 WITHOUT COMPILED KERNELS" in said and "Python.h: apt install" in said
    # This machine's own compiler must not step in: it compiles for another processor.
    assert seen[0] is not None and seen[0]["CC"] == "false"


def test_nothing_that_was_compiled_here_gets_into_a_release(deploy: ModuleType, tmp_path: Path) -> None:
    source = deploy._clean_source(tmp_path)
    assert (source / "src/sagnode/native/module.c").is_file()
    assert not [*source.rglob("*.so"), *source.rglob("__pycache__")]
