"""A node's configuration on disk for a picture that is measured: what the worker and the daemon are started with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from performance.frames import Shot
from sagnode.config.load import LoadedNode, load_node
from sagnode.config.show import toml_text

START = "2026-06-21T00:00:00Z"


def write_node(
    shot: Shot, folder: Path, burst: int = 1, apart_s: float = 300.0, **tables: dict[str, Any]
) -> LoadedNode:
    """Write ``node.toml`` and ``span.toml`` into ``folder``; the picture is shown for ever.

    Args:
        shot: picture and survey.
        folder: made if need be.
        burst: frames for each reading.
        apart_s: from one frame to the next, by the frames' own times.
        tables: further tables of the node file, over those written here.
    """
    folder.mkdir(parents=True, exist_ok=True)
    replay = {"path": str(shot.jpeg), "cadence_s": apart_s, "start": START, "at_end": "loop"}
    node: dict[str, Any] = {
        "span_file": "span.toml",
        "unit": {"utility": "benchmark", "line": "line", "span": shot.span.name, "unit": "unit"},
        "camera": {"backend": "replay", "burst": burst, "replay": replay},
        "schedule": {"interval_s": 300.0, "clock": "virtual"},
        "storage": {"state_dir": str(folder / "state")},
    }
    node |= tables
    (folder / "span.toml").write_text(toml_text(shot.span.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
    path = folder / "node.toml"
    path.write_text(toml_text(node), encoding="utf-8")
    return load_node(path)
