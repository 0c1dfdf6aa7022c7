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
from sagnode.geometry.camera import FloatArray

NCC_MIN = 0.55
"""Least correlation of a landmark with its patch; chance company is left to the consensus to refuse."""
AGREE_PX = 4.0
"""Landmarks that differ more than this from the shared shift, turn and scale are no longer themselves."""
LEAST_BASELINE_PX = 50.0
"""Distance of two landmarks below which they cannot tell turn and scale."""
MOST_SCALED, MOST_TURNED = 0.05, 0.15
"""Greatest change of scale, and turn (rad), of a camera that still looks at the same thing."""
TRACK_U_PX = 0.06
"""Standard uncertainty of a tracked position for a clear landmark."""
MIN_TEXTURE = 2.0
"""Standard deviation in grey levels below which a patch holds nothing to recognise."""


@dataclass(frozen=True)
class Patch:
    """A landmark as it looked in the reference picture.

    Attributes:
        pixel: where it was clicked (2,).
        image: the square around the rounded click, odd side.
    """

    pixel: FloatArray
    image: GreyImage


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


def cut_patch(reference: GreyImage, pixel: tuple[float, float], size_px: int) -> Patch | None:
    """The patch of a landmark, or None where it reaches over the edge or holds no texture."""
    half = size_px // 2
    u, v = round(pixel[0]), round(pixel[1])
    height, width = reference.shape
    if u < half or v < half or u > width - 1 - half or v > height - 1 - half:
        return None
    image = reference[v - half : v + half + 1, u - half : u + half + 1].copy()
    return Patch(np.array(pixel), image) if float(image.std()) >= MIN_TEXTURE else None


Peak = tuple[float, float, float]
"""A place where a patch may be: (du, dv) from where it was clicked, whole pixels, and its correlation there."""


def track(frame: GreyImage, patches: list[Patch | None], reach_px: float) -> Tracked:
    """Find patches within ``reach_px`` of where they were clicked.

    Several correlation peaks are kept per landmark; the movement (shift, rotation, scale) that most landmarks share
    decides which peak is meant and which landmarks are outliers.
    """
    n = len(patches)
    pixels, sigma, best = np.full((n, 2), np.nan), np.full(n, np.nan), np.zeros(n)
    options: list[list[Peak]] = []
    for i, patch in enumerate(patches):
        found_peaks = [] if patch is None else peaks(frame, patch, reach_px)
        options.append(found_peaks)
        best[i] = max((p[2] for p in found_peaks), default=0.0)
    found = np.zeros(n, dtype=bool)
    chosen = consensus(patches, options)
    for i, peak in chosen.items():
        patch = patches[i]
        if patch is None:
            continue
        refined, error = refine(frame, patch, peak)
        pixels[i], sigma[i], found[i] = refined, error, True
    visible = np.array([p is not None for p in patches], dtype=bool)
    return Tracked(pixels, sigma, best, found, visible)


def peaks(frame: GreyImage, patch: Patch, reach_px: float, ncc_min: float = NCC_MIN) -> list[Peak]:
    """Up to five places of a patch within ``reach_px`` of its click, correlation at least ``ncc_min``, best first."""
    half, reach = patch.image.shape[0] // 2, int(np.ceil(reach_px))
    u, v = round(float(patch.pixel[0])), round(float(patch.pixel[1]))
    height, width = frame.shape
    left, top = max(0, u - half - reach), max(0, v - half - reach)
    right, bottom = min(width, u + half + reach + 1), min(height, v + half + reach + 1)
    window = frame[top:bottom, left:right]
    if window.shape[0] < patch.image.shape[0] or window.shape[1] < patch.image.shape[1]:
        return []
    score = cv2.matchTemplate(window, patch.image, cv2.TM_CCOEFF_NORMED)
    score = np.where(np.isfinite(score), score, 0.0)
    places: list[Peak] = []
    for _ in range(5):
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        value = float(score[row, column])
        if value < ncc_min:
            break
        places.append((float(left + column + half - u), float(top + row + half - v), value))
        score[max(0, row - 3) : row + 4, max(0, column - 3) : column + 4] = -1.0
    return places


def consensus(patches: Sequence[Patch | None], options: Sequence[Sequence[Peak]]) -> dict[int, Peak]:
    """The peak of each landmark that fits the similarity which most landmarks share (weighted by correlation)."""
    candidates = [(i, *peak) for i, own in enumerate(options) for peak in own]
    if not candidates:
        return {}
    index = np.array([c[0] for c in candidates])
    clicked = np.array([p.pixel if p is not None else (np.nan, np.nan) for p in patches])
    # pixels as complex numbers: a turn and scale is a factor
    place = clicked[index] @ np.array([1, 1j])
    shift = np.array([complex(c[1], c[2]) for c in candidates])
    weight = np.array([c[3] for c in candidates])
    first, second = np.triu_indices(len(candidates), 1)
    baseline = place[second] - place[first]
    far = np.abs(baseline) >= LEAST_BASELINE_PX
    first, second, baseline = first[far], second[far], baseline[far]
    factor = 1 + (shift[second] - shift[first]) / baseline
    possible = (np.abs(np.abs(factor) - 1) <= MOST_SCALED) & (np.abs(np.angle(factor)) <= MOST_TURNED)
    # every candidate by itself says a shift, every pair a shift, turn and scale
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


def _equalised(image: GreyImage) -> GreyImage:
    """Mean 128, standard deviation 40: light and haze change these between two pictures of one thing."""
    grey = image.astype(np.float32)
    gain = 40.0 / max(float(grey.std()), 1.0)
    return np.asarray(np.clip((grey - grey.mean()) * gain + 128.0, 0, 255), dtype=np.uint8)


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
        _equalised(patch.image),
        _equalised(crop),
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
