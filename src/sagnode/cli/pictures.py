"""Writing pictures for a user."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from sagnode.errors import SagnodeError


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write a grey or BGR picture (height, width[, 3]) as PNG, making its directory where needed.

    Raises:
        SagnodeError: it cannot be written.
    """
    _, encoded = cv2.imencode(".png", picture)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded.tobytes())
    except OSError as error:
        raise SagnodeError(f"cannot write {path}: {error.strerror}", "choose another place") from None
