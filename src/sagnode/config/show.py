"""The configuration in effect: every value with its default filled in, or only what differs from the defaults."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from sagnode.config.load import LoadedNode, LoadedSpan

SCHEMA_VERSION = "sagnode.configuration/1"


def as_document(loaded: LoadedNode | LoadedSpan, *, changed: bool = False) -> dict[str, Any]:
    """The configuration as JSON-ready data: ids, paths, ``node`` (where there is one) and ``span``.

    Args:
        loaded: what was read; its file names are absolute.
        changed: leave out what has its default value.
    """
    document: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "configuration_id": loaded.configuration_id}
    if isinstance(loaded, LoadedNode):
        document |= {
            "node_path": str(loaded.path),
            "span_path": str(loaded.span_path),
            "node": _values(loaded.node, changed),
        }
    else:
        document["span_path"] = str(loaded.path)
    document["span"] = _values(loaded.span, changed)
    return document


def as_toml(loaded: LoadedNode | LoadedSpan, *, changed: bool = False) -> str:
    """The same as TOML, the span file after the node file, each below a comment with its path."""
    document = as_document(loaded, changed=changed)
    names = [name for name in ("node", "span") if name in document]
    parts = (f"# {name}: {document[f'{name}_path']}\n{toml_text(document[name])}" for name in names)
    return "\n".join((f"# configuration {document['configuration_id']}", *parts))


def toml_text(table: dict[str, Any]) -> str:
    """TOML of nested tables, lists and scalars (no None): plain values first, then a header for every table.

    >>> print(toml_text({"a": {"b": [1, 2.5]}, "c": "d"}), end="")
    c = "d"
    <BLANKLINE>
    [a]
    b = [1, 2.5]
    """
    return "\n".join(_table_lines(table, ())).strip("\n") + "\n"


def _values(model: BaseModel, changed: bool) -> dict[str, Any]:
    # An unset optional value has no TOML; leaving it out means the same.
    return model.model_dump(mode="json", exclude_none=True, exclude_defaults=changed)


def _table_lines(table: dict[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    plain = {key: value for key, value in table.items() if not _is_tables(value)}
    for key, value in plain.items():
        yield f"{key} = {_value_text(value)}"
    for key, value in table.items():
        here = (*path, key)
        if isinstance(value, dict):
            yield from ("", f"[{'.'.join(here)}]")
            yield from _table_lines(value, here)
        elif key not in plain:
            for element in value:
                yield from ("", f"[[{'.'.join(here)}]]")
                yield from _table_lines(element, here)


def _is_tables(value: object) -> bool:
    if isinstance(value, list):
        return bool(value) and all(isinstance(element, dict) for element in value)
    return isinstance(value, dict)


def _value_text(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_value_text(element) for element in value)}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_value_text(inner)}' for key, inner in value.items())} }}"
    if isinstance(value, float):
        return repr(value)
    # JSON's strings are TOML's but for DEL, which TOML wants escaped; whole numbers and booleans are the same.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
