"""The frame of the command line: help, versions, exit codes, and never a traceback."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sagnode import __version__
from sagnode.cli import main as cli
from sagnode.errors import ConfigError, JournalError

PRESENT = [name for name in cli.NAMES if (Path(cli.__file__).parent / f"{name}.py").exists()]


def sagnode(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sagnode", *words],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )


def test_version_and_help() -> None:
    assert sagnode("--version").stdout == f"sagnode {__version__}\n"
    done = sagnode("--help")
    assert done.returncode == 0
    for name in cli.NAMES:
        assert f"\n  {name} " in done.stdout
    assert max(len(line) for line in done.stdout.splitlines()) <= 100


def test_no_command_shows_the_help_and_is_a_usage_error() -> None:
    done = sagnode()
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("usage: sagnode COMMAND")


@pytest.mark.parametrize(
    ("word", "text"),
    [
        ("mesure", "unknown command 'mesure'; did you mean 'measure'?"),
        ("xyzzy", "unknown command 'xyzzy'; sagnode --help lists them all"),
        ("--verbose", "unknown option --verbose; sagnode --help lists the commands"),
    ],
)
def test_unknown_words(word: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([word]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize("name", PRESENT)
def test_every_command_has_a_help_of_its_own_and_the_line_of_the_table(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([name, "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"usage: sagnode {name}")
    assert cli.main(["help", name]) == 0
    assert importlib.import_module(f"sagnode.cli.{name}").DESCRIPTION


def test_version_and_help_import_nothing_heavy() -> None:
    code = (
        "import sys; from sagnode.cli.main import main; main(['--version']); main(['--help']);"
        "print([m for m in ('numpy', 'cv2', 'pydantic', 'paho', 'apscheduler') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("[]\n")


class _Failing:
    """A command that fails as told."""

    DESCRIPTION = "fails"

    def __init__(self, error: BaseException) -> None:
        self._error = error

    def add_arguments(self, parser: object) -> None:
        pass

    def run(self, args: object) -> int:
        raise self._error


@pytest.mark.parametrize(
    ("error", "code", "lines"),
    [
        (
            ConfigError("2 faults in the configuration c.toml", "mend this", ("c.toml:1: a", "c.toml:2: b")),
            2,
            [
                "sagnode: error: 2 faults in the configuration c.toml",
                "  c.toml:1: a",
                "  c.toml:2: b",
                "remedy: mend this",
            ],
        ),
        (ConfigError("c.toml:1: a"), 2, ["sagnode: error: c.toml:1: a"]),
        (JournalError("no journal", "start it"), 1, ["sagnode: error: no journal", "remedy: start it"]),
        (KeyboardInterrupt(), 130, []),
        (SystemExit(3), 3, []),
    ],
)
def test_failures_become_a_line_and_a_code(
    error: BaseException,
    code: int,
    lines: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(cli.importlib, "import_module", lambda _: _Failing(error))
    assert cli.main(["status"]) == code
    assert capsys.readouterr().err.splitlines() == lines


def test_a_defect_is_one_line_and_its_traceback_is_for_those_who_ask(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli.importlib, "import_module", lambda _: _Failing(ZeroDivisionError("division by zero")))
    monkeypatch.delenv("SAGNODE_DEBUG", raising=False)
    assert cli.main(["status"]) == 70
    said = capsys.readouterr().err
    assert said.startswith("sagnode: error: unexpected ZeroDivisionError: division by zero (at main.py:")
    assert "Traceback" not in said
    monkeypatch.setenv("SAGNODE_DEBUG", "1")
    cli.main(["status"])
    assert "Traceback (most recent call last)" in capsys.readouterr().err


def test_a_reader_that_goes_away_is_no_error() -> None:
    code = f"{sys.executable} -m sagnode schema | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.strip() in {"0", "141"}


@pytest.mark.parametrize("streams", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed_are_no_error(streams: str) -> None:
    command = f'"{sys.executable}" -m sagnode schema reading {streams}'
    result = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize("words", ["--version", "--help", "schema reading"])
def test_output_that_finds_no_room_is_said_in_a_line(words: str) -> None:
    command = f'"{sys.executable}" -m sagnode {words} > /dev/full'
    result = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert result.stderr == "sagnode: error: cannot write to standard output: No space left on device\n"


def test_a_program_that_asked_for_json_gets_its_error_as_json(capsys, tmp_path):
    assert cli.main(["status", "--json", "--state-dir", str(tmp_path / "nope")]) == 2
    said = capsys.readouterr()
    document = json.loads(said.out)
    assert document["schema_version"] == "sagnode.error/1"
    assert "no such directory" in document["error"]
    assert document["remedy"]
    assert said.err.startswith("sagnode: error: ")


SAGNODE = f"{sys.executable} -m sagnode"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("status --state-dir {empty} >&-", 1),
        ("status --state-dir {empty} 2>&-", 1),
        ("status --state-dir {empty} >&- 2>&-", 1),
        ("schema >&-", 0),
        ("status --state-dir {empty}/nowhere 2>&-", 2),
    ],
)
def test_a_closed_output_is_no_defect(tmp_path: Path, words: str, code: int) -> None:
    line = f"{SAGNODE} {words.format(empty=tmp_path)}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert "unexpected" not in done.stderr
