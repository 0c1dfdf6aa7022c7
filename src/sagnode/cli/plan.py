"""``sagnode plan``: what accuracy this camera, lens and place would give, before anyone climbs."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from sagnode.cli.numbers import finite, positive
from sagnode.errors import ConfigError

if TYPE_CHECKING:
    from sagnode.config.draft import Draft
    from sagnode.geometry.camera import Intrinsics
    from sagnode.plan.camera import PlannedCamera
    from sagnode.plan.frame import Look
    from sagnode.plan.lenses import Sensor
    from sagnode.plan.study import Row

DESCRIPTION = """Expected uncertainty of sag and clearance of every conductor, from a span file alone: the node's own
measurement on the frame that the planned camera would see, at three sags and in wind, with what the uncertainty is made
of and what would help most. Calibration, reference picture and clicks need not be there yet. Several lenses or places
make a table, and the best of them is told in full."""
EPILOG = """places are metres in the site frame; --grid counts along the span from A, to the right of the line seen from
A, and up from the ground. --sensor is imx296, imx477, imx477-binned, imx708, imx708-binned, imx219, ov5647, or width x
height x pixel pitch in um (1456x1088x3.45); without it the size of the calibrated pictures tells.

examples:
  sagnode plan --config my-span --picture view.png
  sagnode plan --config my-span --focal                 the usual lenses, at the surveyed place
  sagnode plan --config my-span --sensor imx296 --focal 6 12 25 --camera 0.5,0.8,12 --camera 40,135,2
  sagnode plan --config my-span --focal 12 --grid 0:270:4,30:90:3,3

exit codes: 0 fine, 1 the node would refuse a conductor, 2 usage or bad configuration"""
SCHEMA_VERSION = "sagnode.plan/1"
MOST_CAMERAS = 2000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Survey, cameras, assumptions, output."""
    parser.add_argument(
        "--config", type=Path, required=True, metavar="PATH", help="node file, span file, or the directory of either"
    )
    parser.add_argument(
        "--camera",
        type=place,
        action="append",
        metavar="X,Y,Z",
        help="a place to try instead of the surveyed one; may be given several times",
    )
    parser.add_argument(
        "--grid", type=ranges, metavar="ALONG,RIGHT,UP", help="places: each a number or FROM:TO:COUNT, metres"
    )
    parser.add_argument(
        "--focal", type=positive, nargs="*", metavar="MM", help="lenses to try; without a number the usual ones"
    )
    parser.add_argument("--sensor", metavar="NAME", help="the sensor behind --focal")
    parser.add_argument(
        "--backdrop",
        choices=("plain", "textured", "country"),
        help="what is behind the wires: an even sky (default for models of less than 20 m), clutter, or fields and a"
        " wood below a sky (default for all else)",
    )
    parser.add_argument(
        "--contrast", type=positive, default=60.0, metavar="GREY", help="of a thick wire before a plain sky (60)"
    )
    parser.add_argument("--noise", type=positive, default=2.0, metavar="GREY", help="of a pixel of a plain sky (2)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the expected view (PNG)")
    parser.add_argument("--json", action="store_true", help="as JSON")


def arrange(words: list[str]) -> list[str]:
    """Join ``--camera`` and ``--grid`` to their numbers, or argparse would take ``-5,20,3`` for an option."""
    arranged: list[str] = []
    for word in words:
        if arranged and arranged[-1] in {"--camera", "--grid"} and word[:1] == "-" and word[1:2].isdigit():
            arranged[-1] += f"={word}"
        else:
            arranged.append(word)
    return arranged


def run(args: argparse.Namespace) -> int:
    """Plan, print, draw."""
    from sagnode.config.draft import load_draft
    from sagnode.plan.frame import Look, usual_backdrop
    from sagnode.plan.report import row_document, study_document, study_text, table_text
    from sagnode.plan.study import best, study

    draft = load_draft(args.config)
    look = Look(args.backdrop or usual_backdrop(draft.span), args.contrast, args.noise)
    cameras = _cameras(draft, args)
    rows = _table(draft, cameras, look) if len(cameras) > 1 else []
    told = study(draft.span, best(rows).camera if rows else cameras[0], look)
    if args.picture:
        from sagnode.capture.images import write_png
        from sagnode.plan.picture import expected_view

        write_png(args.picture, expected_view(draft.span, told))
    if args.json:
        document = {
            "schema_version": SCHEMA_VERSION,
            "span": draft.span.name,
            "not_yet": [str(fault) for fault in draft.not_yet],
            "assumed": {"backdrop": look.backdrop, "contrast_grey": look.contrast, "noise_grey": look.noise},
            "plan": study_document(told),
            "table": [row_document(row) for row in rows],
            "picture": str(args.picture) if args.picture else None,
        }
        print(json.dumps(document, indent=2, ensure_ascii=False))
        return 1 if told.refused else 0
    for fault in draft.not_yet:
        print(f"not yet: {fault}")
    if rows:
        print(table_text(rows))
        print("\nthe best of them:")
    print(study_text(told, look))
    if args.picture:
        print(f"\ndrawn: {args.picture}")
    return 1 if told.refused else 0


