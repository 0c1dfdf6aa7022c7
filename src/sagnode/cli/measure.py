"""``sagnode measure``: readings of pictures, by the daemon's own code."""

from __future__ import annotations

import argparse
import json
import math
import sys
import typing
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sagnode.config.node import Measure, Method
from sagnode.errors import FrameError
from sagnode.quality import Validity

if TYPE_CHECKING:
    from sagnode.capture.port import GreyImage
    from sagnode.measurement import ConductorMeasurement
    from sagnode.site import Site

DESCRIPTION = """Measure every conductor of a span on pictures of it. Each picture is one reading; with --burst all
of them are the frames of one reading. A picture that cannot be read gives an invalid reading with its reason."""
EPILOG = "exit codes: 0 every reading has values, 1 a reading is invalid, 2 usage or bad configuration"
SCHEMA_VERSION = "sagnode.measure/1"


@dataclass(frozen=True)
class Shot:
    """The readings of one picture, or of one burst."""

    images: tuple[Path, ...]
    measurements: tuple[ConductorMeasurement, ...]
    last: GreyImage | None
    """The last picture that could be read; None when none could."""
    rejected: tuple[FrameError, ...] = ()
    """Pictures of a burst that could not be read."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Pictures, configuration and output."""
    parser.add_argument("images", type=Path, nargs="+", metavar="IMAGE", help="JPEG, PNG, TIFF or PGM; grey or colour")
    parser.add_argument(
        "--config", type=Path, required=True, metavar="PATH", help="node file, span file, or the directory of either"
    )
    parser.add_argument("--burst", action="store_true", help="take all pictures as the frames of one reading")
    parser.add_argument("--json", action="store_true", help="as JSON, with the fields of the MQTT message")
    parser.add_argument(
        "--overlay", type=Path, metavar="DIR", help="draw what was found into DIR/<picture>-overlay.png"
    )
    parser.add_argument(
        "--budget",
        action="store_true",
        help="tell what each uncertainty is made of, where a reading is not refused; docs/operations.md says what to do"
        " about each source",
    )
    parser.add_argument(
        "--method", choices=typing.get_args(Method), help="matcher, instead of the configured one; for comparison"
    )
    parser.add_argument(
        "--no-undistort", action="store_true", help="ignore the lens distortion; for comparison (the paper's Table 8)"
    )


def run(args: argparse.Namespace) -> int:
    """Measure, print, draw."""
    from sagnode.cli.readings import reading_document, reading_table
    from sagnode.config.load import LoadedNode, load_any
    from sagnode.pipeline import load_site

    loaded = load_any(args.config)
    site = load_site(loaded.span, _measure(loaded.node.measure if isinstance(loaded, LoadedNode) else Measure(), args))
    test = isinstance(loaded, LoadedNode) and loaded.node.unit.commissioning
    overlays = _Overlays(args.overlay) if args.overlay else None
    readings: list[dict[str, Any]] = []
    invalid = False
    for shot in _shots(site, args.images, burst=args.burst, progress=args.json and sys.stderr.isatty()):
        drawn = overlays.draw(shot) if overlays else None
        invalid = invalid or any(m.validity is Validity.INVALID for m in shot.measurements)
        for error in shot.rejected:
            print(f"sagnode: warning: left out of the burst: {error}", file=sys.stderr)
        if args.json:
            for measurement in shot.measurements:
                document = reading_document(measurement, test=test, budget=args.budget)
                document |= {
                    "images": [str(image) for image in shot.images],
                    "overlay": str(drawn) if drawn else None,
                    "curve": _curve(measurement),
                    "calibration_id": site.calibration_id,
                    "configuration_id": loaded.configuration_id,
                }
                readings.append(document)
        else:
            name = str(shot.images[0]) if len(shot.images) == 1 else f"burst of {len(shot.images)} pictures"
            print(reading_table(name, shot.measurements, budget=args.budget))
            if drawn:
                print(f"  drawn: {drawn}")
            sys.stdout.flush()
    if args.json:
        print(json.dumps({"schema_version": SCHEMA_VERSION, "readings": readings}, indent=2, ensure_ascii=False))
    return 1 if invalid else 0


def _measure(configured: Measure, args: argparse.Namespace) -> Measure:
    """The configured way of measuring with what the command line says otherwise."""
    changes: dict[str, object] = {}
    if args.method:
        changes["method"] = args.method
    if args.no_undistort:
        changes["undistort"] = False
    return configured.model_copy(update=changes)


def _curve(measurement: ConductorMeasurement) -> dict[str, Any] | None:
    """Control points (px) and weights of the conductor's parabola through a perfect lens; None where there are none."""
    if measurement.drawing is None or not measurement.estimates:
        return None
    points, weights = measurement.drawing.rational
    numbers = [*points.ravel().tolist(), *weights.tolist()]
    if not all(math.isfinite(number) for number in numbers):
        # a hyperbolic cosine has no control points
        return None
    return {"kind": "rational-quadratic-bezier", "control_points": points.tolist(), "weights": weights.tolist()}


def _shots(site: Site, paths: list[Path], *, burst: bool, progress: bool) -> Iterator[Shot]:
    """Read and measure the pictures: one by one, or all as one burst."""
    groups = [tuple(paths)] if burst else [(path,) for path in paths]
    for number, group in enumerate(groups, start=1):
        if progress:
            print(f"\rmeasuring {number}/{len(groups)} ", end="" if number < len(groups) else "\n", file=sys.stderr)
        yield _shot(site, group)


def _shot(site: Site, paths: tuple[Path, ...]) -> Shot:
    from sagnode.capture.images import read_grey
    from sagnode.measurement import ConductorMeasurement
    from sagnode.pipeline import measure_burst

    images, errors = [], []
    for path in paths:
        try:
            images.append(read_grey(path))
        except FrameError as error:
            errors.append(error)
    if images:
        measured = measure_burst(site, images)
        counted = tuple(replace(m, frames_rejected=m.frames_rejected + len(errors)) for m in measured)
        return Shot(paths, counted, images[-1], tuple(errors))
    refused = [
        ConductorMeasurement(
            conductor=conductor.id,
            phase=conductor.phase,
            validity=Validity.INVALID,
            reasons=tuple(error.reason for error in errors),
            method=site.method,
            frames_rejected=len(errors),
        )
        for conductor in site.conductors
        if conductor.measured
    ]
    return Shot(paths, tuple(refused), None)


class _Overlays:
    """Writes overlays into one directory; pictures of the same name from different places get a number."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._names: set[str] = set()

    def draw(self, shot: Shot) -> Path | None:
        """Draw one shot; None when no picture of it could be read."""
        from sagnode.capture.images import write_png
        from sagnode.overlay import draw_overlay

        if shot.last is None:
            return None
        stem = shot.images[-1].stem
        name, number = stem, 1
        while name in self._names:
            number += 1
            name = f"{stem}-{number}"
        self._names.add(name)
        path = self._directory / f"{name}-overlay.png"
        write_png(path, draw_overlay(shot.last, shot.measurements))
        return path
