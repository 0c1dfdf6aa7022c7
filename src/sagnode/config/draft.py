"""A span file on its way to being complete: what needs a camera on the tower may still be missing.

Before anyone climbs there is no reference picture and no landmark has been clicked; perhaps the lens has not been
bought and the place not been chosen. Everything else must be in order, and is looked at as strictly as ever.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sagnode.config.document import Document, read_document, validate
from sagnode.config.faults import Fault
from sagnode.config.lines import KeyPath
from sagnode.config.load import NODE_FILE, SPAN_FILE, file_in, is_span, refusal, resolved_span, span_contradictions
from sagnode.config.span import Span
from sagnode.errors import ConfigError

_NOWHERE = (0.0, 0.0, 1e6)


@dataclass(frozen=True)
class Draft:
    """A survey that can be planned with."""

    span: Span
    """Its files as absolute paths; what is missing has a value that means nothing, see the flags."""
    path: Path
    """The span file, absolute."""
    not_yet: tuple[Fault, ...]
    """What a node would still miss: where, and what."""
    placed: bool
    """Whether the camera's position is given."""
    aimed: bool
    """Whether its azimuth and elevation are given."""
    calibrated: bool
    """Whether its calibration file is there."""


def load_draft(path: Path) -> Draft:
    """Read a span file, or the one that a node file names, that need not be complete.

    Args:
        path: span file, node file, or a directory with ``node.toml`` or else ``span.toml``. Of a node file only its
            ``span_file`` counts.

    Raises:
        ConfigError: with every fault.
    """
    document = read_document(file_in(path, NODE_FILE, SPAN_FILE))
    if document.data is not None and not is_span(document.data):
        name = document.data.get("span_file")
        if not isinstance(name, str):
            text = f"{document.path} is no span file and names none"
            raise ConfigError(text, f"give a span file, or set span_file in {document.path}")
        document = read_document(document.path.parent / name)
    if document.data is None:
        raise refusal(path, document.faults)
    given = copy.deepcopy(document.data)
    missing = dict(_completed(document))
    span = validate(document, Span, span_contradictions)
    if span is None:
        raise refusal(path, document.faults)
    camera = given.get("camera") or {}
    return Draft(
        resolved_span(span, document.path.parent),
        document.path,
        tuple(document.fault(key, text) for key, text in missing.items()),
        placed="position" in camera,
        aimed="azimuth_deg" in camera and "elevation_deg" in camera,
        calibrated=("camera", "intrinsics") not in missing,
    )


def _completed(document: Document) -> Iterator[tuple[KeyPath, str]]:
    """Fill in what may be missing; what it was, as key path and sentence."""
    data: dict[str, Any] = document.data or {}
    camera = data.setdefault("camera", {})
    if isinstance(camera, dict):
        for key, nothing, text in (
            ("position", _NOWHERE, "the camera has no place yet"),
            ("azimuth_deg", 0.0, "the camera has no direction yet"),
            ("elevation_deg", 0.0, "the camera has no direction yet"),
        ):
            if key not in camera:
                camera[key] = nothing
                yield ("camera", key), text
        yield from _files(document.path.parent, camera)
    landmarks = data.get("landmarks", [])
    for index, landmark in enumerate(landmarks if isinstance(landmarks, list) else ()):
        if isinstance(landmark, dict) and "pixel" not in landmark:
            landmark["pixel"] = (0.0, 0.0)
            yield ("landmarks", index, "pixel"), "not clicked yet"


def _files(base: Path, camera: dict[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Calibration file and reference picture, which may not be there."""
    for key, text in (("intrinsics", "not calibrated yet"), ("reference_image", "no reference picture yet")):
        name = camera.get(key)
        if name is None:
            yield ("camera", key), text
        # os.path and not Path's method, which raises where a directory may not be looked into
        elif isinstance(name, str) and not os.path.exists(base / name):  # noqa: PTH110
            yield ("camera", key), f"{text}: {base / name} is not there"
        else:
            continue
        camera.pop(key, None)
    camera.setdefault("intrinsics", "camera.yaml")
