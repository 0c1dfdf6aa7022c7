"""Template library: conductor curves for a grid of sag and swing, seen by the camera at its present pose.

A space Bézier seen in perspective is a rational quadratic Bézier whose weights are the depths of its control points
(design: §2), so a template is indexed by what we want to know and needs no perspective step of its own. The catenary's
departure from its parabola is added in space before projection, and distortion after it point by point: both exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, inside, project, project_camera
from sagnode.geometry.conductor import conductor_points, control_points, gravity_direction, loaded_profile
from sagnode.match.ribbon import SIDE_OFFSET_PX, normals, pair_response

SAMPLES = 128
STEP_PX = 1.6
"""Largest movement of any visible point of the curve from one template to the next; a wire's response is ±1 px wide."""
MAX_TEMPLATES = 5_000
"""Beyond this the steps grow, and each sample is looked for in a band instead."""
POOL_PX = 2.0
"""Widest spacing of the five places across the curve whose best response counts where its place is uncertain."""
SPREAD_PX = 4.0
"""Uncertainty of a sample's place at which it counts half."""
SWING_PRIOR = 0.3
"""Grey levels of mean response that one half-squared standard deviation of swing must earn."""


@dataclass(frozen=True)
class View:
    """A conductor as a camera sees it: everything a curve in the picture depends on but sag and swing."""

    intrinsics: Intrinsics
    pose: Pose
    near: FloatArray
    far: FloatArray
    diameter: float
    """Of the wire, or the outer width of the bundle, m."""
    load: tuple[float, ...] = ()
    """Terms of an uneven load (:mod:`sagnode.geometry.conductor`); none for an even one."""

    def pixels(self, sag: float, swing: float, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, 2) and depths (N,) of one curve; NaN where it is not ahead of the camera."""
        return project(self.intrinsics, self.pose, conductor_points(self.near, self.far, sag, swing, t, self.load))

    def width_px(self, depth: FloatArray) -> FloatArray:
        """Projected width of the conductor, px, at depths (N,) m."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.where(depth > 1e-3, self.diameter * self.intrinsics.fx / depth, np.nan))

    def rational_bezier(self, sag: float, swing: float) -> tuple[FloatArray, FloatArray]:
        """Control points (3, 2) px and weights (3,) of the parabola's picture through a perfect lens.

        A weight is a control point's depth; it is negative for one behind the camera, where the curve stays valid.
        """
        skew = 0.5 + self.load[0] / 6 if self.load else 0.5
        space = control_points(self.near, self.far, sag, swing, skew)
        camera = (space - self.pose.position) @ self.pose.rotation.T
        homogeneous = camera @ self.intrinsics.matrix.T
        weights = homogeneous[:, 2]
        return np.asarray(homogeneous[:, :2] / weights[:, None]), np.asarray(weights)


@dataclass(frozen=True)
class Candidate:
    """A local maximum of the coarse search."""

    sag: float
    swing: float
    score: float
    visible: float


def even_parameters(
    view: View, sag: float, swing: float, count: int, margin: float = 3.0, span_share: float = 0.0
) -> FloatArray:
    """Curve parameters (count,) over the visible part of one curve, evenly spaced in the picture.

    ``span_share`` of the spacing is even along the span instead: in a view along the line the near metres take most of
    the picture and the far half of the span a few pixels. Fewer than two parameters come back when nothing is visible.
    """
    # uneven start: in a view along the line the near metres take most of the picture
    t = np.concatenate([np.linspace(0.0, 0.2, 800, endpoint=False), np.linspace(0.2, 1.0, 800)])
    pixels, _ = view.pixels(sag, swing, t)
    seen = inside(view.intrinsics, pixels, margin)
    if np.count_nonzero(seen) < 2:
        return np.empty(0)
    both = seen[1:] & seen[:-1]
    step = np.where(both, np.hypot(*np.diff(np.nan_to_num(pixels), axis=0).T), 0.0)
    if not step.any():
        return np.empty(0)
    along = np.where(both, np.diff(t), 0.0)
    step = (1 - span_share) * step / step.sum() + span_share * along / along.sum()
    arc = np.concatenate([[0.0], np.cumsum(step)])
    wanted = np.linspace(0.0, arc[-1], count)
    # arc is flat where the curve is hidden: keep the ends of its rising stretches
    rising = np.diff(arc) > 0
    ends = np.concatenate([rising, [False]]) | np.concatenate([[False], rising])
    return np.asarray(np.interp(wanted, arc[ends], t[ends]))


def _spread(view: View, sag: float, t: FloatArray, attachment_u: float) -> FloatArray:
    """How far (N,) the attachments' uncertainty moves each sample across the curve, px (one standard deviation)."""
    base, _ = view.pixels(sag, 0.0, t)
    normal = normals(base)
    variance = np.zeros(len(t))
    for k in range(6):
        shift = np.zeros(6)
        shift[k] = 1e-3
        moved, _ = replace(view, near=view.near + shift[:3], far=view.far + shift[3:]).pixels(sag, 0.0, t)
        variance += (np.sum((moved - base) * normal, axis=1) * attachment_u / 1e-3) ** 2
    return np.asarray(np.sqrt(np.nan_to_num(variance, nan=1e4)))


