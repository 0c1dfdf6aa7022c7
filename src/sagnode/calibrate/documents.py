"""YAML, XML and JSON as OpenCV's FileStorage and ROS write them, as plain dictionaries.

OpenCV's own reader refuses the YAML of ROS (no ``%YAML`` line) and reports faults on standard error without a name, so
the three notations are read by their own parsers; a matrix becomes ``{"rows": r, "cols": c, "data": [...]}``.
"""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import yaml

MAX_BYTES = 1_000_000


class NotReadableError(ValueError):
    """The text is not YAML, XML or JSON; says where it stops being so."""


def parse_document(text: str) -> dict[str, object]:
    """The top-level keys of a calibration file.

    Raises:
        NotReadableError: not one of the three notations, or no keys at its top.
    """
    start = text.lstrip("\ufeff \t\r\n")
    if not start:
        raise NotReadableError("is empty")
    if start.startswith("<"):
        return _xml(start)
    document = _json(start) if start.startswith("{") else _yaml(start)
    if not isinstance(document, dict):
        raise NotReadableError("holds no keys such as camera_matrix")
    return {str(key): value for key, value in document.items()}


def _json(text: str) -> object:
    try:
        return json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise NotReadableError(f"is not valid JSON: {error}") from None


class _Loader(yaml.SafeLoader):
    """Safe YAML that knows OpenCV's matrices, and no aliases.

    With them a few lines stand for thousands of millions of numbers, or a list for itself.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "an alias (*name), which no calibration file needs", mark)
        return super().compose_node(parent, index)


def _matrix(loader: _Loader, node: yaml.Node) -> object:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, "an opencv-matrix without rows and cols", node.start_mark)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def _yaml(text: str) -> object:
    # OpenCV's first line, %YAML:1.0, is not a directive that YAML knows.
    text = re.sub(r"\A%YAML:.*\n", "", text)
    try:
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a SafeLoader with one more tag
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f" in line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise NotReadableError(f"is not valid YAML{where}: {error.problem}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise NotReadableError(f"is not valid YAML: {str(error).splitlines()[0]}") from None


def _xml(text: str) -> dict[str, object]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise NotReadableError("holds a document type, which no calibration file needs")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - no entities (above), at most MAX_BYTES
    except ElementTree.ParseError as error:
        raise NotReadableError(f"is not valid XML: {error}") from None
    return {child.tag: _element(child) for child in root}


def _element(element: ElementTree.Element) -> object:
    if len(element):
        return {child.tag: _element(child) for child in element}
    words = (element.text or "").split()
    return words[0] if len(words) == 1 and element.tag != "data" else words
