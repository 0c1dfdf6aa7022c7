"""Template library of a conductor: what the coarse search compares with a picture, drawn without looking at one.

Every sample of the curve moves at its own pace: seen along the line, one near the camera crosses a hundred pixels
while one at the far end crosses ten. So each stretch of the curve has a grid of sag × swing of its own, just fine
enough for it. A library is good for as long as the camera stays where it is, so that the frames of a burst share one;
nothing of what a frame shows is in it.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray, Intrinsics, place_derivatives
from sagnode.geometry.conductor import conductor_points, gravity_direction, loaded_profile
from sagnode.match.bundle import lines
from sagnode.match.family import Family
from sagnode.match.ribbon import Singles, normals
from sagnode.match.robust import median, percentile
from sagnode.match.shrink import Box, box_around, halved_view
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
STILL_PX = 0.3
"""Movement of the curves in the picture below which the same library serves: a response is ±1 px wide."""
NOT_ASIDE = np.zeros((1, 1, 1), dtype=np.float32)


@dataclass(frozen=True)
class Places:
    """Where some samples (M,) of some curves (N in all, of any shape) are looked at.

    Attributes:
        pixel: columns and rows (M, N), px.
        normal: both components (M, N) of the curves' unit normals.
        lines: where across the curve each line is, and the distance of its sides, px (m, M, N).
        band: where across the curves to look (B, M), px.
        trust: weight of each sample (M,).
        shape: of the curves.
    """

    pixel: tuple[Singles, Singles]
    normal: tuple[Singles, Singles]
    lines: tuple[Singles, Singles]
    band: Singles
    trust: Singles
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Stretch:
    """One stretch of the curve and the grid of sags (m) and swings (rad) that it is compared on."""

    sags: FloatArray
    swings: FloatArray
    places: Places


@dataclass(frozen=True)
class Library:
    """All that the search of one conductor needs besides the picture.

    Attributes:
        view: the conductor as the camera saw it, in a picture of the size that is searched.
        boxes: parts of the picture that are halved in size before it is searched, one after the other.
        sag_range: smallest and largest in-plane sag, m.
        swing_max: largest swing, rad.
        family: the curves.
        spread: how uncertain the place of each sample is, px (N,).
        stretches: the curve, piece by piece.
        seen_from: the view that was asked for, and the parameters (N,) and pixels (N, 2) of one of its curves.
    """

    view: View
    boxes: tuple[Box, ...]
    sag_range: tuple[float, float]
    swing_max: float
    family: Family
    spread: FloatArray
    stretches: tuple[Stretch, ...]
    seen_from: tuple[View, FloatArray, FloatArray]

    def serves(self, view: View) -> bool:
        """Whether the camera has stayed where it was, so that the curves of another frame's view are the same."""
        before, t, pixels = self.seen_from
        if view.load != before.load or not np.array_equal(view.members, before.members):
            return False
        moved = np.abs(view.pixels(_middle(self.sag_range), 0.0, t)[0] - pixels)
        return bool(np.isfinite(moved).any() and np.nanmax(moved) <= STILL_PX)


class Shelf:
    """The libraries of a burst's conductors: drawn for the first frame, and anew where the camera has moved since."""

    def __init__(self) -> None:
        self._kept: dict[str, Library | None] = {}

    def take(
        self, name: str, view: View, sag_range: tuple[float, float], swing_max: float, attachment_u: float
    ) -> Library | None:
        """The library of the conductor ``name``; arguments as of :func:`draw_library`."""
        kept = self._kept.get(name)
        if kept is None or not kept.serves(view):
            kept = self._kept[name] = draw_library(view, sag_range, swing_max, attachment_u)
        return kept


def draw_library(view: View, sag_range: tuple[float, float], swing_max: float, attachment_u: float) -> Library | None:
    """The library of one conductor; None where nothing of it can be seen, or nothing that its sag would move.

    Args:
        view: the conductor as the camera sees it now.
        sag_range: smallest and largest in-plane sag, m.
        swing_max: largest swing, rad; a view that cannot tell swing is searched at zero only.
        attachment_u: standard uncertainty of the attachments, m; samples that it moves are looked for in a band.
    """
    return _drawn(view, sag_range, swing_max, attachment_u)


