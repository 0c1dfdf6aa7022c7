"""No damage to a configuration ever leads to anything but a ConfigError that says where."""

from __future__ import annotations

import copy
import functools
import tempfile
from pathlib import Path
from typing import Any

from config_files import NODE, SPAN, SiteFiles
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sagnode.check.configuration import check
from sagnode.config.load import LoadedNode, load_node
from sagnode.config.show import toml_text
from sagnode.errors import ConfigError

ODD = st.one_of(
    st.floats(),
    st.integers(-(10**25), 10**25),
    st.booleans(),
    st.text(max_size=20),
    st.sampled_from(["", "../..", "/dev/null", "/", "\0", "{", "{}", "{unit.x}", "%s", "#", "* * * * *", "0 0 30 2 *"]),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.sampled_from(["id", "path", "x"]), st.integers(), max_size=2),
    st.lists(st.dictionaries(st.sampled_from(["id", "near"]), st.integers(), max_size=2), max_size=2),
)


def _places(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [p for key, inner in items for p in [(*path, key), *_places(inner, (*path, key))]]


@st.composite
def damaged(draw: st.DrawFn) -> tuple[dict[str, Any], dict[str, Any]]:
    """Node and span data with one to three keys replaced, removed, renamed or added."""
    node, span = copy.deepcopy(NODE), copy.deepcopy(SPAN)
    for _ in range(draw(st.integers(1, 3))):
        document = draw(st.sampled_from([node, span]))
        path = draw(st.sampled_from(_places(document)))
        table = functools.reduce(lambda inner, key: inner[key], path[:-1], document)
        match draw(st.sampled_from(["replace", "remove", "rename", "add"])):
            case "replace":
                table[path[-1]] = draw(ODD)
            case "remove":
                del table[path[-1]]
            case "rename" if isinstance(table, dict):
                table[draw(st.sampled_from([f"{path[-1]}s", str(path[-1])[:-1] or "x", "x"]))] = table.pop(path[-1])
            case _ if isinstance(table, dict):
                table[draw(st.sampled_from(["x", "sag", "path", "near_m"]))] = draw(ODD)
    return node, span


@functools.cache
def _files() -> SiteFiles:
    return SiteFiles(Path(tempfile.mkdtemp(prefix="sagnode-config-")) / "site")


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(damaged())
def test_damage_loads_or_is_a_config_error_that_names_the_file(
    documents: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    files = _files()
    for path, document in zip((files.node, files.span), documents, strict=True):
        path.write_text(toml_text(document), encoding="utf-8", errors="replace")
    try:
        loaded = load_node(files.directory)
    except ConfigError as error:
        assert error.faults
        assert all(str(files.directory) in fault for fault in error.faults)
        assert len(set(error.faults)) == len(error.faults)
    else:
        assert isinstance(loaded, LoadedNode)
        assert check(files.directory).loaded == loaded


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 400), st.integers(0, 60))
def test_damaged_bytes_load_or_are_a_config_error(noise: bytes, at: int, cut: int) -> None:
    files = _files()
    files.write()
    text = files.span.read_bytes()
    files.span.write_bytes(text[:at] + noise + text[at + cut :])
    try:
        load_node(files.directory)
    except ConfigError as error:
        assert all(str(files.directory) in fault for fault in error.faults)
