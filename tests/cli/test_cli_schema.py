"""The committed JSON Schemas are those of the models."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from readings import START, reading

from sagnode.cli.main import main
from sagnode.cli.schema import MESSAGES, NAMES, file_name, schema_files, schemas
from sagnode.exchange import ReplyMessage
from sagnode.message import QualityMessage, Reading
from sagnode.quality import Cause, Reason, Validity

COMMITTED = Path(__file__).parents[2] / "docs" / "schema"


def objects(schema: Any, where: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every schema of an object in a document, however deep, and where it stands."""
    if isinstance(schema, dict):
        if isinstance(schema.get("properties"), dict):
            yield where, schema
        for key, value in schema.items():
            yield from objects(value, f"{where}/{key}")
    elif isinstance(schema, list):
        for index, value in enumerate(schema):
            yield from objects(value, f"{where}/{index}")


def sent() -> Iterator[tuple[str, dict[str, Any]]]:
    """Objects of what the node sends, in its own schema and in the AsyncAPI document."""
    everything = schemas()
    for name in MESSAGES:
        if name != "command":
            yield from objects(everything[name], name)
    commands = {"MeasureCommand", "PictureCommand", "ResendCommand"}
    for name, schema in everything["asyncapi"]["components"]["schemas"].items():
        if name not in commands:
            yield from objects(schema, f"asyncapi/{name}")


def test_the_committed_schemas_are_up_to_date() -> None:
    for path, text in schema_files(COMMITTED).items():
        assert path.read_text(encoding="utf-8") == text, f"{path} is stale: sagnode schema --out docs/schema"
    assert {path.name for path in COMMITTED.iterdir()} == {file_name(name) for name in NAMES}


def test_a_schema_is_printed_by_name_and_all_without(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "reading"]) == 0
    reading = json.loads(capsys.readouterr().out)
    assert "clearance_lo" in reading["properties"]
    assert reading["additionalProperties"] is False
    assert main(["schema"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == set(NAMES)


def test_out_writes_and_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "--out", str(tmp_path / "s")]) == 0
    assert len(list((tmp_path / "s").iterdir())) == len(NAMES)
    assert f"wrote {tmp_path}/s/node.schema.json" in capsys.readouterr().out


def test_out_with_a_name_writes_that_one_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "reading", "--out", str(tmp_path)]) == 0
    assert [file.name for file in tmp_path.iterdir()] == ["reading.schema.json"]


def test_what_is_always_sent_is_required() -> None:
    found = dict(sent())
    assert {"reading", "reading/$defs/QualityMessage", "health", "asyncapi/Reading", "asyncapi/LensMessage"} <= set(
        found
    )
    for where, schema in found.items():
        assert set(schema["required"]) == set(schema["properties"]), where


def test_a_reading_without_a_number_has_every_field_that_is_required() -> None:
    refused = QualityMessage.of(Validity.INVALID, (Reason(Cause.DARK, "the picture is dark"),))
    message = json.loads(
        reading(1, quality=refused, **dict.fromkeys(("sag_m", "sag_u", "sag_lo", "sag_hi"))).model_dump_json()
    )
    schema = schemas()["reading"]
    assert set(message) == set(schema["required"])
    assert set(message["quality"]) == set(schema["$defs"]["QualityMessage"]["required"])
    assert message["sag_m"] is None


def test_what_is_read_may_leave_defaults_out() -> None:
    resend = schemas()["command"]["$defs"]["ResendCommand"]
    assert resend["required"] == ["command", "from_sequence"]
    assert "backfill" not in Reading.model_json_schema(mode="validation")["required"]
    assert ReplyMessage(at=START, command=None, ok=False).sequences == {}


def test_every_field_of_a_message_says_what_it_is() -> None:
    everything = schemas()
    messages = {name: everything[name] for name in (*MESSAGES, "asyncapi")}
    for where, schema in objects(messages, ""):
        for name, field in schema["properties"].items():
            assert field.get("description"), f"{where}: {name}"


def test_descriptions_are_for_readers_who_know_no_sphinx() -> None:
    text = json.dumps(schemas())
    assert "``" not in text
    assert ":class:" not in text
    assert "each cause belongs to one `DetailQual`." in text
    assert "Retained on `health`" in text
