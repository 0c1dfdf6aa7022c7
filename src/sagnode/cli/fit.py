"""``sagnode fit``: one conductor between two points of any photograph, without calibration or survey."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sagnode.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

    from sagnode.fit.between import FitResult

DESCRIPTION = """Fit one curve to a conductor between two points of a photograph, given in pixels (u to the right,
v down, 0,0 the centre of the upper left pixel). Nothing need be known about camera or span; the result is in pixels.
A point may lie outside the picture, by up to its width or height on either side, where the conductor leaves it."""
EPILOG = "exit codes: 0 a conductor was found, 1 none was (the reason is told), 2 usage or unreadable picture"
SCHEMA_VERSION = "sagnode.fit/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Picture, two points, output."""
    parser.add_argument("image", type=Path, metavar="IMAGE", help="JPEG, PNG, TIFF or PGM; grey or colour")
    for name, dest, text in (("--from", "start", "one end"), ("--to", "end", "the other end")):
        parser.add_argument(name, dest=dest, type=pixel, required=True, metavar="X,Y", help=f"{text} of the conductor")
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument("--overlay", type=Path, metavar="FILE", help="draw the curve on the picture (PNG)")


def arrange(words: list[str]) -> list[str]:
    """Join ``--from`` and ``--to`` to their points, or argparse would take ``-5,20`` for an option."""
    arranged: list[str] = []
    for word in words:
        if arranged and arranged[-1] in {"--from", "--to"} and word[:1] == "-" and word[1:2].isdigit():
            arranged[-1] += f"={word}"
        else:
            arranged.append(word)
    return arranged


def pixel(text: str) -> tuple[float, float]:
    """``X,Y`` as two finite numbers.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not two numbers such as 120,45.5") from None
    if not (math.isfinite(u) and math.isfinite(v)):
        raise argparse.ArgumentTypeError(f"'{text}' is not two finite numbers")
    return u, v


def run(args: argparse.Namespace) -> int:
    """Fit, print, draw."""
    from sagnode.capture.images import read_grey, write_png
    from sagnode.errors import FrameError
    from sagnode.fit.between import draw_fit, fit_between

    try:
        image = read_grey(args.image)
    except FrameError as error:
        raise ConfigError(error.what, error.remedy) from error
    _check_points(args, image.shape[1], image.shape[0])
    result = fit_between(image, args.start, args.end)
    if args.overlay:
        write_png(args.overlay, draw_fit(image, result))
    if args.json:
        print(json.dumps(fit_document(args.image, args.start, args.end, result), indent=2, ensure_ascii=False))
    else:
        print("\n".join(_lines(args, result)))
    return 0 if result.found else 1


def fit_document(
    image: Path, start: tuple[float, float], end: tuple[float, float], result: FitResult
) -> dict[str, Any]:
    """A fit as JSON-ready data; without a conductor the curve's fields are empty and ``refusal`` says why."""
    refusal = None
    if not result.found:
        first = result.reasons[0]
        text = "; ".join(reason.text for reason in result.reasons)
        refusal = {"cause": first.cause, "detail_qual": first.detail_qual, "text": text}
    return {
        "schema_version": SCHEMA_VERSION,
        "image": str(image),
        "from": list(start),
        "to": list(end),
        "found": result.found,
        "kind": result.kind,
        "control_points": _numbers(result.control_points) if result.found else [],
        "weights": _numbers(result.weights) if result.found else [],
        "points": _numbers(result.points) if result.found else [],
        "confidence": _numbers(result.confidence) if result.found else [],
        "score": _finite(result.score),
        "residual_px": _finite(result.residual_px) if result.found else None,
        "visible_share": _finite(result.visible_share),
        "refusal": refusal,
    }


def _numbers(array: np.ndarray[Any, Any]) -> Any:
    return array.round(4).tolist()


def _finite(value: float | None) -> float | None:
    return round(float(value), 4) if value is not None and math.isfinite(value) else None


def _check_points(args: argparse.Namespace, width: int, height: int) -> None:
    for name, (u, v) in (("--from", args.start), ("--to", args.end)):
        if not (-width <= u <= 2 * width and -height <= v <= 2 * height):
            raise ConfigError(
                f"{name} {u:g},{v:g} lies too far outside {args.image} ({width}x{height} px)",
                f"give a point with u from {-width} to {2 * width} and v from {-height} to {2 * height}",
            )
    if math.dist(args.start, args.end) < 1:
        raise ConfigError("--from and --to are the same point", "give the two ends of the conductor")


def _lines(args: argparse.Namespace, result: FitResult) -> list[str]:
    if not result.found:
        return [f"{args.image}: no conductor was found", *(f"  {r.cause}: {r.text}" for r in result.reasons)]
    control = "  ".join(f"({u:.1f}, {v:.1f})" for u, v in result.control_points)
    lowest = result.points[result.points[:, 1].argmax()]
    seen = f"{100 * result.visible_share:.0f} % visible"
    lines = [
        f"{args.image}: found, score {result.score:.1f}, residual {result.residual_px:.2f} px, {seen}",
        f"  control points  {control}",
        f"  weights         {'  '.join(f'{w:.4f}' for w in result.weights)}",
        f"  lowest pixel    ({lowest[0]:.1f}, {lowest[1]:.1f})",
    ]
    return lines + ([f"  drawn           {args.overlay}"] if args.overlay else [])