def _table(draft: Draft, cameras: list[PlannedCamera], look: Look) -> list[Row]:
    from sagnode.plan.study import compare

    rows = []
    for row in compare(draft.span, cameras, look):
        rows.append(row)
        if sys.stderr.isatty():
            end = "\n" if len(rows) == len(cameras) else ""
            print(f"\rplanned {len(rows)}/{len(cameras)} ", end=end, file=sys.stderr, flush=True)
    return rows


def _cameras(draft: Draft, args: argparse.Namespace) -> list[PlannedCamera]:
    """The surveyed camera, or every combination of the places and lenses that were asked for."""
    from sagnode.calibrate.files import load_intrinsics
    from sagnode.plan.camera import PlannedCamera
    from sagnode.plan.lenses import named_sensor
    from sagnode.plan.study import aimed

    if args.sensor is not None and args.focal is None:
        sensor = named_sensor(args.sensor)
        raise ConfigError(f"--sensor {sensor.name} says nothing without a lens", "give --focal too, with or without MM")
    survey = draft.span.camera
    calibrated = load_intrinsics(survey.intrinsics) if draft.calibrated else None
    own = None
    if calibrated is not None and draft.placed:
        own = PlannedCamera(calibrated, survey.position, survey.azimuth_deg, survey.elevation_deg, survey.roll_deg)
        own = own if draft.aimed else aimed(draft.span, own)
    if own is not None and not args.camera and not args.grid and args.focal is None:
        return [own]
    places = _places(draft, args)
    lenses = _lenses(args, calibrated)
    if len(places) * len(lenses) > MOST_CAMERAS:
        raise ConfigError(
            f"{len(places)} places x {len(lenses)} lenses are too many", f"at most {MOST_CAMERAS} cameras"
        )
    trials = [PlannedCamera(lens, at, 0.0, 0.0, focal_mm=mm) for at in places for mm, lens in lenses]
    surveyed = (survey.azimuth_deg, survey.elevation_deg) if draft.aimed and draft.placed else None
    cameras = [aimed(draft.span, t, surveyed if t.position == survey.position else None) for t in trials]
    # the surveyed one is what the others are compared with, where only the lens changes
    return [own, *cameras] if own is not None and not args.camera and not args.grid else cameras


def _places(draft: Draft, args: argparse.Namespace) -> list[tuple[float, float, float]]:
    places = list(args.camera or [])
    if args.grid:
        from sagnode.plan.places import grid_places

        count = math.prod(map(len, args.grid))
        if count > MOST_CAMERAS:
            raise ConfigError(f"--grid: {count} places", f"at most {MOST_CAMERAS}")
        places += grid_places(draft.span, *args.grid)
    if not places and not draft.placed:
        raise ConfigError(
            f"{draft.path}: camera.position: the camera has no place yet",
            "set it, or give places to try with --camera X,Y,Z or --grid",
        )
    return places or [draft.span.camera.position]


def _lenses(args: argparse.Namespace, calibrated: Intrinsics | None) -> list[tuple[float | None, Intrinsics]]:
    from sagnode.plan.lenses import USUAL_FOCAL_MM, lens_on

    if args.focal is None:
        if calibrated is not None:
            return [(None, calibrated)]
        raise ConfigError("the lens is not calibrated yet", "say which it is to be: --sensor imx296 --focal 6")
    sensor = _sensor(args.sensor, calibrated)
    return [(mm, lens_on(sensor, mm)) for mm in (args.focal or USUAL_FOCAL_MM)]


def _sensor(name: str | None, calibrated: Intrinsics | None) -> Sensor:
    from sagnode.plan.lenses import named_sensor, sensor_of

    if name is not None:
        return named_sensor(name)
    sensor = None if calibrated is None else sensor_of(calibrated)
    if sensor is None:
        size = "" if calibrated is None else f" (no known one takes {calibrated.width}x{calibrated.height})"
        raise ConfigError(f"--focal needs the sensor{size}", "give --sensor imx296, or --sensor 1456x1088x3.45")
    return sensor


def place(text: str) -> tuple[float, float, float]:
    """``X,Y,Z`` as three finite numbers.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    numbers = [finite(part) for part in text.split(",")]
    if len(numbers) != 3 or max(map(abs, numbers)) > 1e7:
        raise argparse.ArgumentTypeError(f"'{text}' is not three numbers such as 0.6,0.85,12.2")
    return numbers[0], numbers[1], numbers[2]


def ranges(text: str) -> tuple[list[float], list[float], list[float]]:
    """``ALONG,RIGHT,UP`` as three lists of numbers.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    parts = [_range(part) for part in text.split(",")]
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"'{text}' is not three ranges such as 0:270:4,30:90:3,2.5")
    return parts[0], parts[1], parts[2]


def _range(text: str) -> list[float]:
    parts = text.split(":")
    if len(parts) == 1:
        return [finite(text)]
    if len(parts) != 3 or not parts[2].isdecimal() or not 2 <= int(parts[2]) <= 1000:
        raise argparse.ArgumentTypeError(f"'{text}' is not FROM:TO:COUNT such as 0:270:4")
    first, last, count = finite(parts[0]), finite(parts[1]), int(parts[2])
    return [first + (last - first) * k / (count - 1) for k in range(count)]
