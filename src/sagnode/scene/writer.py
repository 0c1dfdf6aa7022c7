"""Frames and truth on disk: ``<time>.jpg`` (or ``.png``) with ``<time>.json`` beside it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import cv2

from sagnode.capture.port import GreyImage
from sagnode.errors import SagnodeError
from sagnode.scene.render import Rendered, render
from sagnode.scene.spec import Moment, Scene

Format = Literal["png", "jpg"]


def frame_name(time: datetime) -> str:
    """The stem of a frame's files, as a replay reads it: ``20260621T113000Z``.

    >>> frame_name(datetime(2026, 6, 21, 11, 30, tzinfo=UTC))
    '20260621T113000Z'
    """
    return time.astimezone(UTC).strftime("%Y%m%dT%H%M%SZ")


def encoded(image: GreyImage, form: Format, quality: int = 90) -> bytes:
    """A grey JPEG (baseline, optimised tables) or PNG file's content."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1] if form == "jpg" else []
    done, data = cv2.imencode(f".{form}", image, options)
    if not done:
        raise SagnodeError(f"a picture of {image.shape} could not be encoded as {form}", "use png or jpg")
    return bytes(data.tobytes())


def write_frame(directory: Path, name: str, rendered: Rendered, form: Format = "jpg", quality: int = 90) -> Path:
    """Write a frame and its truth.

    Args:
        directory: must exist.
        name: stem of both files.
        rendered: frame and truth.
        form: of the picture.
        quality: of a JPEG.

    Returns:
        The picture's path.

    Raises:
        SagnodeError: a file cannot be written.
    """
    picture = directory / f"{name}.{form}"
    text = json.dumps(rendered.truth, separators=(",", ":"), sort_keys=True)
    try:
        picture.write_bytes(encoded(rendered.image, form, quality))
        picture.with_suffix(".json").write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise SagnodeError(f"{picture}: cannot be written: {error.strerror}", "choose another --out") from error
    return picture


def write_day(
    directory: Path,
    scene: Scene,
    moments: Sequence[Moment],
    form: Format = "jpg",
    quality: int = 90,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Render and write one frame a moment, named by its time; returns the pictures' paths."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SagnodeError(f"{directory}: cannot be made: {error.strerror}", "choose another --out") from error
    paths: list[Path] = []
    for k, moment in enumerate(moments):
        paths.append(write_frame(directory, frame_name(moment.time), render(scene, moment), form, quality))
        if progress is not None:
            progress(k + 1, len(moments))
    return paths
