"""``sagnode capture``: pictures from the configured camera, as PNG with their metadata beside them."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from sagnode.cli.numbers import between, whole
from sagnode.daemon.places import SERVICE_CONFIG, configuration
from sagnode.errors import ConfigError, EndOfFrames, FrameError

if TYPE_CHECKING:
    from sagnode.capture.port import Frame

DESCRIPTION = """Take pictures with the configured camera, as PNG with time and camera settings beside each. Only
the node file's table [camera] has to be in order; survey and calibration may follow. The service must not have the
camera open meanwhile: systemctl stop sagnode."""
EPILOG = "exit codes: 0 all taken, 1 the camera failed, 2 usage or bad configuration"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    text = f"node file, or the directory that holds node.toml (default: {SERVICE_CONFIG})"
    parser.add_argument("--config", type=Path, metavar="PATH", help=text)
    parser.add_argument("--out", required=True, type=Path, metavar="DIR", help="where to write; made if missing")
    parser.add_argument("--count", type=whole(1, 100_000), default=1, metavar="N", help="how many pictures (default 1)")
    parser.add_argument(
        "--interval", type=between(0, 86_400), default=0.0, metavar="S", help="least time between two (default 0)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object a picture")


def run(args: argparse.Namespace) -> int:
    """Open the camera, take the pictures one by one, and write each before the next."""
    from sagnode.capture import open_source
    from sagnode.config.load import load_camera

    camera = load_camera(configuration(args.config))
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {args.out}: cannot be made: {error.strerror}", "name another directory") from None
    source = open_source(camera)
    try:
        source.open()
        print(source.describe(), file=sys.stderr)
        for taken in range(args.count):
            try:
                frame = source.burst(1, args.interval)[0]
            except EndOfFrames as end:
                print(f"{taken} of {args.count} pictures: {end}", file=sys.stderr)
                return 1
            path = write_frame(frame, args.out)
            print(json.dumps({"file": str(path), "utc": frame.utc.isoformat()}) if args.json else path, flush=True)
            if taken + 1 < args.count:
                time.sleep(args.interval)
    finally:
        source.close()
    return 0


def write_frame(frame: Frame, directory: Path) -> Path:
    """Write ``<UTC>.png`` and ``<UTC>.json``; the picture appears whole or not at all.

    Raises:
        FrameError: the disk does not take it.
    """
    import cv2

    name = f"{frame.utc:%Y%m%dT%H%M%S.%f}Z"
    path = directory / f"{name}.png"
    height, width = frame.image.shape
    metadata = {
        "utc": frame.utc.isoformat(),
        "monotonic_s": frame.monotonic_s,
        "source": frame.source,
        "width": width,
        "height": height,
        "camera": dict(frame.metadata),
    }
    try:
        part = directory / f".{name}.part"
        part.write_bytes(cv2.imencode(".png", frame.image)[1].tobytes())
        path.with_suffix(".json").write_text(json.dumps(metadata, indent=2, default=str) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise FrameError(
            f"picture {path} cannot be written: {error.strerror}", "check the disk's space and rights"
        ) from None
    return path
