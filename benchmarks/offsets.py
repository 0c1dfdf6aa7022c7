"""How far the offsets across the wire, which the estimate is made from, lie from the true wire; by group.

    python benchmarks/offsets.py [--groups lab,tower,side100] [--worlds 6] [--seed 1]

The estimate takes each offset for the sum of a white error, which every offset states, and one that neighbours share.
Here both are measured against the truth: robust deviation, share of gross errors, and what pairs of offsets at some
distance along the curve have in common.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from looks import Look, looks
from run import DEVELOPMENT_SEED
from sagnode.estimate.matched import Matched
from sagnode.estimate.offsets import CORRELATED_PX, CORRELATION_LENGTH_PX
from sagnode.geometry.camera import FloatArray
from sagnode.scene.truth import pixel_curve

LAGS_PX = (10.0, 30.0, 60.0, 120.0, 240.0)
GROSS = 5.0
"""Errors beyond so many of the stated white deviations are gross."""


@dataclass(frozen=True)
class Errors:
    """Errors (N,) of a conductor's offsets, px, where they are along the curve (N,), and what they state (N,).

    And what neighbours are taken to share at least, px.
    """

    error: FloatArray
    arc: FloatArray
    sigma: FloatArray
    shared_px: float


def errors_of(found: Matched, truth: FloatArray) -> Errors:
    """Offsets against the true curve (K, 2) in the picture; those that have none of it beside them are left out."""
    seen = truth[np.isfinite(truth).all(axis=1)]
    offsets = found.offsets
    error = np.full(len(offsets.t), np.nan)
    for k, (pixel, normal) in enumerate(zip(offsets.measured, offsets.normal, strict=True)):
        apart = seen - pixel
        along = np.abs(apart @ np.array([-normal[1], normal[0]]))
        near = np.flatnonzero((along < 2.0) & (np.hypot(*apart.T) < 40.0))
        if near.size:
            error[k] = -float(apart[near[np.argmin(along[near])]] @ normal)
    kept = np.isfinite(error)
    return Errors(error[kept], offsets.arc[kept], offsets.sigma[kept], offsets.shared_px)


def shared(some: list[Errors]) -> list[float]:
    """Mean product (px²) of pairs of errors at the distances between LAGS_PX along one curve, gross ones left out."""
    sums, counts = np.zeros(len(LAGS_PX) - 1), np.zeros(len(LAGS_PX) - 1)
    for one in some:
        fine = np.abs(one.error) < GROSS * np.hypot(one.sigma, CORRELATED_PX)
        error, arc = one.error[fine], one.arc[fine]
        distance, product = np.abs(arc[:, None] - arc[None]), error[:, None] * error[None]
        for k, (low, high) in enumerate(pairwise(LAGS_PX)):
            within = (distance >= low) & (distance < high)
            sums[k] += product[within].sum()
            counts[k] += within.sum()
    return [float(x) for x in sums / np.maximum(counts, 1)]


def main() -> int:
    parser = argparse.ArgumentParser(description="errors of the offsets across the wire against the truth")
    parser.add_argument("--groups", default="lab,lab45,tower,field-tower,field-ground,side50,side100")
    parser.add_argument("--worlds", type=int, default=6)
    parser.add_argument("--seed", type=int, default=DEVELOPMENT_SEED)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    between = " | ".join(f"{low:g} to {high:g} px" for low, high in pairwise(LAGS_PX))
    print(f"| group | offsets | stated, white | robust deviation | gross | taken to be shared | shared at {between} |")
    print("|---|---|---|---|---|---|" + "---|" * (len(LAGS_PX) - 1))
    for name in options.groups.split(","):
        some = [e for look in looks(name, options.seed, options.worlds) for e in _errors(look)]
        if not some:
            print(f"| {name} | 0 |")
            continue
        error, sigma = np.concatenate([e.error for e in some]), np.concatenate([e.sigma for e in some])
        gross = float(np.mean(np.abs(error) > GROSS * np.hypot(sigma, CORRELATED_PX)))
        roots = " | ".join(f"{np.sign(c) * np.sqrt(abs(c)):+.3f}" for c in shared(some))
        print(
            f"| {name} | {len(error)} | {np.median(sigma):.3f} | {1.4826 * np.median(np.abs(error)):.3f}"
            f" | {100 * gross:.1f} % | {np.median([e.shared_px for e in some]):.3f} | {roots} |",
            flush=True,
        )
    usual = f"{CORRELATED_PX:g} px where a frame does not show what its own are"
    print(f"\nShared errors as signed roots, px; taken for {usual}, falling by e in {CORRELATION_LENGTH_PX:g} px.")
    return 0


def _errors(look: Look) -> list[Errors]:
    some = [
        errors_of(look.found[conductor.id], pixel_curve(look.shot.scene, look.shot.moment, conductor, 40001))
        for conductor in look.shot.scene.true.conductors
        if conductor.id in look.found
    ]
    return [one for one in some if one.error.size]


if __name__ == "__main__":
    sys.exit(main())
