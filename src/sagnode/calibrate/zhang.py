"""Intrinsics from pictures of a flat chessboard: Zhang's method (IEEE PAMI 22, 2000) with OpenCV's solver.

Views that fit badly are left out, the rest is cross-validated on views that the solver did not see, and the parameters'
standard uncertainties come from the solver's covariance and from leaving out one view at a time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import Intrinsics

FloatArray = NDArray[np.float64]

MIN_VIEWS = 4
"""Three determine the camera; a fourth is needed to see whether they agree."""
Coefficients = Literal[4, 5, 8]
_FLAGS: dict[int, int] = {4: cv2.CALIB_FIX_K3, 5: 0, 8: cv2.CALIB_RATIONAL_MODEL}
_FOLDS = 5
_REJECT_SIGMAS = 3.5
_REJECT_SHARE = 1 / 3
_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


@dataclass(frozen=True)
class Board:
    """A chessboard of ``columns`` x ``rows`` inner corners, ``square_m`` metres a square."""

    columns: int
    rows: int
    square_m: float

    @property
    def points(self) -> NDArray[np.float32]:
        """Its corners in its own plane, (columns * rows, 3), metres."""
        grid = np.mgrid[0 : self.columns, 0 : self.rows].T.reshape(-1, 2)
        return np.column_stack([grid * self.square_m, np.zeros(len(grid))]).astype(np.float32)


@dataclass(frozen=True)
class View:
    """The corners found in one picture, (n, 2) px."""

    name: str
    corners: NDArray[np.float32]


@dataclass(frozen=True)
class Calibration:
    """A camera and how well it is known."""

    intrinsics: Intrinsics
    uncertainty: dict[str, float]
    """Standard uncertainty of each parameter, in its own unit (px for the first four)."""
    view_errors_px: dict[str, float]
    """RMS reprojection error of every view that was used."""
    rejected: dict[str, str]
    """Views left out, and why."""
    rms_px: float
    held_out_rms_px: float
    """RMS on views that the solver did not see."""
    covered_share: float
    """Share of the frame inside the hull of all corners."""


class TooFewViewsError(ValueError):
    """Not enough usable views."""


def find_corners(image: GreyImage, board: Board, name: str) -> View | None:
    """The board in a picture, to sub-pixel; None where it is not wholly visible.

    OpenCV's sector-based detector finds boards well, but shifts all corners of a tilted view by up to 0.05 px (its
    exhaustive search even more), which moved the focal length of rendered boards by six of its standard uncertainties;
    corners refined on the gradient are free of that.
    """
    size = (board.columns, board.rows)
    searching = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    for flags in (cv2.CALIB_CB_ACCURACY, searching):
        found, corners = cv2.findChessboardCornersSB(image, size, flags=flags)
        if found:
            break
    else:
        return None
    grid = np.asarray(corners, np.float32).reshape(board.rows, board.columns, 2)
    square_px = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))
    half = int(np.clip(0.3 * square_px, 2, 15))
    ending = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    refined = cv2.cornerSubPix(image, grid.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), ending)
    return View(name, np.asarray(refined, np.float32).reshape(-1, 2))


def calibrate(views: Sequence[View], board: Board, width: int, height: int, coefficients: Coefficients) -> Calibration:
    """Intrinsics of the camera that took these views of a board.

    Args:
        views: of one camera at one focus, from different directions.
        board: what they show.
        width: of the pictures, px.
        height: of the pictures, px.
        coefficients: distortion: 4 (k1 k2 p1 p2), 5 (and k3) or 8 (rational).

    Raises:
        TooFewViewsError: fewer than MIN_VIEWS.
    """
    used, rejected = list(views), dict[str, str]()
    while True:
        if len(used) < MIN_VIEWS:
            raise TooFewViewsError(f"{len(used)} usable views; at least {MIN_VIEWS} are needed")
        solution = _solve(used, board, (width, height), coefficients)
        worst = int(np.argmax(solution.errors))
        limit = _limit(solution.errors)
        may_go = len(used) > MIN_VIEWS and len(rejected) + 1 <= _REJECT_SHARE * len(views)
        if solution.errors[worst] <= limit or not may_go:
            break
        out = used.pop(worst)
        rejected[out.name] = (
            f"reprojection error {solution.errors[worst]:.2f} px against {np.median(solution.errors):.2f}"
        )
    return Calibration(
        intrinsics=solution.intrinsics(width, height),
        uncertainty=_uncertainty(used, board, (width, height), coefficients, solution),
        view_errors_px={view.name: float(error) for view, error in zip(used, solution.errors, strict=True)},
        rejected=rejected,
        rms_px=solution.rms,
        held_out_rms_px=_cross_validate(used, board, (width, height), coefficients),
        covered_share=_covered(used, width, height),
    )


@dataclass(frozen=True)
class _Solution:
    rms: float
    matrix: FloatArray
    coefficients: FloatArray
    deviations: list[float]
    errors: FloatArray

    @property
    def parameters(self) -> FloatArray:
        """In the order of _NAMES."""
        K = self.matrix
        return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *self.coefficients])

    def intrinsics(self, width: int, height: int) -> Intrinsics:
        fx, fy, cx, cy, *distortion = (float(p) for p in self.parameters)
        return Intrinsics(width, height, fx, fy, cx, cy, tuple(distortion), "pinhole")


def _solve(views: Sequence[View], board: Board, size: tuple[int, int], coefficients: Coefficients) -> _Solution:
    # The stubs of OpenCV do not know that None lets the solver begin by itself.
    solver: Any = cv2.calibrateCameraExtended
    rms, matrix, distortion, _, _, deviations, _, errors = solver(
        [board.points] * len(views), [view.corners for view in views], size, None, None, flags=_FLAGS[coefficients]
    )
    kept = np.asarray(distortion, float).reshape(-1)[: max(5, coefficients)]
    return _Solution(
        float(rms),
        np.asarray(matrix, float),
        kept,
        [float(d) for d in np.asarray(deviations).reshape(-1)[: 4 + len(kept)]],
        np.asarray(errors, float).reshape(-1),
    )


def _uncertainty(
    views: Sequence[View], board: Board, size: tuple[int, int], coefficients: Coefficients, solution: _Solution
) -> dict[str, float]:
    """The larger of the solver's deviation and the jackknife's over views.

    The solver takes the errors of all corners for independent. Those of one view are not (blur, bending of the board,
    rolling shutter), and leaving out whole views shows how much that matters (Efron, The Jackknife, 1982, chapter 3).
    """
    left_out = [_solve([*views[:i], *views[i + 1 :]], board, size, coefficients).parameters for i in range(len(views))]
    n = len(views)
    jackknife = np.sqrt((n - 1) / n * np.sum((np.array(left_out) - np.mean(left_out, axis=0)) ** 2, axis=0))
    return {name: max(float(a), b) for name, a, b in zip(_NAMES, jackknife, solution.deviations, strict=False)}


def _limit(errors: FloatArray) -> float:
    """Errors above this are outliers: median and median absolute deviation, and never below a tenth of a pixel."""
    median = float(np.median(errors))
    spread = 1.4826 * float(np.median(np.abs(errors - median)))
    return median + max(_REJECT_SIGMAS * spread, 0.5 * median, 0.1)


def _cross_validate(views: Sequence[View], board: Board, size: tuple[int, int], coefficients: Coefficients) -> float:
    """RMS over all views, each fitted (its pose alone) with intrinsics from the other folds."""
    folds = min(_FOLDS, len(views))
    squares, count = 0.0, 0
    for fold in range(folds):
        held = list(views[fold::folds])
        rest = [view for i, view in enumerate(views) if i % folds != fold]
        if len(rest) < MIN_VIEWS - 1:
            continue
        solution = _solve(rest, board, size, coefficients)
        for view in held:
            _, turn, shift = cv2.solvePnP(board.points, view.corners, solution.matrix, solution.coefficients)
            seen, _ = cv2.projectPoints(board.points, turn, shift, solution.matrix, solution.coefficients)
            off = seen.reshape(-1, 2) - view.corners
            squares, count = squares + float(np.sum(off**2)), count + len(off)
    return math.sqrt(squares / count) if count else math.nan


def _covered(views: Sequence[View], width: int, height: int) -> float:
    hull = cv2.convexHull(np.concatenate([view.corners for view in views]))
    return float(cv2.contourArea(hull)) / (width * height)
