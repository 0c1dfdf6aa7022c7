"""``sagnode schema``: JSON Schemas of the node's messages and of its configuration, out of the models themselves."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from sagnode.errors import SagnodeError

DESCRIPTION = """Print the JSON Schema (draft 2020-12) of one message or configuration file, the AsyncAPI 3 document
of everything on MQTT (asyncapi), or write all of them. Editors that know TOML take those of node and span for
completion; consumers generate their code from the others."""

MESSAGES = ("reading", "status", "health", "alarm", "command", "reply")
NAMES = (*MESSAGES, "node", "span", "asyncapi")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One schema by name, or all into a directory."""
    parser.add_argument("name", nargs="?", choices=NAMES, help="which one; without it all")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write <name>.schema.json, asyncapi.json there")


def run(args: argparse.Namespace) -> int:
    """Print or write."""
    if args.out:
        for path, text in schema_files(args.out, args.name).items():
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
    from pydantic import BaseModel, TypeAdapter
    from pydantic.json_schema import GenerateJsonSchema

    from sagnode import __version__
    from sagnode.asyncapi import asyncapi_document, plain
    from sagnode.config.node import Node
    from sagnode.config.span import Span
    from sagnode.exchange import COMMAND, AlarmMessage, ReplyMessage
    from sagnode.message import HealthMessage, Reading, StatusMessage

    sent: dict[str, type[BaseModel]] = {"reading": Reading, "status": StatusMessage, "health": HealthMessage}
    sent |= {"alarm": AlarmMessage, "reply": ReplyMessage}
    read: dict[str, TypeAdapter[Any]] = {"command": COMMAND, "node": TypeAdapter(Node), "span": TypeAdapter(Span)}
    found = {name: model.model_json_schema(mode="serialization") for name, model in sent.items()}
    found |= {name: adapter.json_schema(mode="validation") for name, adapter in read.items()}
    dialect = {"$schema": GenerateJsonSchema.schema_dialect}
    documents = {name: dialect | plain(schema) for name, schema in found.items()}
    documents["asyncapi"] = asyncapi_document(__version__)
    return {name: documents[name] for name in NAMES}


def schema_files(directory: Path, only: str | None = None) -> dict[Path, str]:
    """The files that ``--out`` writes, with their content."""
    return {directory / file_name(name): _text(schema) for name, schema in schemas().items() if only in {None, name}}


def file_name(name: str) -> str:
    """The file of one of :data:`NAMES`; only what is a JSON Schema is called so."""
    return f"{name}.json" if name == "asyncapi" else f"{name}.schema.json"


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"