def _drawn(view: View, sag_range: tuple[float, float], swing_max: float, attachment_u: float) -> Library | None:
    """:func:`draw_library`, in a picture of half the size where that shows as much."""
    middle = _middle(sag_range)
    t = even_parameters(view, middle, 0.0, SEARCH_SAMPLES, span_share=0.5)
    if t.size < 2:
        return None
    pixels, _ = view.pixels(middle, 0.0, t)
    spread, by_sag, by_swing = _movements(view, middle, t, pixels, attachment_u)
    family = Family.of(view, sag_range, t)
    if _blurred(view, family, middle, spread):
        box = _reach(view, family, sag_range, swing_max)
        if box is not None:
            inner = _drawn(halved_view(view, box), sag_range, swing_max, attachment_u)
            return inner and replace(inner, boxes=(box, *inner.boxes), seen_from=(view, t, pixels))
    step = STEP_PX * (1 + BAND_GAIN * np.minimum(spread, POOL_PX))
    sag_steps = by_sag * (sag_range[1] - sag_range[0]) / step
    # what swing does beyond what sag does decides whether swing is worth searching
    swing_steps = 2 * by_swing * swing_max / step
    if not percentile(swing_steps, 95) > 4:
        swing_steps = np.zeros_like(swing_steps)
        sag_steps /= SAG_ALONE
    if not sag_steps.any():
        return None
    # the common grid must stay small too: steps that grow make a band of every place
    most = np.array([sag_steps.max(), swing_steps.max()])
    excess = max(1.0, float(np.prod(most + 1)) / MAX_TEMPLATES)
    most /= np.sqrt(excess) if most[1] > 0 else excess
    stretches = []
    for part in np.array_split(np.arange(len(t)), GROUPS):
        wanted = np.array([sag_steps[part].max(), swing_steps[part].max()])
        n_sag, n_swing = np.ceil(np.minimum(wanted, most)).astype(int)
        sags = np.linspace(*sag_range, max(2, n_sag + 1))
        swings = np.linspace(-swing_max, swing_max, 2 * (n_swing // 2) + 3) if n_swing > 0 else np.zeros(1)
        coarser = float(np.max(wanted / np.maximum(most, 1e-9)))
        grown = np.maximum(spread[part], 0.5 * step[part] * coarser) if coarser > 1 else spread[part]
        stretches.append(Stretch(sags, swings, places_of(view, family, sags[:, None], swings[None, :], part, grown)))
    return Library(view, (), sag_range, swing_max, family, spread, tuple(stretches), (view, t, pixels))


def places_of(
    view: View, family: Family, sags: FloatArray, swings: FloatArray, part: NDArray[np.intp], spread: FloatArray
) -> Places:
    """Where a stretch of some curves is looked at.

    Args:
        view: the conductor as the camera sees it.
        family: its curves.
        sags: of the curves, m; broadcasts with
        swings: of the same, rad.
        part: which samples of the family belong to the stretch (n,), without a gap.
        spread: how uncertain the place of each of them is (n,), px.
    """
    pool = np.minimum(spread, POOL_PX)
    band = BANDS[bisect_left(BAND_LIMITS_PX, float(pool.max()))]
    width = view.diameter * view.intrinsics.fx
    if len(family.members) == 1:
        step = pool.astype(np.float32) if band == BANDS[-1] else None
        u, v, nu, nv, side = family.placed(view.intrinsics, part, sags, swings, width, step)
        place, side = NOT_ASIDE, side[None]
    else:
        u, v, nu, nv, depth = family.placed(view.intrinsics, part, sags, swings)
        across = family.members[:, part, :1] * nu + family.members[:, part, 1:] * nv
        place, side = lines(across, np.float32(width) / depth)
    return Places(
        pixel=(u, v),
        normal=(nu, nv),
        lines=(place, side),
        band=(np.array(band)[:, None] * pool).astype(np.float32),
        trust=trust(spread).astype(np.float32),
        shape=np.broadcast_shapes(sags.shape, swings.shape),
    )


def trust(spread: FloatArray) -> FloatArray:
    """Weight (N,) of samples whose places are uncertain by ``spread`` px."""
    return np.asarray(1.0 / (1.0 + (spread / SPREAD_PX) ** 2))


def _middle(sag_range: tuple[float, float]) -> float:
    return 0.5 * (sag_range[0] + sag_range[1])


def _blurred(view: View, family: Family, sag: float, spread: FloatArray) -> bool:
    """Whether the places of most samples are so uncertain, and the wires so wide, that half the pixels show as much."""
    if median(spread) <= 2 * POOL_PX:
        return False
    _, _, depth = family.pixels(view.intrinsics, np.arange(len(spread)), np.array([sag]), np.zeros(1))
    return median((view.diameter * view.intrinsics.fx / depth).ravel()) > WIDE_PX


def _reach(view: View, family: Family, sag_range: tuple[float, float], swing_max: float) -> Box | None:
    """What of a frame the family's curves may touch."""
    lens: Intrinsics = view.intrinsics
    sags, swings = np.linspace(*sag_range, 3)[:, None], np.linspace(-swing_max, swing_max, 5)
    u, v, _ = family.pixels(lens, np.arange(len(family.chord)), sags, swings)
    return box_around(u, v, REACH_PX, (lens.height, lens.width))


def _movements(
    view: View, sag: float, t: FloatArray, pixels: FloatArray, attachment_u: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What moves each sample (N,) across the curve, at that sag and no swing, from its pixels (N, 2) there.

    Returns:
        The attachments' uncertainty (px, one standard deviation), sag (px per metre) and swing (px per radian).
    """
    points = conductor_points(view.near, view.far, sag, 0.0, t, view.load)
    by_point = place_derivatives(view.intrinsics, view.pose, points)
    across = np.nan_to_num(np.einsum("ni,nij->nj", normals(pixels), by_point))
    # an attachment carries the curve along in proportion to how near it is
    spread = attachment_u * np.linalg.norm(across, axis=1) * np.hypot(1 - t, t)
    rise = view.far - view.near
    depth = loaded_profile(float(np.hypot(rise[0], rise[1])), float(rise[2]), sag, t, view.load)
    down, turned = (gravity_direction(view.near, view.far, swing) for swing in (0.0, 1e-3))
    return spread, np.abs(across @ down) * depth / sag, np.abs(across @ (turned - down)) * 1e3 * depth
