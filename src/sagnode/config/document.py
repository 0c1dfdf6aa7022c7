"""One TOML file on its way to a strict model, collecting every fault that it holds."""

from __future__ import annotations

import copy
import datetime
import json
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from sagnode.config.faults import Fault, Unreadable, key_text, sentence, suggestion, toml_fault, unknown_key_text
from sagnode.config.lines import KeyPath, key_lines, nearest_line

ModelT = TypeVar("ModelT", bound=BaseModel)
Contradictions = Callable[[dict[str, Any]], Iterable[tuple[str, str]]]


@dataclass
class Document:
    """A TOML file, parsed, with the faults met so far."""

    path: Path
    data: dict[str, Any] | None = None
    """None when the file cannot be read or is not TOML."""
    lines: dict[KeyPath, int] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)

    def blame(self, key: KeyPath, text: str) -> None:
        """Add a fault at a key path (empty: the file as a whole)."""
        self.faults.append(self.fault(key, text))

    def fault(self, key: KeyPath, text: str) -> Fault:
        """A sentence about a key path of this file, with its line."""
        return Fault(self.path, nearest_line(self.lines, key), key_text(key), text)


def read_document(path: Path) -> Document:
    """Read and parse a TOML file; what is wrong with it as TOML is its first and only fault."""
    document = Document(path)
    content = read_file(path)
    if isinstance(content, str):
        document.faults.append(Unreadable(path, None, "", content))
        return document
    try:
        # A byte order mark is what Windows' Notepad puts in front.
        text = content.decode("utf-8-sig")
        document.data = tomllib.loads(text)
        _json(document.data)
        document.lines = key_lines(text)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        document.faults.append(Fault(path, line, "", "not UTF-8 text; save the file in the encoding UTF-8"))
    except tomllib.TOMLDecodeError as error:
        document.faults.append(toml_fault(path, error))
    except ValueError:  # Python turns no number of more than some thousand digits into text or out of it
        document.data = None
        document.blame((), "holds a number of thousands of digits, which cannot be read")
    except RecursionError:
        document.blame((), "brackets are nested too deeply to be a configuration")
    return document


def read_file(path: Path) -> bytes | str:
    """The content of a file, or a sentence that says why it cannot be had."""
    try:
        if path.exists() and not path.is_file():
            return f"{path} is {'a directory' if path.is_dir() else 'no regular file'}; name a file"
        content = path.read_bytes()
    except FileNotFoundError:
        return f"file not found: {path}"
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        return f"{path} cannot be read: {getattr(error, 'strerror', None) or error}"
    return content or f"{path} is empty"


def validate(document: Document, model: type[ModelT], contradictions: Contradictions) -> ModelT | None:
    """The document as a model, or None with every fault added to the document.

    A misspelt key is set right (or aside) and the rest looked at again, so that it hides no other fault and does not
    count a second time as a missing key. Contradictions between tables are looked for even while single tables are
    at fault, hence their own function: it gets the parsed data and yields (table, sentence).
    """
    if document.data is None:
        return None
    data = copy.deepcopy(document.data)
    faults_before = len(document.faults)
    while True:
        valid, errors = _attempt(model, data)
        unknown = [error for error in errors if error["type"] == "extra_forbidden"]
        for error in unknown:
            _report_unknown(document, model, error["loc"])
            _set_right(document, model, data, error["loc"])
        if not unknown:
            break
    for error in errors:
        if not _is_echo(error, errors):
            document.blame(error["loc"], sentence(model, error))
    for where, text in contradictions(data):
        document.blame(tuple(where.split(".")), text)
    document.faults.sort(key=lambda fault: fault.line or 0)
    return valid if len(document.faults) == faults_before else None


def _is_echo(error: ErrorDetails, errors: list[ErrorDetails]) -> bool:
    """Whether an error only repeats others: a list called too short for its elements at fault, or a contradiction."""
    location = error["loc"]
    if error["type"] == "too_short":
        return any(len(e["loc"]) > len(location) and e["loc"][: len(location)] == location for e in errors)
    # The file as a whole is judged by its own function, contradiction by contradiction.
    return not location and error["type"] == "value_error"


def salvage(model: type[ModelT], data: object) -> ModelT | None:
    """One table as its model, None if it is not in order (which is reported elsewhere)."""
    return _attempt(model, data)[0]


def salvage_list(model: type[ModelT], data: object) -> list[ModelT]:
    """Those tables of an array that are in order."""
    tables = (salvage(model, element) for element in (data if isinstance(data, list) else ()))
    return [table for table in tables if table is not None]


def _attempt(model: type[ModelT], data: object) -> tuple[ModelT | None, list[ErrorDetails]]:
    # By way of JSON, for there strict means what TOML's types mean: no text for a number, no 1 for true, but a list
    # for a tuple, text for a path, and a whole number for a float.
    try:
        return model.model_validate_json(_json(data), strict=True), []
    except ValidationError as error:
        return None, error.errors()


def _json(data: object) -> str:
    return json.dumps(data, default=_as_text)


def _as_text(value: object) -> str:
    """TOML's dates and times as text; no other type of TOML is unknown to JSON."""
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    raise TypeError(f"no TOML value: {type(value).__name__}")


def _report_unknown(document: Document, model: type[BaseModel], location: KeyPath) -> None:
    document.blame(location, unknown_key_text(model, location))


def _set_right(document: Document, model: type[BaseModel], data: Any, location: KeyPath) -> None:
    """Rename a misspelt key to what was meant, unless that is there too; remove a key that nothing resembles."""
    table = data
    for part in location[:-1]:
        table = table[part]
    wrong, right = str(location[-1]), suggestion(model, location)
    value = table.pop(wrong)
    if right is None or right in table:
        return
    table[right] = value
    renamed = (*location[:-1], right)
    for key, line in list(document.lines.items()):
        if key[: len(location)] == location:
            document.lines[(*renamed, *key[len(location) :])] = line
