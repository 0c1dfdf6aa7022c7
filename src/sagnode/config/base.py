"""What every configuration model shares: strict types, unknown keys refused, numbers finite."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

NameT = TypeVar("NameT", str, Path)

# Bounded far beyond any site (UTM northings fit), so that squares of differences stay finite.
Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]
PixelCoordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
Point = Annotated[
    tuple[Coordinate, Coordinate, Coordinate], Field(description="x, y, z in the site frame, metres, z up")
]
Pixel = Annotated[
    tuple[PixelCoordinate, PixelCoordinate], Field(description="u right, v down; pixel centres at integers")
]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$", description="letters, digits, . _ -")]
YEAR_S = 366 * 86_400.0
"""No wait of a node is longer; clocks and timers could not take any number."""
U_MAX = 100.0
"""Largest standard uncertainty of a place, m: more is no survey, and its square must stay finite."""


def _named(name: NameT) -> NameT:
    if "\0" in str(name) or len(str(name)) > 4000:
        raise ValueError("must be a file name: at most 4000 characters, none of them null")
    return name


def _plain(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must be one line of printable characters")
    return text


FileName = Annotated[Path, AfterValidator(_named)]
FilePattern = Annotated[str, AfterValidator(_named)]
Text = Annotated[str, Field(max_length=1000), AfterValidator(_plain)]
"""Far below the 65535 bytes that a text in MQTT can have."""
PositiveM = Annotated[float, Field(gt=0)]


class Model(BaseModel):
    """Base of all configuration tables."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)
