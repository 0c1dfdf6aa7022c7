"""The lanes of make test-platform: their scripts are there, what is missing is told, the document is of results."""

from __future__ import annotations

import importlib.util
import json
import os
import time
from pathlib import Path
from types import ModuleType

import pytest

HERE = Path(__file__).parent


@pytest.fixture
def lanes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("platform_lanes", HERE / "lanes.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.syspath_prepend(str(HERE))
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(module, "DOCUMENT", tmp_path / "platform.md")
    module.DOCUMENT.write_text(f"before\n{module.BEGIN}\nold\n{module.END}\nafter\n")
    return module


def test_every_lane_calls_scripts_that_are_there(lanes: ModuleType) -> None:
    for lane in lanes.lanes():
        for command in lane.commands:
            for word in command:
                if word.startswith(("tests/", "deploy/")):
                    assert (lanes.ROOT / word).is_file(), word
                elif word.startswith("vm_"):
                    assert (HERE / word).is_file(), word


def test_what_a_lane_said_is_shown_and_a_failure_is_one(
    lanes: ModuleType, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    script = "echo 'ok    it works'; echo 'ok       doctor: chatter'; echo noise"
    good = lanes.Lane("good", "that it works", (("sh", "-c", script),), ("sh",), root=False)
    bad = lanes.Lane("bad", "a failure", (("sh", "-c", "echo 'FAIL  broken'; exit 3"), ("touch", "x")), (), root=False)
    poor = lanes.Lane("poor", "what cannot run", (("true",),), ("no-such-program",), root=False)
    monkeypatch.setattr(lanes, "lanes", lambda: (good, bad, poor))
    assert lanes.main([]) == 1
    text = lanes.DOCUMENT.read_text()
    assert text.startswith("before\n") and text.endswith(f"{lanes.END}\nafter\n") and "old" not in text
    assert "- it works" in text and "chatter" not in text and "noise" not in text
    assert "| FAILED |" in text and "- FAIL broken" in text
    assert "not run: needs apt install no-such-program" in text
    assert "1 passed, 2 failed" in capfd.readouterr().out
    # one lane alone keeps what the others showed
    assert lanes.main(["good"]) == 0
    assert "| FAILED |" in lanes.DOCUMENT.read_text()
    assert json.loads((lanes.KEPT / "good.json").read_text())["result"] == "fine"
    assert lanes.main(["nonsense"]) == 2


def test_lanes_run_beside_each_other_but_for_those_of_one_root(
    lanes: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def lane(name: str, script: str, root: str, *after: str) -> object:
        commands = (("sh", "-c", script),)
        return lanes.Lane(name, name, commands, (), root=False, uses=frozenset({root}), after=after)

    here = tmp_path
    # One that waits for the other to have begun, one that must find the root left alone, one that needs a result.
    meets = f"touch {here}/one; until [ -e {here}/other ]; do sleep 0.02; done; sleep 0.2; rm {here}/one"
    every = (
        lane("last", f"test -e {here}/made", "c", "maker"),
        lane("one", meets, "a"),
        lane("other", f"touch {here}/other; until [ -e {here}/one ]; do sleep 0.02; done", "b"),
        lane("again", f"! test -e {here}/one", "a"),
        lane("maker", f"touch {here}/made", "d"),
    )
    monkeypatch.setattr(lanes, "lanes", lambda: every)
    monkeypatch.setenv("JOBS", "3")
    assert lanes.main([]) == 0
    assert "3 lanes at a time" in lanes.DOCUMENT.read_text()


def test_a_lane_that_does_not_end_is_ended_with_all_its_children(
    lanes: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    script = f"sh -c 'echo $$ >{tmp_path}/child; exec sleep 100' & echo 'ok    begun'; wait"
    slow = lanes.Lane("slow", "what hangs", (("sh", "-c", script),), (), root=False, limit_s=1.4)
    monkeypatch.setattr(lanes, "lanes", lambda: (slow,))
    assert lanes.main([]) == 1
    assert "not run: needs more than its 1 s on this machine" in lanes.DOCUMENT.read_text()
    child = int((tmp_path / "child").read_text())
    for _ in range(100):
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise AssertionError("a child goes on")


def test_what_cannot_run_here_is_skipped_aloud_where_that_is_asked_for(
    lanes: ModuleType, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    poor = lanes.Lane("poor", "what cannot run", (("true",),), ("no-such-program",), root=False)
    says = ("sh", "-c", "echo 'ok    half'; echo 'skipped: needs a moon'; exit 77")
    moon = lanes.Lane("moon", "what finds out by itself", (says, ("touch", "x")), (), root=False)
    bad = lanes.Lane("bad", "a failure", (("false",),), (), root=False)
    monkeypatch.setattr(lanes, "lanes", lambda: (poor, moon, bad))
    before = lanes.DOCUMENT.read_text()
    assert lanes.main(["--possible", "poor", "moon"]) == 0
    said = capfd.readouterr().out
    assert "lane poor: skipped: needs apt install no-such-program" in said
    assert "lane moon: skipped: needs a moon" in said
    assert said.endswith("no lane could run here\n")
    assert lanes.main(["--possible", "moon", "bad"]) == 1
    assert capfd.readouterr().out.endswith("0 passed, 1 failed, 1 skipped\n")
    assert lanes.DOCUMENT.read_text() == before and not list(lanes.KEPT.glob("*.json"))
    # without it, a lane that cannot run is a failure
    assert lanes.main(["moon"]) == 1
    assert "not run: needs a moon" in lanes.DOCUMENT.read_text()
