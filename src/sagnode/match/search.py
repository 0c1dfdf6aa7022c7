"""Coarse search: which sag and swing put a conductor's curve on something like a wire.

Every sample of the curve moves at its own pace: seen along the line, one near the camera crosses a hundred pixels
while one at the far end crosses ten. So each stretch of the curve is compared with the picture on a grid of sag × swing
of its own, just fine enough for it; the stretches' scores are interpolated onto one common grid and added there. The
best curves are then moved a little to where they lie best, so that those which mean the same wire become one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray, projection_derivatives
from sagnode.geometry.conductor import conductor_points, gravity_direction, loaded_profile
from sagnode.match.bundle import lines
from sagnode.match.family import Family, Grid
from sagnode.match.ribbon import normals, pooled_response
from sagnode.match.robust import median
from sagnode.match.shrink import Box, box_around, halved
from sagnode.match.templates import View, even_parameters

SEARCH_SAMPLES = 64
GROUPS = 5
"""Stretches of the curve that have a grid of their own."""
MAX_TEMPLATES = 2_000
"""Beyond this a grid's steps grow, and each sample is looked for in a band instead."""
STEP_PX = 1.6
"""Largest movement of any sample of a curve from one template to the next; a response is ±1 px wide."""
SAG_ALONE = 0.6
"""By how much the steps shrink where swing is not searched, so that finer ones are cheap."""
BAND_GAIN = 1.5
"""By how much a grid's steps grow with the band in which a sample is looked for."""
POOL_PX = 2.0
"""Widest spacing of the five places across the curve whose best response counts where its place is uncertain."""
BAND_LIMITS_PX = (0.35, 0.8)
BANDS = ((0.0,), (-1.5, 0.0, 1.5), (-2.0, -1.0, 0.0, 1.0, 2.0))
"""Where across the curve to look, in its uncertainty of place, up to each limit of that and beyond."""
WIDE_PX = 2.0
"""Width of a wire that is still seen in a picture of half the size."""
REACH_PX = 48.0
"""Around the outermost curves' samples, what is kept of the picture for the search."""
SPREAD_PX = 4.0
"""Uncertainty of a sample's place at which it counts half."""
SWING_PRIOR = 0.3
"""Grey levels of mean response that one half-squared standard deviation of swing must earn."""

LEAST_SEEN = 0.2
"""Share of what the best seen curve shows in the frame that a curve must show."""
POLISHED = 8
"""Most peaks of the grid that are looked at more closely."""
POLISH = (1.0, 0.4)
"""How far about a peak to look at a time, in steps of the grid."""
DISTINCT_PX = 1.5
"""Typical distance, in px and bands, below which two curves are one."""


