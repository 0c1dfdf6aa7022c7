"""Is there really a wire under a fitted curve, and where along it? Judged against the same curve laid beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.fit.curve import Curve
from sagnode.fit.follow import KERNELS, Look, best_bow, look, polarities
from sagnode.geometry.camera import FloatArray

SHIFTS_PX = np.arange(9.0, 42.0, 3.0)
"""Distances at which the curve is laid beside itself, either side."""
TOLERANCE_PX = 1.0
"""How far from the curve a block may see the wire."""
BESIDE_PX = 3.0
"""How far the curves beside may bend to their own advantage, as the fitted one did."""


@dataclass(frozen=True)
class Verdict:
    """What the picture says about one curve.

    Attributes:
        fraction: arc fractions of the blocks (M,).
        evidence: log-likelihood ratio of a wire against none in each block (M,).
        rank: share of the places beside that look less like a wire (M,), 0..1; NaN outside the frame.
        strength: mean evidence over the blocks inside the frame.
        score: robust z of the strength among curves beside it that were bent to their advantage.
        kernels: numbers of the kernels that fit start and end best.
        inside: share of the curve inside the frame.
    """

    fraction: FloatArray
    evidence: FloatArray
    rank: FloatArray
    strength: float
    score: float
    kernels: tuple[int, int]
    inside: float


def judge(picture: NDArray[np.float32], curve: Curve) -> Verdict:
    """Compare a curve (in pixels of the picture) with its neighbourhood.

    Args:
        picture: grey, single precision.
        curve: the fitted curve.
    """
    seen = look(picture, curve, float(SHIFTS_PX[-1] + BESIDE_PX))
    kernel = _kernel_path(seen)
    rows = np.arange(len(kernel))
    signed, inside = seen.signed[kernel, rows][None], seen.inside
    middle = np.abs(seen.offsets) <= TOLERANCE_PX
    here_inside = inside[:, len(seen.offsets) // 2]
    count = max(1, int(here_inside.sum()))
    options = polarities(signed, inside)
    seen_here = [np.where(here_inside, evidence[:, middle].max(axis=1), 0.0) for evidence in options]
    chosen = int(np.argmax([here.sum() for here in seen_here]))
    here, evidence = seen_here[chosen], options[chosen]
    total = float(here.sum())
    others = np.array(_rivals(seen.fraction, evidence, seen.offsets, count))
    beside = [
        np.where(part.any(axis=1), np.where(part, evidence[:, columns], -9.0).max(axis=1), np.nan)
        for columns in (np.abs(seen.offsets - shift) <= TOLERANCE_PX for shift in _both(SHIFTS_PX))
        for part in (inside[:, columns],)
    ]
    known = np.isfinite(beside)
    beaten = (np.nan_to_num(np.array(beside), nan=9.0) < here).sum(axis=0)
    rank = beaten / np.maximum(known.sum(axis=0), 1)
    centre = float(np.median(others))
    spread = 1.4826 * float(np.median(np.abs(others - centre)))
    return Verdict(
        fraction=seen.fraction,
        evidence=here,
        rank=np.where(here_inside, rank, np.nan),
        strength=total / count,
        score=(total / count - centre) / max(spread, 0.08),
        kernels=(int(kernel[0]), int(kernel[-1])),
        inside=float(here_inside.mean()),
    )


def _rivals(fraction: FloatArray, evidence: FloatArray, offsets: FloatArray, count: int) -> list[float]:
    """Mean evidence along the curves beside, each bent to its best within a few pixels."""
    free = np.zeros(len(offsets))
    found = []
    for shift in _both(SHIFTS_PX):
        part = evidence[:, np.abs(offsets - shift) <= BESIDE_PX]
        _, total = best_bow(fraction, part, free[: part.shape[1]], free[: part.shape[1]])
        found.append(total / count)
    return found


def _both(shifts: FloatArray) -> FloatArray:
    return np.concatenate([-shifts[::-1], shifts])


def _kernel_path(seen: Look) -> NDArray[np.intp]:
    """Kernel of each block (M,), going evenly from the one that fits the start to the one that fits the end.

    Here what a block says is not bounded: of a clear wire most widths would say the same, and the narrowest be taken.
    """
    middle = np.abs(seen.offsets) <= TOLERANCE_PX
    here = np.abs(seen.signed[:, :, middle]).max(axis=2)
    number = np.arange(len(KERNELS))
    paths = [np.rint(a + (b - a) * seen.fraction).astype(np.intp) for a in number for b in number]
    rows = np.arange(here.shape[1])
    return max(paths, key=lambda path: float(here[path, rows].sum()))
