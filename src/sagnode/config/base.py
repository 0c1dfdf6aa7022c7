"""What every configuration model shares: strict types, unknown keys refused, numbers finite."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

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
PositiveM = Annotated[float, Field(gt=0)]


class Model(BaseModel):
    """Base of all configuration tables."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)