@dataclass(frozen=True)
class Candidate:
    """A local maximum of the coarse search."""

    sag: float
    swing: float
    score: float
    visible: float


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
    t = even_parameters(view, middle, 0.0, SEARCH_SAMPLES, span_share=0.5)
    if t.size < 2:
        return []
    spread, by_sag, by_swing = _movements(view, middle, t, attachment_u)
    family = Family.of(view, sag_range, t)
    if _blurred(view, family, middle, spread):
        box = _reach(view, family, sag_range, swing_max, image.shape)
        if box is not None:
            return search(*halved(image, view, box), sag_range, swing_max, swing_u, attachment_u, keep)
    step = STEP_PX * (1 + BAND_GAIN * np.minimum(spread, POOL_PX))
    sag_steps = by_sag * (sag_range[1] - sag_range[0]) / step
    # what swing does beyond what sag does decides whether swing is worth searching
    swing_steps = 2 * by_swing * swing_max / step
    if not float(np.percentile(swing_steps, 95)) > 4:
        swing_steps = np.zeros_like(swing_steps)
        sag_steps /= SAG_ALONE
    if not sag_steps.any():
        return []
    # the common grid must stay small too: steps that grow make a band of every place
    most = np.array([sag_steps.max(), swing_steps.max()])
    excess = max(1.0, float(np.prod(most + 1)) / MAX_TEMPLATES)
    most /= np.sqrt(excess) if most[1] > 0 else excess
    grids = []
    for part in np.array_split(np.arange(len(t)), GROUPS):
        wanted = np.array([sag_steps[part].max(), swing_steps[part].max()])
        n_sag, n_swing = np.ceil(np.minimum(wanted, most)).astype(int)
        sags = np.linspace(*sag_range, max(2, n_sag + 1))
        swings = np.linspace(-swing_max, swing_max, 2 * (n_swing // 2) + 3) if n_swing > 0 else np.zeros(1)
        coarser = float(np.max(wanted / np.maximum(most, 1e-9)))
        grown = np.maximum(spread[part], 0.5 * step[part] * coarser) if coarser > 1 else spread[part]
        grids.append((sags, swings, *_sums(image, view, family, sags[:, None], swings[None, :], part, grown)))
    sags = max((grid[0] for grid in grids), key=len)
    swings = max((grid[1] for grid in grids), key=len)
    total, count = np.zeros((2, len(sags), len(swings)))
    for own_sags, own_swings, own_total, own_count in grids:
        to_sag, to_swing = _interpolation(own_sags, sags), _interpolation(own_swings, swings)
        total += to_sag @ own_total @ to_swing.T
        count += to_sag @ own_count @ to_swing.T
    everything = max(float(np.sum(_trust(spread))), 1e-6)
    scores, visible = total / np.maximum(count, 1e-6), count / everything
    # the prior on swing decides where the view hardly sees it, and keeps clutter at extreme swings in its place
    prior = SWING_PRIOR * 0.5 * (swings / swing_u) ** 2
    found = _peaks(np.where(visible >= LEAST_SEEN * visible.max(initial=0.0), scores - prior, -np.inf), POLISHED)
    if not len(found):
        return []
    best_sags, best_swings = sags[found[:, 0]], swings[found[:, 1]]
    cell = np.array([np.diff(sags[:2]).item(), np.diff(swings[:2]).item() if len(swings) > 1 else 0.0])
    for width in POLISH:
        best_sags, best_swings, score, share = _polished(
            image, view, family, spread, (best_sags, best_swings), width * cell, sag_range, swing_max, swing_u
        )
    order = np.argsort(SWING_PRIOR * 0.5 * (best_swings / swing_u) ** 2 - score)
    candidates = []
    for k in order[_distinct(view, family, spread, best_sags[order], best_swings[order])][:keep]:
        own = (float(value[k]) for value in (best_sags, best_swings, score, share / everything))
        candidates.append(Candidate(*own))
    return candidates


def _blurred(view: View, family: Family, sag: float, spread: FloatArray) -> bool:
    """Whether the places of most samples are so uncertain, and the wires so wide, that half the pixels show as much."""
    if median(spread) <= 2 * POOL_PX:
        return False
    _, _, depth = family.pixels(view.intrinsics, np.arange(len(spread)), np.array([sag]), np.zeros(1))
    return median((view.diameter * view.intrinsics.fx / depth).ravel()) > WIDE_PX


def _reach(
    view: View, family: Family, sag_range: tuple[float, float], swing_max: float, shape: tuple[int, ...]
) -> Box | None:
    """What of a frame the family's curves may touch."""
    sags, swings = np.linspace(*sag_range, 3)[:, None], np.linspace(-swing_max, swing_max, 5)
    u, v, _ = family.pixels(view.intrinsics, np.arange(len(family.chord)), sags, swings)
    return box_around(u, v, REACH_PX, shape)


def _polished(
    image: GreyImage,
    view: View,
    family: Family,
    spread: FloatArray,
    start: tuple[FloatArray, FloatArray],
    reach: FloatArray,
    sag_range: tuple[float, float],
    swing_max: float,
    swing_u: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The best of the curves about each of some (K,): their sags, swings, scores and weights in the frame (K,).

    ``reach`` is how far to look in sag (m) and swing (rad).
    """
    steps = np.linspace(-1.0, 1.0, 5)
    aside = steps if reach[1] > 0 else np.zeros(1)
    by_sag, by_swing = (axis.ravel() for axis in np.meshgrid(steps * reach[0], aside * reach[1], indexing="ij"))
    sags = np.clip(start[0][:, None] + by_sag, *sag_range)
    swings = np.clip(start[1][:, None] + by_swing, -swing_max, swing_max)
    total, count = _sums(image, view, family, sags.ravel(), swings.ravel(), np.arange(len(spread)), spread)
    score = (total / np.maximum(count, 1e-6)).reshape(sags.shape)
    ranked = score - SWING_PRIOR * 0.5 * (swings / swing_u) ** 2
    best = np.argmax(ranked, axis=1)[:, None]
    parts = (sags, swings, score, count.reshape(sags.shape))
    polished = [np.take_along_axis(part, best, axis=1)[:, 0] for part in parts]
    return polished[0], polished[1], polished[2], polished[3]


def _distinct(view: View, family: Family, spread: FloatArray, sags: FloatArray, swings: FloatArray) -> NDArray[np.intp]:
    """Which of some curves (K,), the best first, are not one that came before them."""
    every = np.arange(len(spread))
    u, v, _ = family.pixels(view.intrinsics, every, sags, swings)
    pixels = np.stack([u, v], axis=-1).astype(np.float64)
    normal = normals(pixels.transpose(1, 0, 2)).transpose(1, 0, 2)
    kept: list[int] = []
    for k in range(len(sags)):
        across = np.sum((pixels[:, kept] - pixels[:, k : k + 1]) * normal[:, k : k + 1], axis=-1)
        apart = across / (1 + np.minimum(spread, POOL_PX))[:, None]
        if not kept or float(np.min(np.sqrt(np.nanmean(apart**2, axis=0)))) > DISTINCT_PX:
            kept.append(k)
    return np.array(kept, dtype=np.intp)


def _movements(view: View, sag: float, t: FloatArray, attachment_u: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What moves each sample (N,) across the curve, at that sag and no swing.

    Returns:
        The attachments' uncertainty (px, one standard deviation), sag (px per metre) and swing (px per radian).
    """
    points = conductor_points(view.near, view.far, sag, 0.0, t, view.load)
    pixels, _ = view.pixels(sag, 0.0, t)
    by_point, _ = projection_derivatives(view.intrinsics, view.pose, points)
    across = np.nan_to_num(np.einsum("ni,nij->nj", normals(pixels), by_point))
    # an attachment carries the curve along in proportion to how near it is
    spread = attachment_u * np.linalg.norm(across, axis=1) * np.hypot(1 - t, t)
    rise = view.far - view.near
    depth = loaded_profile(float(np.hypot(rise[0], rise[1])), float(rise[2]), sag, t, view.load)
    down, turned = gravity_direction(view.near, view.far, np.array([0.0, 1e-3]))
    return spread, np.abs(across @ down) * depth / sag, np.abs(across @ (turned - down)) * 1e3 * depth


def _trust(spread: FloatArray) -> FloatArray:
    """Weight (N,) of samples whose places are uncertain by ``spread`` px."""
    return np.asarray(1.0 / (1.0 + (spread / SPREAD_PX) ** 2))


def _interpolation(own: FloatArray, common: FloatArray) -> FloatArray:
    """Matrix (K, n) of linear interpolation from n even grid points to K over the same range."""
    if len(own) == 1:
        return np.ones((len(common), 1))
    place = np.linspace(0.0, len(own) - 1.0, len(common))
    first = np.minimum(place.astype(np.intp), len(own) - 2)
    matrix = np.zeros((len(common), len(own)))
    rows = np.arange(len(common))
    matrix[rows, first] = 1 - (place - first)
    matrix[rows, first + 1] = place - first
    return matrix


def _sums(
    image: GreyImage,
    view: View,
    family: Family,
    sags: FloatArray,
    swings: FloatArray,
    part: NDArray[np.intp],
    spread: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Sums (...) of the responses of one stretch's samples, and of the weights of those in the frame.

    Args:
        image: raw grey frame.
        view: the conductor as the camera sees it.
        family: its curves.
        sags: of the curves to compare, m; broadcasts with
        swings: of the same, rad.
        part: which samples of the family belong to the stretch (n,), without a gap.
        spread: how uncertain the place of each of them is (n,), px.
    """
    # a neighbour on either side gives the stretch's ends their tangents
    padded = np.arange(max(0, part[0] - 1), min(len(family.chord), part[-1] + 2))
    inner = slice(int(part[0] - padded[0]), int(part[0] - padded[0]) + len(part))
    u, v, depth = family.pixels(view.intrinsics, padded, sags, swings)
    du, dv = _along(u)[inner], _along(v)[inner]
    shorten = 1 / np.sqrt(np.maximum(du * du + dv * dv, np.float32(1e-9)))
    nu, nv = -dv * shorten, du * shorten
    width = np.float32(view.diameter * view.intrinsics.fx) / depth[inner]
    lead = (slice(None), part, *(None,) * (u.ndim - 1))
    place, side = lines(family.members[..., 0][lead] * nu + family.members[..., 1][lead] * nv, width)
    pool = np.minimum(spread, POOL_PX)
    band = BANDS[np.searchsorted(BAND_LIMITS_PX, float(pool.max()))]
    rows, shape = (len(part), -1), u.shape[1:]
    response, seen = pooled_response(
        image,
        (u[inner].reshape(rows), v[inner].reshape(rows)),
        (nu.reshape(rows), nv.reshape(rows)),
        (place.reshape(len(place), *rows), side.reshape(len(side), *rows)),
        (np.array(band)[:, None] * pool).astype(np.float32),
    )
    if not seen.all():
        response[~seen] = 0
    trust = _trust(spread).astype(np.float32)
    total = trust @ response.astype(np.float32)
    count = trust @ seen.astype(np.float32)
    return total.reshape(shape).astype(np.float64), count.reshape(shape).astype(np.float64)


def _along(values: Grid) -> Grid:
    """Differences of neighbours along the first axis: central ones, one-sided at the ends."""
    difference = np.empty_like(values)
    np.subtract(values[2:], values[:-2], out=difference[1:-1])
    np.subtract(values[1], values[0], out=difference[0])
    np.subtract(values[-1], values[-2], out=difference[-1])
    return difference


def _peaks(ranked: FloatArray, keep: int) -> NDArray[np.intp]:
    """Places (K, 2) of the local maxima of a grid, best first, non-maxima within two steps suppressed."""
    left = ranked.copy()
    found: list[tuple[int, int]] = []
    for _ in range(keep):
        i, j = divmod(int(np.argmax(left)), left.shape[1])
        if not np.isfinite(left[i, j]):
            break
        found.append((i, j))
        left[max(0, i - 2) : i + 3, max(0, j - 2) : j + 3] = -np.inf
    return np.array(found, dtype=np.intp).reshape(-1, 2)
