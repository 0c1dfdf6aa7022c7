"""The accuracy suite's command line: which worlds are the report's, and that its page names what writes it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import missed
import montecarlo
import run
from groups import GROUPS
from runner import tasks


def named_in(page: str) -> str:
    """The command at the head of a committed page."""
    found = re.search(r"^Written by `([^`]+)`", (run.DOCS / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    return found[1]


def test_the_page_names_a_command_that_writes_it_and_none_is_needed() -> None:
    named = named_in("accuracy.md")
    python, script, *words = shlex.split(named)
    assert (python, script) == ("python", "benchmarks/run.py")
    for options in (run.options_of(words), run.options_of([])):
        assert options.out == run.ROOT / "docs"
        assert run.command_of(options) == named
        assert (options.seed, options.worlds, options.groups) == (run.REPORT_SEED, run.REPORT_WORLDS, None)
        todo = tasks(options.groups, options.seed, options.worlds)
        assert len(todo) == sum(min(group.worlds, run.REPORT_WORLDS) for group in GROUPS)


def test_what_stands_beside_it_is_named_by_the_commands_of_make_accuracy() -> None:
    assert named_in("missed.md") == f"python benchmarks/missed.py --seed {missed.REPORT_SEED}"
    assert named_in("monte-carlo.md") == f"python benchmarks/montecarlo.py --draws 2000 --seed {montecarlo.SEED}"


def test_another_seed_of_the_report_is_a_report() -> None:
    options = run.options_of(["--seed", "7"])
    assert (options.seed, options.worlds, options.out) == (7, run.REPORT_WORLDS, run.DOCS)


@pytest.mark.parametrize(
    ("words", "worlds"),
    [
        (["--groups", "tower"], None),
        (["--groups", "tower", "--worlds", str(run.REPORT_WORLDS)], run.REPORT_WORLDS),
        (["--worlds", "1"], 1),
        (["--worlds", "60"], 60),
        (["--no-paper"], run.REPORT_WORLDS),
    ],
)
def test_what_is_not_the_whole_report_is_a_look_and_leaves_the_page_alone(words: list[str], worlds: int | None) -> None:
    options = run.options_of(words)
    assert options.out == options.csv.parent == run.ROOT / "out" / "bench"
    assert (options.seed, options.worlds) == (run.DEVELOPMENT_SEED, worlds)
    assert run.options_of(shlex.split(run.command_of(options))[2:]) == options


def test_a_place_that_was_asked_for_is_named(tmp_path: Path) -> None:
    options = run.options_of(["--groups", "fog", "--out", str(tmp_path / "my page")])
    assert run.command_of(options) == (
        f"python benchmarks/run.py --seed {run.DEVELOPMENT_SEED} --groups fog --out '{tmp_path}/my page'"
    )
    assert run.options_of(shlex.split(run.command_of(options))[2:]) == options
    assert "--out" not in run.command_of(run.options_of(["--out", str(run.DOCS)]))
