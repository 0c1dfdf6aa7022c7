"""``sagnode calibrate``: intrinsics of a camera from pictures of a chessboard."""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from sagnode.errors import ConfigError, FrameError

if TYPE_CHECKING:
    from sagnode.calibrate.zhang import Board, Calibration, View

DESCRIPTION = """Find the intrinsics of a camera from pictures of a calibration board.

Print a chessboard, glue it to a flat plate, fix the lens's focus where it will stay, and take 15 to 30 pictures: board
filling a third to all of the frame, in every corner of it, tilted by 20 to 45 degrees to all sides, never blurred."""
EPILOG = """exit codes: 0 the camera is well known, 1 written but with reservations (or not enough views), 2 usage"""
_ENOUGH_VIEWS = 10
_GOOD_FOCAL = 0.002
_GOOD_COVER = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("images", nargs="+", type=Path, metavar="IMAGE", help="pictures of the board, all of one size")
    parser.add_argument("--board", required=True, metavar="9x6", help="inner corners, columns x rows")
    parser.add_argument("--square", required=True, type=float, metavar="METRES", help="side of a square")
    parser.add_argument("--out", type=Path, metavar="FILE", help="where to write the intrinsics (OpenCV YAML)")
    parser.add_argument(
        "--coefficients",
        type=int,
        choices=(4, 5, 8),
        default=4,
        help="distortion: 4 = k1 k2 p1 p2 (default), 5 = and k3 (wide lenses), 8 = rational (very wide lenses)",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Find the board in every picture, solve, judge, write."""
    from sagnode.calibrate.files import save_intrinsics
    from sagnode.calibrate.zhang import Board, TooFewViewsError, calibrate

    board = Board(*_board(args.board), args.square)
    if not 0 < args.square < 10:
        raise ConfigError(f"--square {args.square:g}: not the side of a square in metres", "measure it: 25 mm is 0.025")
    views, unusable, (width, height) = _find(args.images, board)
    try:
        result = calibrate(views, board, width, height, args.coefficients)
    except TooFewViewsError as error:
        for name, why in unusable.items():
            print(f"  {name}: {why}", file=sys.stderr)
        remedy = f"take more pictures in which all {args.board} inner corners are sharp"
        raise FrameError(f"no calibration: {error}", remedy) from None
    reservations = judge(result)
    if args.out:
        notes = {
            "views": len(result.view_errors_px),
            "rms_px": result.rms_px,
            "held_out_rms_px": result.held_out_rms_px,
        }
        notes |= {f"u_{name}": value for name, value in result.uncertainty.items()}
        save_intrinsics(args.out, result.intrinsics, notes)
    left_out = unusable | result.rejected
    if args.json:
        print(json.dumps(_document(result, left_out, reservations, args.out), indent=2))
    else:
        _print(result, left_out, reservations, args.out)
    return 1 if reservations else 0


def judge(result: Calibration) -> list[str]:
    """What speaks against relying on it, each with what to do; empty when nothing does."""
    from sagnode.calibrate.files import GOOD_RMS_PX

    reservations = []
    views, focal_u = len(result.view_errors_px), result.uncertainty["fx"] / result.intrinsics.fx
    if views < _ENOUGH_VIEWS:
        reservations.append(f"only {views} views: take at least {_ENOUGH_VIEWS}, from different directions")
    if result.rms_px > GOOD_RMS_PX:
        reservations.append(f"reprojection error {result.rms_px:.2f} px: blurred pictures, or a board that is not flat")
    if result.held_out_rms_px > max(1.5 * result.rms_px, result.rms_px + 0.1):
        reservations.append(
            f"error on unseen views {result.held_out_rms_px:.2f} px against {result.rms_px:.2f} px: more views,"
            " or fewer coefficients"
        )
    if focal_u > _GOOD_FOCAL:
        reservations.append(f"focal length known to {100 * focal_u:.2f} %: tilt the board more, by 20 to 45 degrees")
    if result.covered_share < _GOOD_COVER:
        reservations.append(
            f"corners cover {100 * result.covered_share:.0f} % of the frame: bring the board into its corners"
        )
    return reservations


def _board(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,2})\s*[xX,]\s*(\d{1,2})", text)
    if found is None or min(int(found[1]), int(found[2])) < 3:
        raise ConfigError(
            f"--board {text}: not a number of inner corners", "write it as 9x6: one less than squares each way"
        )
    return int(found[1]), int(found[2])


def _find(paths: list[Path], board: Board) -> tuple[list[View], dict[str, str], tuple[int, int]]:
    """Views, pictures that are none and why, and the size of all."""
    from sagnode.calibrate.zhang import find_corners
    from sagnode.capture.images import read_grey

    views: list[View] = []
    unusable: dict[str, str] = {}
    size: tuple[int, int] | None = None
    for number, path in enumerate(paths, 1):
        if sys.stderr.isatty():
            print(f"\r{number} of {len(paths)} pictures", end="", file=sys.stderr, flush=True)
        try:
            image = read_grey(path)
        except FrameError as error:
            unusable[str(path)] = error.what
            continue
        here = (image.shape[1], image.shape[0])
        size = size or here
        if here != size:
            raise ConfigError(
                f"picture {path} is {here[0]}x{here[1]} px, the ones before it {size[0]}x{size[1]}",
                "calibrate with pictures of one camera at the size that it will measure with",
            )
        view = find_corners(image, board, str(path))
        if view is None:
            unusable[str(path)] = f"no board of {board.columns}x{board.rows} inner corners found"
        else:
            views.append(view)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return views, unusable, size or (0, 0)


def _document(
    result: Calibration, left_out: dict[str, str], reservations: list[str], out: Path | None
) -> dict[str, object]:
    i = result.intrinsics
    return {
        "verdict": "good" if not reservations else "questionable",
        "reservations": reservations,
        "image_width": i.width,
        "image_height": i.height,
        "fx": i.fx,
        "fy": i.fy,
        "cx": i.cx,
        "cy": i.cy,
        "distortion": list(i.distortion),
        "uncertainty": result.uncertainty,
        "rms_px": result.rms_px,
        "held_out_rms_px": result.held_out_rms_px,
        "covered_share": result.covered_share,
        "views": result.view_errors_px,
        "left_out": left_out,
        "file": str(out) if out else None,
    }


def _print(result: Calibration, left_out: dict[str, str], reservations: list[str], out: Path | None) -> None:
    i, u = result.intrinsics, result.uncertainty
    for name, error in result.view_errors_px.items():
        print(f"  {error:6.3f} px  {name}")
    for name, why in left_out.items():
        print(f"  left out   {name}: {why}")
    print(f"camera of {i.width}x{i.height} px, from {len(result.view_errors_px)} views")
    for name, value in (("fx", i.fx), ("fy", i.fy), ("cx", i.cx), ("cy", i.cy)):
        print(f"  {name}  {value:10.3f} px  ± {u[name]:.3f}")
    for name, value in zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), i.distortion, strict=False):
        if value or u.get(name):
            print(f"  {name}  {value:10.6f}     ± {u.get(name, 0.0):.6f}")
    print(f"reprojection error {result.rms_px:.3f} px, on unseen views {result.held_out_rms_px:.3f} px")
    print(f"corners cover {100 * result.covered_share:.0f} % of the frame")
    if reservations:
        print("verdict: questionable")
        for reservation in reservations:
            print(f"  {reservation}")
    else:
        print("verdict: good")
    if out:
        print(f"written: {out}")
