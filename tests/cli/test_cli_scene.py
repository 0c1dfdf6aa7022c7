"""``sagnode scene``: the same words give the same pixels, and the truth stands beside them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sagnode.cli.main import main

CONFIGS = Path(__file__).parents[2] / "configs"
WORDS = ["scene", "--config", str(CONFIGS / "lab"), "--backdrop", "plain", "--format", "png", "--sag", "0.07:0.09"]


def test_the_same_words_give_the_same_bytes_and_another_seed_others(tmp_path: Path) -> None:
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        assert main([*WORDS, "--frames", "2", "--out", str(tmp_path / name), "--seed", seed]) == 0
    a, b, c = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in "abc")
    assert len(a) == 4
    assert a == b
    assert a != c


def test_the_truth_says_what_was_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--frames", "3", "--out", str(tmp_path), "--errors", "0"]) == 0
    paths = [Path(line) for line in capsys.readouterr().out.splitlines()]
    sags = [json.loads(p.with_suffix(".json").read_text())["conductors"]["left"]["sag_m"] for p in paths]
    assert sags == pytest.approx([0.07, 0.08, 0.09], abs=1e-4)


def test_a_day_needs_stringing_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--out", str(tmp_path), "--day", "2026-06-21"]) == 2
    assert "without stringing and unit_weight_n_m" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["--sag", "deep"],
        ["--sag", "-1"],
        ["--sag", "3:"],
        ["--frames", "0"],
        ["--cloud", "2"],
        ["--every", "nan"],
        ["--every", "1e300"],
        ["--seed", "-1"],
        ["--day", "tomorrow"],
        ["--errors", "-1"],
    ],
)
def test_nonsense_is_a_usage_error(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--out", str(tmp_path), *words]) == 2
    assert f"argument {words[0]}" in capsys.readouterr().err
