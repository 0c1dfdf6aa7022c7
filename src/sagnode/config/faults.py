"""Faults of configuration files: where, what, and what would be valid; one sentence each."""

from __future__ import annotations

import difflib
import tomllib
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from sagnode.config.lines import KeyPath


@dataclass(frozen=True)
class Fault:
    """One fault of one file."""

    path: Path
    """The file."""
    line: int | None
    """Its line, from 1, where the fault can be found in it."""
    key: str
    """Key path such as ``conductors[0].near``; empty for the file as a whole."""
    text: str
    """What is wrong and what would be valid."""

    def __str__(self) -> str:
        place = f"{self.path}:{self.line}" if self.line else f"{self.path}"
        return f"{place}: {self.key}: {self.text}" if self.key else f"{place}: {self.text}"


@dataclass(frozen=True)
class Unreadable(Fault):
    """A file that cannot be had at all: its sentence names it."""

    def __str__(self) -> str:
        return self.text


def key_text(path: Iterable[str | int]) -> str:
    """A key path as a person writes it.

    >>> key_text(("conductors", 0, "near"))
    'conductors[0].near'
    """
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def toml_fault(path: Path, error: tomllib.TOMLDecodeError) -> Fault:
    """The fault of a text that is not TOML; the parser's message names line and column."""
    message, _, place = str(error).partition(" (at ")
    line = place.removeprefix("line ").split(",")[0]
    column = place.rpartition("column ")[2].rstrip(")")
    at = f" at column {column}" if column.isdigit() else " at the end of the file"
    hint = "; TOML wants strings in quotes, 'true' and 'false' in small letters and a dot in decimal numbers"
    return Fault(path, int(line) if line.isdigit() else None, "", f"not TOML: {message}{at}{hint}")


def suggestion(model: type[BaseModel], location: KeyPath) -> str | None:
    """The key of the same table that an unknown key was probably meant to be."""
    table = _table_at(model, location[:-1])
    if table is None:
        return None
    near = difflib.get_close_matches(str(location[-1]), list(table.model_fields), n=1, cutoff=0.6)
    return near[0] if near else None


def unknown_key_text(model: type[BaseModel], location: KeyPath) -> str:
    """Sentence for a key that does not exist."""
    near = suggestion(model, location)
    if near:
        return f"unknown key; did you mean '{near}'?"
    table = _table_at(model, location[:-1])
    known = f"; known here: {', '.join(table.model_fields)}" if table else ""
    return f"unknown key{known}"


def sentence(model: type[BaseModel], error: ErrorDetails) -> str:
    """What pydantic found, as one sentence with the value and what would be valid."""
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    if kind == "missing":
        meaning = _meaning(model, error["loc"])
        return f"is missing{f' ({meaning})' if meaning else ''}"
    if kind == "value_error":
        # A model's own words; for a whole table the value would be the table, which helps nobody.
        said = str(context["error"])
        return said if isinstance(value, Mapping | list) else f"{_shown(value)}: {said}"
    rule = _rule(kind, context) or error["msg"]
    return rule if isinstance(value, Mapping | list) and value else f"{_shown(value)}: {rule}"


def _rule(kind: str, context: Mapping[str, Any]) -> str | None:
    """What pydantic's error type asks for, in plain words; None for the kinds that speak for themselves."""
    rules = {
        "greater_than": "must be greater than {gt}",
        "greater_than_equal": "must be {ge} or more",
        "less_than": "must be less than {lt}",
        "less_than_equal": "must be {le} or less",
        "literal_error": "must be {expected}",
        "enum": "must be {expected}",
        "finite_number": "must be a finite number",
        "float_type": "must be a number",
        "float_parsing": "must be a number",
        "int_type": "must be a whole number",
        "int_from_float": "must be a whole number",
        "int_parsing": "must be a whole number",
        "int_parsing_size": "is too large",
        "bool_type": "must be true or false",
        "string_type": "must be text in quotes",
        "path_type": "must be a file name in quotes",
        "string_pattern_mismatch": "must be 1 to 64 letters, digits, '.', '_' and '-', a letter or digit first",
        "string_too_short": "must have at least {min_length} character(s)",
        "string_too_long": "must have at most {max_length} character(s)",
        "tuple_type": "must be a list in square brackets",
        "model_type": "must be a table",
        "model_attributes_type": "must be a table",
        "dataclass_type": "must be a table",
        "too_short": "must have at least {min_length} element(s), and has {actual_length}",
        "too_long": "must have at most {max_length} element(s), and has {actual_length}",
    }
    return rules[kind].format(**context) if kind in rules else None


def _shown(value: object) -> str:
    """A value as TOML would show it, cut to a readable length."""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _table_at(model: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    """The model of the table at a key path."""
    here: type[BaseModel] | None = model
    for part in path:
        if isinstance(part, int):
            continue
        field = here.model_fields.get(part) if here else None
        here = _model_in(field.annotation) if field else None
    return here


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model inside ``Model``, ``Model | None`` or ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, BaseModel) else None
    found = (_model_in(argument) for argument in typing.get_args(annotation) if argument is not Ellipsis)
    return next((model for model in found if model), None)


def _meaning(model: type[BaseModel], location: KeyPath) -> str:
    """First sentence of what a field is documented to be."""
    table = _table_at(model, location[:-1])
    field = table.model_fields.get(str(location[-1])) if table else None
    inner = _model_in(field.annotation) if field else None
    text = (field.description if field else None) or (inner.__doc__ if inner else None) or ""
    return text.strip().split("\n")[0].rstrip(".")
