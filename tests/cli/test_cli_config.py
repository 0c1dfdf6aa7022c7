"""``sagnode config``: init, check, show."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import pytest

from sagnode.cli.main import main
from sagnode.config.node import Node
from sagnode.config.span import Span

CONFIGS = Path(__file__).parents[2] / "configs"
FIELD_CAMERA = CONFIGS / "field-110kv" / "camera.yaml"


def test_init_writes_files_that_lack_the_calibration_and_the_clicks_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new"
    assert main(["config", "init", "--out", str(out)]) == 0
    assert "sagnode config check --config" in capsys.readouterr().out
    assert main(["config", "check", "--config", str(out)]) == 2
    said = capsys.readouterr().out
    assert said.count("fault:") == 5
    assert "camera.yaml; make it with: sagnode calibrate" in said
    assert said.count(".pixel: is missing") == 4
    text = FIELD_CAMERA.read_text().replace("4056", "1456").replace("3040", "1088")
    text = text.replace("15300.0", "1739.0").replace("2027.5", "727.5").replace("1519.5", "543.5")
    (out / "camera.yaml").write_text(text)
    span = out / "span.toml"
    span.write_text(span.read_text().replace("# pixel = ", "pixel = "))
    assert main(["config", "check", "--config", str(out)]) == 0
    said = capsys.readouterr().out
    # the clicks that stand there commented out are where the example's camera sees the example's landmarks
    assert [line for line in said.splitlines() if "landmarks[" in line] == []
    assert "without a reference_image" in said


def test_init_does_not_write_over_anything_unless_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "span.toml").write_text("mine")
    assert main(["config", "init", "--out", str(tmp_path)]) == 2
    assert f"already there: {tmp_path / 'span.toml'}" in capsys.readouterr().err
    assert (tmp_path / "span.toml").read_text() == "mine"
    assert not (tmp_path / "node.toml").exists()
    assert main(["config", "init", "--out", str(tmp_path), "--force"]) == 0
    assert (tmp_path / "span.toml").read_text() != "mine"


def test_init_into_a_place_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["config", "init", "--out", str(tmp_path / "file" / "below")]) == 1
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "model"), [("node.toml", Node), ("span.toml", Span)])
def test_every_commented_line_of_the_templates_is_a_real_key(
    name: str, model: type[Node | Span], tmp_path: Path
) -> None:
    """Uncommenting everything gives a file in which every key is known."""
    main(["config", "init", "--out", str(tmp_path)])
    lines = []
    for line in (tmp_path / name).read_text().splitlines():
        bare = line.removeprefix("# ")
        is_key = bare.split(" = ")[0].replace("_", "").isalnum() and " = " in bare
        alternative = bare.startswith(("cron", "[camera.replay]", "cadence"))
        lines.append(bare if line.startswith("#") and (is_key or bare.startswith("[")) and not alternative else line)
    text = "\n".join(lines)
    # the one alternative table that stands commented out under its own header
    text = text.replace("# [camera.replay]", "[camera.replay]").replace("# cadence_s", "cadence_s")
    document = tomllib.loads(text)
    assert model.model_validate(document)


def test_check_tells_all_as_text_and_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copied = shutil.copytree(CONFIGS / "lab", tmp_path / "lab")
    text = (copied / "span.toml").read_text().replace("roll_deg", "rol_deg").replace("diameter_m", "diametre_m")
    (copied / "span.toml").write_text(text)
    assert main(["config", "check", "--config", str(copied)]) == 2
    said = capsys.readouterr().out
    assert said.count("unknown key; did you mean 'diameter_m'?") == 2
    assert "unknown key; did you mean 'roll_deg'?" in said
    assert said.endswith("cannot be used: 3 faults\n")
    assert main(["config", "check", "--config", str(copied), "--json"]) == 2
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False
    assert {finding["kind"] for finding in document["findings"]} == {"fault"}
    assert all(finding["line"] for finding in document["findings"])


def test_check_of_a_usable_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "check", "--config", str(CONFIGS / "lab"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is True
    assert len(document["configuration_id"]) == 12


def test_without_config_it_is_the_services(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sagnode.daemon.places.SERVICE_CONFIG", CONFIGS / "lab")
    assert main(["config", "check", "--json"]) == 0
    checked = json.loads(capsys.readouterr().out)
    assert main(["config", "show", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["configuration_id"] == checked["configuration_id"]
    monkeypatch.setattr("sagnode.daemon.places.SERVICE_CONFIG", tmp_path / "nowhere")
    for words in (["config", "check"], ["config", "show"], ["capture", "--out", str(tmp_path / "out")]):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert f"{tmp_path}/nowhere: no such file or directory" in said
        assert "remedy: name the node file with --config" in said
    assert not (tmp_path / "out").exists()


def test_show(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "show", "--config", str(CONFIGS / "field-110kv"), "--changed"]) == 0
    said = capsys.readouterr().out
    assert 'host = "broker.example.org"' in said
    assert "inflight" not in said
    assert main(["config", "show", "--config", str(CONFIGS / "field-110kv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["node"]["mqtt"]["inflight"] == 5


def test_faults_on_the_way_of_any_command_are_lines_and_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "show", "--config", str(tmp_path / "none.toml")]) == 2
    assert capsys.readouterr().err.splitlines() == [
        f"sagnode: error: file not found: {tmp_path}/none.toml",
        "remedy: check the path and who may read it; 'sagnode config init' writes files to start from",
    ]
    assert main(["config"]) == 2
    assert "{init,check,show}" in capsys.readouterr().err