def _sensitivity(view: View, sag: float, swing: float, t: FloatArray, spread: FloatArray) -> tuple[float, float]:
    """Greatest movement of a point across the curve, px per metre of sag and per radian of swing.

    Points whose place is uncertain anyway are looked for in a band, and so need no finer steps than the band.
    """
    base, _ = view.pixels(sag, swing, t)
    normal = normals(base)
    weight = 1.0 / (1.0 + np.minimum(spread, POOL_PX))

    def movement(other: FloatArray, step: float) -> float:
        moved = np.abs(np.sum((other - base) * normal, axis=1)) / step * weight
        return float(np.nanpercentile(moved, 95)) if np.isfinite(moved).any() else 0.0

    step = 1e-3 * sag
    return (
        movement(view.pixels(sag + step, swing, t)[0], step),
        movement(view.pixels(sag, swing + 1e-3, t)[0], 1e-3),
    )


def search(
    image: GreyImage,
    view: View,
    sag_range: tuple[float, float],
    swing_max: float,
    swing_u: float,
    attachment_u: float,
    keep: int = 8,
) -> list[Candidate]:
    """Coarse search over sag × swing; the best, well separated candidates, best first.

    Args:
        image: raw grey frame.
        view: the conductor as the camera sees it now.
        sag_range: smallest and largest in-plane sag, m.
        swing_max: largest swing, rad; a view that cannot tell swing is searched at zero only.
        swing_u: standard uncertainty of the swing's prior, rad.
        attachment_u: standard uncertainty of the attachments, m; samples that it moves are looked for in a band.
        keep: most candidates.
    """
    middle = 0.5 * (sag_range[0] + sag_range[1])
    t = even_parameters(view, middle, 0.0, SAMPLES, span_share=0.5)
    if t.size < 2:
        return []
    spread = _spread(view, middle, t, attachment_u)
    per_sag, per_swing = _sensitivity(view, middle, 0.0, t, spread)
    if per_sag <= 0:
        return []
    step = STEP_PX
    # what a swing of one prior sigma does beyond what sag does decides whether swing is worth searching
    swing_needed = per_swing * swing_max > 2 * STEP_PX and swing_max > 0

    def counts(step: float) -> tuple[int, int]:
        n_sag = int(np.ceil((sag_range[1] - sag_range[0]) * per_sag / step)) + 1
        n_swing = 2 * int(np.ceil(swing_max * per_swing / step)) + 1 if swing_needed else 1
        return n_sag, n_swing

    while np.prod(counts(step)) > MAX_TEMPLATES:
        step *= 1.25
        spread = np.maximum(spread, 0.5 * step)
    n_sag, n_swing = counts(step)
    sags = np.linspace(*sag_range, max(2, n_sag))
    swings = np.linspace(-swing_max, swing_max, n_swing) if n_swing > 1 else np.zeros(1)
    scores, visible = _scores(image, view, sags, swings, t, spread)
    # the prior on swing decides where the view hardly sees it, and keeps clutter at extreme swings in its place
    prior = SWING_PRIOR * 0.5 * (swings / swing_u) ** 2
    ranked = scores - prior[None, :]
    ranked = np.where(visible >= 0.2 * visible.max(initial=0.0), ranked, -np.inf)
    return _peaks(ranked, scores, visible, sags, swings, keep)


def _scores(
    image: GreyImage, view: View, sags: FloatArray, swings: FloatArray, t: FloatArray, spread: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Mean response and visible share (S, W) of all templates."""
    pool = np.minimum(spread, POOL_PX)
    trust = 1.0 / (1.0 + (spread / SPREAD_PX) ** 2)
    scores = np.empty((len(sags), len(swings)), dtype=np.float32)
    visible = np.empty((len(sags), len(swings)))
    # in the camera's frame a curve is the chord plus its profile along one direction: both are made once
    chord = (view.near + t[:, None] * (view.far - view.near) - view.pose.position) @ view.pose.rotation.T
    rise = view.far - view.near
    profile = loaded_profile(np.full(len(sags), np.hypot(rise[0], rise[1])), rise[2], sags, t, view.load)
    direction = gravity_direction(view.near, view.far, swings) @ view.pose.rotation.T
    chunk = max(1, 2048 // len(sags))
    for start in range(0, len(swings), chunk):
        some = direction[start : start + chunk]
        camera = chord + profile[:, None, :, None] * some[None, :, None, :]
        pixels, depth = project_camera(view.intrinsics, camera.reshape(-1, len(t), 3))
        normal = normals(pixels)
        side = np.maximum(SIDE_OFFSET_PX, 0.5 * view.width_px(depth) + 1.5)[..., None] * normal
        response = pair_response(image, pixels, side)
        for k in (-2.0, -1.0, 1.0, 2.0) if pool.max() > 0.35 else ():
            beside = pair_response(image, pixels + (k * pool)[:, None] * normal, side)
            response = np.fmax(response, beside)
        seen = np.isfinite(response)
        count = seen @ trust
        total = np.where(seen, response, 0.0) @ trust
        shape = (len(sags), len(some))
        scores[:, start : start + chunk] = (total / np.maximum(count, 1e-6)).reshape(shape)
        visible[:, start : start + chunk] = (count / trust.sum()).reshape(shape)
    return scores, visible


def _peaks(
    ranked: NDArray[np.floating],
    scores: NDArray[np.float32],
    visible: NDArray[np.float64],
    sags: FloatArray,
    swings: FloatArray,
    keep: int,
) -> list[Candidate]:
    """Local maxima of the ranked grid, non-maxima within two steps suppressed."""
    left = ranked.copy()
    found: list[Candidate] = []
    for _ in range(keep):
        i, j = np.unravel_index(int(np.argmax(left)), left.shape)
        if not np.isfinite(left[i, j]):
            break
        found.append(Candidate(float(sags[i]), float(swings[j]), float(scores[i, j]), float(visible[i, j])))
        left[max(0, i - 2) : i + 3, max(0, j - 2) : j + 3] = -np.inf
    return found
