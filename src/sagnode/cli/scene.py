"""``sagnode scene``: frames of a configured span as its camera would take them, with the truth beside each."""

from __future__ import annotations

import argparse
import sys
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from sagnode.cli.numbers import between, finite, positive, whole

if TYPE_CHECKING:
    from sagnode.config.span import Span
    from sagnode.scene.spec import Moment, Scene, World

DESCRIPTION = """Render the configured span as its camera would see it: exact catenaries, sky, ground, trees, towers,
blur, noise and lens distortion. Beside each picture stands a JSON file with the truth. The same arguments give the
same pixels. With --day the conductors' temperature, load, wind and sun make a day of it; that needs stringing data
and unit weights in the span file. Otherwise every conductor hangs with the given sag."""
FIRST = datetime(2026, 6, 21, 11, 0, tzinfo=UTC)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Span, output, moments."""
    parser.add_argument(
        "--config", type=Path, required=True, metavar="PATH", help="node file, span file, or the directory of either"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="directory to write into")
    parser.add_argument("--frames", type=whole(1, 100_000), default=1, metavar="N", help="how many (default: 1)")
    parser.add_argument(
        "--every", type=between(0.001, 864_000), default=300.0, metavar="S", help="seconds between (default: 300)"
    )
    parser.add_argument("--day", type=_day, metavar="YYYY-MM-DD", help="a day from midnight UTC on, with its weather")
    parser.add_argument("--sag", type=_sags, metavar="M[:M]", help="sag, or from:to (default: middle of the range)")
    parser.add_argument("--swing", type=finite, default=0.0, metavar="DEG", help="swing of all conductors")
    parser.add_argument("--fog", type=_not_negative, default=1.5e-4, metavar="PER_M", help="0.02 is dense fog")
    parser.add_argument("--rain", type=between(0, 1), default=0.0, metavar="0..1", help="0 is none")
    parser.add_argument("--cloud", type=between(0, 1), default=0.4, metavar="0..1", help="0 is a clear sky")
    parser.add_argument("--lens", choices=("clear", "covered", "fogged", "drops"), default="clear")
    parser.add_argument(
        "--backdrop",
        choices=("country", "plain", "textured"),
        default="country",
        help="plain: grey, as in a laboratory",
    )
    parser.add_argument("--no-wires", action="store_true", help="the same view without any conductor")
    parser.add_argument(
        "--errors",
        type=_not_negative,
        default=1.0,
        metavar="SCALE",
        help="the true world differs from the survey by errors of its stated uncertainties times this (default: 1)",
    )
    parser.add_argument(
        "--seed", type=whole(0, 2**32 - 1), default=1, metavar="N", help="of everything random (default: 1)"
    )
    parser.add_argument("--format", choices=("jpg", "png"), default="jpg")


def run(args: argparse.Namespace) -> int:
    """Render and write."""
    from sagnode.config.load import load_any
    from sagnode.scene.spec import World
    from sagnode.scene.writer import write_day

    scene = _scene(load_any(args.config).span, args.seed, args.errors, World(backdrop=args.backdrop))
    moments = _day_moments(scene, args) if args.day else _plain_moments(scene.true, args)
    progress = _progress if sys.stderr.isatty() else None
    for path in write_day(args.out, scene, moments, args.format, progress=progress):
        print(path)
    return 0


def _scene(span: Span, seed: int, errors: float, world: World) -> Scene:
    from sagnode.calibrate.files import load_intrinsics
    from sagnode.scene.noise import generator
    from sagnode.scene.perturb import perturbed, perturbed_intrinsics
    from sagnode.scene.spec import Scene

    stated = load_intrinsics(span.camera.intrinsics)
    if errors == 0:
        return Scene(span, span, stated, world, seed)
    rng = generator(seed, "errors")
    true = perturbed(span, rng, errors)
    return Scene(span, true, perturbed_intrinsics(stated, span, rng, errors), world, seed)


def _day_moments(scene: Scene, args: argparse.Namespace) -> list[Moment]:
    from sagnode.scene.day import DayPlan, day_of_moments

    midnight = datetime.combine(args.day, datetime.min.time(), UTC)
    times = [midnight + timedelta(seconds=k * args.every) for k in range(args.frames)]
    return day_of_moments(scene.true, DayPlan(), times, args.seed)


def _plain_moments(span: Span, args: argparse.Namespace) -> list[Moment]:
    from sagnode.scene.catenary import WireState
    from sagnode.scene.spec import Moment

    moments = []
    for k in range(args.frames):
        share = k / (args.frames - 1) if args.frames > 1 else 0.0
        wires = {}
        for conductor in span.conductors:
            first, last = args.sag or [(conductor.sag_min_m + conductor.sag_max_m) / 2] * 2
            wires[conductor.id] = WireState(first + share * (last - first), args.swing)
        moments.append(
            Moment(
                wires,
                FIRST + timedelta(seconds=k * args.every),
                fog_per_m=args.fog,
                rain=args.rain,
                cloud=args.cloud,
                lens=args.lens,
                draw_wires=not args.no_wires,
                seed=args.seed + k,
            )
        )
    return moments


def _progress(done: int, total: int) -> None:
    print(f"\rrendered {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


def _not_negative(text: str) -> float:
    value = finite(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} must be 0 or more")
    return value


def _sags(text: str) -> tuple[float, float]:
    first, colon, last = text.partition(":")
    return positive(first), positive(last if colon else first)


def _day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is no day such as 2026-06-21") from None
