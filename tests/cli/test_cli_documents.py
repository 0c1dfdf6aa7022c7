"""Every document: its links lead somewhere, its files exist, and its commands are understood as they are printed."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path

import pytest

from sagnode.cli.main import NAMES, parser_of

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
DOCUMENTS += [*sorted((ROOT / "configs").rglob("*.md")), *sorted((ROOT / "deploy").rglob("*.md"))]
PLACES = "benchmarks|configs|deploy|docs|scripts|src|systemd|tests"


def lines_of_code(text: str) -> list[str]:
    """Lines of fenced and of indented blocks."""
    fenced = re.findall(r"^ *```sh$(.*?)^ *```$", text, re.MULTILINE | re.DOTALL)
    indented = re.findall(
        r"^    (\S.*)$", re.sub(r"^ *```.*?^ *```$", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE
    )
    return [line for block in [*fenced, *indented] for line in block.splitlines()]


def commands(text: str) -> list[list[str]]:
    """The words after every ``sagnode``, without what a shell takes for itself."""
    found = []
    for line in lines_of_code(text):
        try:
            lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
            lexer.whitespace_split = True
            words = list(lexer)
        except ValueError:  # a quote that goes on in the next line
            continue
        own: list[str] = []
        for word in [*words, ";"]:
            if set(word) <= set(";&|<>()"):
                if own[:1] == ["sagnode"]:
                    found.append(own[1:])
                own = []
            elif own or word != "sudo":
                own.append(word)
    return found


def name(document: Path) -> str:
    return str(document.relative_to(ROOT))


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_every_link_leads_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text(encoding="utf-8")):
        file, _, heading = target.partition("#")
        if "://" in target:
            continue
        there = document.parent / file if file else document
        assert there.exists(), target
        if heading:
            headings = re.findall(r"^#+ (.+)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}, target


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if d.parent.name != "decisions"], ids=name)
def test_every_file_of_the_repository_that_is_named_is_there(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    for words in re.findall(r"`([^`\n]+)`", text):
        for file in re.findall(rf"(?<![\w/.-])((?:{PLACES})/[\w./*-]*[\w/])", words):
            assert next(ROOT.glob(file), None), file


def test_every_command_is_understood_as_it_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    understood: set[str] = set()
    for document in DOCUMENTS:
        for first, *rest in commands(document.read_text(encoding="utf-8")):
            assert first in NAMES, f"{name(document)}: sagnode {first}"
            module = importlib.import_module(f"sagnode.cli.{first}")
            try:
                parser_of(first, module).parse_args(getattr(module, "arrange", list)(rest))
            except SystemExit:
                pytest.fail(f"{name(document)}: sagnode {first} {shlex.join(rest)}: {capsys.readouterr().err}")
            understood.add(first)
    assert len(understood) > 10
