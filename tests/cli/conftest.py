"""The laboratory example, completed with rendered pictures as its README says."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from sagnode.cli.main import main

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of configs/lab with a reference picture, three frames of it, and one without wires."""
    directory = tmp_path_factory.mktemp("lab") / "lab"
    shutil.copytree(CONFIGS / "lab", directory)
    common = ["--config", str(directory), "--errors", "0", "--backdrop", "plain", "--format", "png"]
    assert main(["scene", *common, "--out", str(directory / "calm"), "--sag", "0.08", "--seed", "9"]) == 0
    assert main(["scene", *common, "--out", str(directory / "frames"), "--sag", "0.09:0.11", "--frames", "3"]) == 0
    assert main(["scene", *common, "--out", str(directory / "empty"), "--no-wires"]) == 0
    (reference,) = (directory / "calm").glob("*.png")
    reference.rename(directory / "reference.png")
    span = directory / "span.toml"
    span.write_text(span.read_text().replace("# reference_image =", "reference_image ="))
    return directory
