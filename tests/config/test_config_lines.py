"""Lines of keys in TOML texts."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.config.lines import key_lines, nearest_line
from sagnode.config.show import toml_text

TEXT = (
    "# a comment = 1\n"
    'name = "a # b"   # x = 1\n'
    'long = """\nfake = 1\n[fake.table]\n\\""" two quotes ""\n"""\n'
    "'quoted key' = 'C:\\'\n"
    "inline = { a = 1, b = { c = [1, 2] } }\n"
    "dotted.key.path = 1\n"
    "\n"
    "[table]\n"
    "list = [  # comment, with ] and ,\n"
    "  [0, 1],\n"
    "  [2,\n   3],\n"
    "]\n"
    "time = 2026-06-21T04:00:00Z\n"
    "[[many]]\n"
    "id = 1\n"
    "[many.below]\n"
    "x = 1\n"
    "[[many]]\n"
    "id = 2\n"
    "[many.below]\n"
    "y = 1\n"
)


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("name",), 2),
        (("long",), 3),
        (("quoted key",), 8),
        (("inline", "b", "c", 1), 9),
        (("dotted", "key", "path"), 10),
        (("table",), 12),
        (("table", "list", 0), 14),
        (("table", "list", 1, 1), 16),
        (("table", "time"), 18),
        (("many", 0, "id"), 20),
        (("many", 0, "below", "x"), 22),
        (("many", 1), 23),
        (("many", 1, "below"), 25),
        (("many", 1, "below", "y"), 26),
    ],
)
def test_every_kind_of_key_has_its_line(path: tuple[str | int, ...], line: int) -> None:
    tomllib.loads(TEXT)  # the text itself is right
    assert key_lines(TEXT)[path] == line


def test_nothing_in_strings_and_comments_is_taken_for_a_key() -> None:
    names = {part for path in key_lines(TEXT) for part in path}
    assert not {"fake", "x = 1", "a comment"} & names


def test_windows_line_ends_count_once() -> None:
    assert key_lines("a = 1\r\nb = 2\r\n")[("b",)] == 2


def test_a_missing_key_is_placed_at_its_table() -> None:
    lines = key_lines("[a]\nb = 1\n")
    assert nearest_line(lines, ("a", "missing")) == 1
    assert nearest_line(lines, ("missing",)) is None


SCALARS = st.one_of(
    st.integers(-(2**60), 2**60), st.floats(allow_nan=False, allow_infinity=False), st.booleans(), st.text(max_size=12)
)
NAMES = st.from_regex(r"[A-Za-z0-9_-]{1,6}", fullmatch=True)
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4), max_leaves=6)
TABLES = st.recursive(
    st.dictionaries(NAMES, VALUES, max_size=4),
    lambda inner: st.dictionaries(NAMES, st.one_of(VALUES, inner, st.lists(inner, min_size=1, max_size=3)), max_size=4),
    max_leaves=8,
)


def _paths(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    if isinstance(value, dict):
        return [p for k, v in value.items() for p in [(*path, k), *_paths(v, (*path, k))]]
    if isinstance(value, list):
        return [p for i, v in enumerate(value) for p in [(*path, i), *_paths(v, (*path, i))]]
    return []


@settings(max_examples=150, deadline=None)
@given(TABLES)
def test_every_key_of_any_document_is_found_on_a_line_that_names_it(table: dict[str, Any]) -> None:
    text = toml_text(table)
    assert tomllib.loads(text) == table
    lines, rows = key_lines(text), text.split("\n")
    for path in _paths(table):
        line = lines[path]
        if isinstance(path[-1], str):
            assert path[-1] in rows[line - 1]
