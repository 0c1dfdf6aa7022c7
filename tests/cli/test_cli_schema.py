"""The committed JSON Schemas are those of the models."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sagnode.cli.main import main
from sagnode.cli.schema import NAMES, file_name, schema_files

COMMITTED = Path(__file__).parents[2] / "docs" / "schema"


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
