"""Landmarks: where the fixed points that were clicked in the reference picture are in this frame.

Each landmark's patch is searched by normalised correlation in a window of the frame, all landmarks must agree on one
movement of the camera, and the survivors are refined to sub-pixel by pyramid-free Lucas-Kanade on crops whose
brightness and contrast have been equalised. Only crops are touched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import cv2
import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray, Intrinsics
from sagnode.match.agreement import LEAST_BASELINE_PX, MOST_SCALED, MOST_TURNED, is_chance
from sagnode.match.patches import Patch, Peak, equalised, peaks
from sagnode.match.turning import as_turns

AGREE_PX = 4.0
"""Landmarks that differ more than this from the shared turn and scale are no longer themselves."""
TRACK_U_PX = 0.06
"""Standard uncertainty of a tracked position for a clear landmark."""


@dataclass(frozen=True)
class Tracked:
    """Landmarks found in a frame; arrays over all landmarks.

    Attributes:
        pixels: positions (N, 2); NaN where not found.
        sigma: standard uncertainty of the tracking, px (N,).
        correlation: best normalised correlation (N,).
        found: which landmarks agree on one camera movement (N,).
        visible: which landmarks lie wholly in the reference picture and have texture, so that they could be found (N,).
        cut_at: of landmarks found by a kept appearance and not by the reference's patch: when that was cut, by number.
    """

    pixels: FloatArray
    sigma: FloatArray
    correlation: FloatArray
    found: NDArray[np.bool_]
    visible: NDArray[np.bool_]
    cut_at: Mapping[int, datetime] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Landmarks found."""
        return int(self.found.sum())


def track(frame: GreyImage, patches: list[Patch | None], reach_px: float, lens: Intrinsics) -> Tracked:
    """Find patches within ``reach_px`` of where they were clicked.

    Several correlation peaks are kept per landmark; the movement (turn and scale) that most landmarks share decides
    which peak is meant and which landmarks are outliers.
    """
    n = len(patches)
    pixels, sigma, best = np.full((n, 2), np.nan), np.full(n, np.nan), np.zeros(n)
    options: list[list[Peak]] = []
    for i, patch in enumerate(patches):
        found_peaks = [] if patch is None else peaks(frame, patch, reach_px)
        options.append(found_peaks)
        best[i] = max((p[2] for p in found_peaks), default=0.0)
    found = np.zeros(n, dtype=bool)
    chosen = consensus(patches, options, lens)
    if is_chance(frame, patches, options, chosen, reach_px, lens):
        chosen = {}
    for i, peak in chosen.items():
        patch = patches[i]
        if patch is None:
            continue
        refined, error = refine(frame, patch, peak)
        pixels[i], sigma[i], found[i] = refined, error, True
    visible = np.array([p is not None for p in patches], dtype=bool)
    return Tracked(pixels, sigma, best, found, visible)


def consensus(patches: Sequence[Patch | None], options: Sequence[Sequence[Peak]], lens: Intrinsics) -> dict[int, Peak]:
    """The peak of each landmark that fits the movement which most landmarks share (weighted by correlation).

    A movement is a turn of the camera and a change of scale: in the plane of :func:`as_turns`, a similarity.

    Landmarks whose patches lie on one another are found by the same things, right or wrong, and share their votes.
    """
    candidates = [(i, *peak) for i, own in enumerate(options) for peak in own]
    if not candidates:
        return {}
    index = np.array([c[0] for c in candidates])
    clicked = np.array([p.pixel if p is not None else (np.nan, np.nan) for p in patches])
    votes = _votes(patches, sorted(set(index.tolist())))
    # places as complex numbers: a roll and scale is a factor
    place, shift = as_turns(lens, clicked[index], np.array([c[1:3] for c in candidates]))
    weight = np.array([votes[c[0]] * c[3] for c in candidates])
    first, second = np.triu_indices(len(candidates), 1)
    baseline = place[second] - place[first]
    far = np.abs(baseline) >= LEAST_BASELINE_PX
    first, second, baseline = first[far], second[far], baseline[far]
    factor = 1 + (shift[second] - shift[first]) / baseline
    possible = (np.abs(np.abs(factor) - 1) <= MOST_SCALED) & (np.abs(np.angle(factor)) <= MOST_TURNED)
    # every candidate by itself says a turn aside, every pair a roll and scale too
    origin = np.concatenate([np.arange(len(candidates)), first[possible]])
    gain = np.concatenate([np.zeros(len(candidates)), factor[possible] - 1])
    predicted = shift[origin][:, None] + gain[:, None] * (place - place[origin][:, None])
    error = np.abs(shift - predicted)
    worth = np.where(error <= AGREE_PX, weight * (1 - 0.5 * error / AGREE_PX), 0.0)
    # of each landmark only its nearest peak counts
    total = np.zeros(len(origin))
    nearest: dict[int, NDArray[np.intp]] = {}
    for i in np.unique(index):
        own = np.flatnonzero(index == i)
        nearest[int(i)] = own[np.argmin(error[:, own], axis=1)]
        total += worth[np.arange(len(origin)), nearest[int(i)]]
    best = int(np.argmax(total))
    picked = {i: int(own[best]) for i, own in nearest.items() if error[best, own[best]] <= AGREE_PX}
    return {i: (candidates[k][1], candidates[k][2], candidates[k][3]) for i, k in picked.items()}


def _votes(patches: Sequence[Patch | None], offered: Sequence[int]) -> dict[int, float]:
    """How much each of the landmarks that are offered a place counts: 1 over the patches that cover its own."""
    own = {i: patch for i in offered if (patch := patches[i]) is not None}
    if not own:
        return dict.fromkeys(offered, 1.0)
    pixels = np.array([patch.pixel for patch in own.values()])
    sides = np.array([patch.image.shape[0] for patch in own.values()])
    apart = np.abs(pixels[:, None] - pixels) / np.maximum(sides[:, None], sides)[..., None]
    covered = np.maximum(1 - apart, 0.0).prod(axis=2).sum(axis=1)
    return dict.fromkeys(offered, 1.0) | dict(zip(own, (1 / covered).tolist(), strict=True))


def refine(frame: GreyImage, patch: Patch, peak: Peak) -> tuple[FloatArray, float]:
    """Sub-pixel position (2,) of a landmark near a peak, and its standard uncertainty, px."""
    shift = np.array(peak[:2])
    half = patch.image.shape[0] // 2
    u, v = round(float(patch.pixel[0])), round(float(patch.pixel[1]))
    fraction = patch.pixel - (u, v)
    cu, cv_ = int(u + shift[0]), int(v + shift[1])
    crop = frame[cv_ - half : cv_ + half + 1, cu - half : cu + half + 1]
    coarse = patch.pixel + shift
    if crop.shape != patch.image.shape:
        return coarse, 0.5
    window = max(7, (2 * half + 1) - 8)
    start = np.array([[[half, half]]], dtype=np.float32)
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        patch.equalised,
        equalised(crop),
        start,
        start.copy(),
        winSize=(window, window),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3),
    )
    step = np.asarray(moved)[0, 0] - half
    if not int(np.asarray(status).ravel()[0]) or float(np.hypot(*step)) > 2.0:
        return coarse, 0.5
    return np.array([cu, cv_]) + fraction + step, TRACK_U_PX
