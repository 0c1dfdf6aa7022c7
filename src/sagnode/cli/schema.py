"""``sagnode schema``: JSON Schemas of the node's messages and of its configuration, out of the models themselves."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from sagnode.errors import SagnodeError

HELP = "JSON Schemas of the messages and of the configuration"
DESCRIPTION = """Print the JSON Schema (draft 2020-12) of one message or configuration file, or write all of them.
Editors that know TOML take those of node and span for completion; consumers generate their code from the others."""

NAMES = ("reading", "status", "health", "node", "span")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One schema by name, or all into a directory."""
    parser.add_argument("name", nargs="?", choices=NAMES, help="the one to print; without it and --out: all, by name")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write every schema to DIR/<name>.schema.json")


def run(args: argparse.Namespace) -> int:
    """Print or write."""
    if args.out:
        for path, text in schema_files(args.out).items():
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
            except OSError as error:
                raise SagnodeError(f"cannot write {path}: {error.strerror}", "choose another directory") from None
            print(f"wrote {path}")
        return 0
    everything = schemas()
    print(_text(everything[args.name] if args.name else everything), end="")
    return 0


def schemas() -> dict[str, dict[str, Any]]:
    """JSON Schema by name (:data:`NAMES`)."""
    from pydantic import BaseModel
    from pydantic.json_schema import GenerateJsonSchema

    from sagnode.config.node import Node
    from sagnode.config.span import Span
    from sagnode.message import HealthMessage, Reading, StatusMessage

    models: dict[str, type[BaseModel]] = dict(
        zip(NAMES, (Reading, StatusMessage, HealthMessage, Node, Span), strict=True)
    )
    dialect = {"$schema": GenerateJsonSchema.schema_dialect}
    return {
        name: dialect
        | model.model_json_schema(mode="serialization" if name in {"reading", "status", "health"} else "validation")
        for name, model in models.items()
    }


def schema_files(directory: Path) -> dict[Path, str]:
    """The files that ``--out`` writes, with their content."""
    return {directory / f"{name}.schema.json": _text(schema) for name, schema in schemas().items()}


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"
