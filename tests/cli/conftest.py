"""The laboratory example, completed with rendered pictures as its README says."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import pytest

from sagnode.cli.main import main

CONFIGS = Path(__file__).parents[2] / "configs"


class Word(NamedTuple):
    """A line of text that was drawn."""

    text: str
    left: int
    top: int
    right: int
    bottom: int

    def covers(self, left: int, top: int, right: int, bottom: int) -> bool:
        return self.left < right and left < self.right and self.top < bottom and top < self.bottom


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[Word]:
    """What is written on pictures from here on, each with the box that it fills."""
    words: list[Word] = []
    draw = cv2.putText

    def note(canvas: Any, text: str, at: tuple[int, int], font: int, size: float, *more: Any) -> Any:
        (width, height), _ = cv2.getTextSize(text, font, size, 1)
        word = Word(text, at[0], at[1] - height, at[0] + width, at[1])
        words.extend([word] if word not in words else [])  # an outline is drawn below the text itself
        return draw(canvas, text, at, font, size, *more)

    monkeypatch.setattr(cv2, "putText", note)
    return words


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
