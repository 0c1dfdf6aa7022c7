"""From a curve that is nearly right to sub-pixel observations of the wire across it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.fold import fold_at
from sagnode.match.kernels import MARGIN_PX
from sagnode.match.localise import localise_beside
from sagnode.match.masks import Neighbour, folds_back, others_near, pulled, reach_of
from sagnode.match.shading import moved_by_light
from sagnode.match.standing import UNKNOWN_PX, stand_out, texture_sigma
from sagnode.match.tip import BEHIND_PX, find_tip
from sagnode.match.track import Track

SHIFTS_PX = (16.0, -16.0, 23.0, -23.0, 31.0, -31.0, 11.0, -11.0)
"""Where the same curve is laid beside the wire to learn what the background alone looks like."""
TIP_CLEAR_PX = 8.0
"""Beyond the range in which a tip is looked for, what must be free of other wires."""
HALVED_PX = 12.0
"""Length from which the halves of a block are long enough to be measured."""


@dataclass(frozen=True)
class Observed:
    """The wire's offsets from a track, block by block, with what the background does at the same places.

    Attributes:
        track: the curve that was looked along.
        t: curve parameter of each block's centre (M,).
        arc: its position along the curve, px (M,).
        pixel: its pixel on the curve (M, 2).
        normal: unit normal there (M, 2).
        offset: of the wire along the normal, px (M,).
        sigma: standard uncertainty of the offset, px (M,): noise, and the chance that it is not the wire.
        noise: the part of it that is noise, and what wires that were taken out of the picture beside it leave, px (M,).
        half_range: greatest offset looked for, px (M,).
        texture: standard deviation of what the chance that this very block found texture adds, px (M,).
        scatter: standard uncertainty by which its two halves contradict each other, px (M,).
        rank: share of shifted curves that look less like a wire here (M,), 0..1.
        usable: blocks inside the frame, ranked above the background, not near another wire (M,).
        masked: blocks left out because another wire runs there (M,).
        shading: what light from the right and from below moves each block by (:mod:`sagnode.match.shading`), px (M, 2);
            None where that is too little to matter.
        tip: the block that is the tip of a fold instead, if that is beyond doubt.
    """

    track: Track
    t: FloatArray
    arc: FloatArray
    pixel: FloatArray
    normal: FloatArray
    offset: FloatArray
    sigma: FloatArray
    noise: FloatArray
    half_range: FloatArray
    texture: FloatArray
    scatter: FloatArray
    rank: FloatArray
    usable: NDArray[np.bool_]
    masked: NDArray[np.bool_]
    shading: FloatArray | None = None
    tip: int | None = None


def observe(
    image: GreyImage,
    track: Track,
    half_range: float | FloatArray,
    others: Sequence[Neighbour],
    block_px: float,
    shifts: int,
    run: int,
    margin: float = MARGIN_PX,
) -> Observed:
    """Measure the wire's offset in every block of a track.

    Args:
        image: raw grey frame.
        track: the predicted curve.
        half_range: how far across the curve to look, px; one value, or one for every sample (N,).
        others: other known wires; blocks that could see them, or cannot be told from them, are masked.
        block_px: length of a block; long blocks see fainter wires once the curve is nearly right.
        shifts: how many shifted curves a block is ranked against, nearest first.
        run: least number of usable blocks in a row.
        margin: background taken in on either side, px.
    """
    widest = float(np.max(half_range))
    away = [np.sign(shift) * (abs(shift) + widest) for shift in SHIFTS_PX[:shifts]]
    blocks, beside = localise_beside(
        image,
        track.pixels,
        track.normal,
        track.width,
        half_range,
        away,
        block_px,
        margin_px=margin,
        members=track.members,
        halves=block_px >= HALVED_PX,
    )
    index = np.clip(np.rint(blocks.index), 0, len(track.t) - 1).astype(np.int64)
    pixel, normal = track.pixels[index], track.normal[index]
    own_range = np.broadcast_to(np.asarray(half_range, dtype=np.float64), track.t.shape)[index]
    reach = reach_of(track, own_range) + margin - MARGIN_PX
    masked = folds_back(track, index, reach) | others_near(track, index, others, reach)
    stood = stand_out(blocks, beside, masked, own_range, widest, run)
    left = pulled(track, index, others)
    return Observed(
        track=track,
        t=track.t[index],
        arc=track.arc[index],
        pixel=pixel,
        normal=normal,
        offset=stood.offset,
        sigma=np.hypot(stood.sigma, left),
        noise=np.hypot(np.nan_to_num(blocks.sigma, nan=UNKNOWN_PX), left),
        half_range=own_range,
        texture=texture_sigma(blocks.snr, own_range),
        scatter=blocks.scatter,
        rank=stood.rank,
        usable=stood.usable,
        masked=masked,
        shading=moved_by_light(image, pixel, normal, track.width[index], blocks.contrast, blocks.snr),
    )


def _block_at(observed: Observed, sample: int) -> int:
    return int(np.argmin(np.abs(observed.arc - observed.track.arc[sample])))


def with_tip(
    image: GreyImage, observed: Observed, turn: int, others: Sequence[Neighbour], half_range: int
) -> Observed | None:
    """The same with the tip of a fold for the block there.

    ``turn`` is the sample of the track at which it turns back, ``half_range`` how far along its axis the tip is looked
    for, px, and ``others`` as in :func:`observe`. None where another wire runs there, where the tip is not clear, and
    for a bundle, whose wires have a tip each.
    """
    track, block = observed.track, _block_at(observed, turn)
    if len(track.members) > 1:
        return None
    if others_near(track, np.array([turn]), others, np.array([half_range + TIP_CLEAR_PX]))[0]:
        return None
    fold = fold_at(track, turn, BEHIND_PX + 3.0 * half_range)
    tip = None if fold is None else find_tip(image, fold, half_range)
    if fold is None or tip is None:
        return None

    def but(values: NDArray[Any], value: float) -> NDArray[Any]:
        """The same array with another value at the tip's block."""
        changed = values.copy()
        changed[block] = value
        return changed

    pixel, normal = observed.pixel.copy(), observed.normal.copy()
    pixel[block], normal[block] = fold.pixel, fold.axis
    return replace(
        observed,
        t=but(observed.t, fold.t),
        arc=but(observed.arc, float(track.arc[turn])),
        pixel=pixel,
        normal=normal,
        offset=but(observed.offset, tip.offset),
        sigma=but(observed.sigma, tip.sigma),
        noise=but(observed.noise, tip.sigma),
        half_range=but(observed.half_range, half_range),
        texture=but(observed.texture, 0.0),
        scatter=but(observed.scatter, 0.0),
        rank=but(observed.rank, 1.0),
        usable=but(observed.usable, True),
        masked=but(observed.masked, False),
        shading=None if observed.shading is None else but(observed.shading, 0.0),
        tip=block if tip.sure else None,
    )
