"""The lanes of make test-platform: their scripts are there, what is missing is told, the document is of results."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

HERE = Path(__file__).parent


@pytest.fixture
def lanes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("platform_lanes", HERE / "lanes.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "platform_lanes", module)  # dataclasses look their module up
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
