"""Light from one side: by how much a wire that is brighter on one side than on the other seems to lie aside.

A conductor is a cylinder. Lit from its left it is brighter on its left, and a kernel that expects it alike across finds
it a little towards what stands out more from the background: towards the lit side where the wire is bright before the
woods, away from it where it is dark before the sky. With a slope of A grey levels from its middle to its edge and a
contrast c, that is A/c times a sixth of the width for a wire thinner than the blur, times a fifth of it for a
wider one, and never more than about a pixel (``tests/match/test_shading.py`` measures it). All along a wire the sun
stands on the same side, so that no mean over blocks makes it less, and where a near wire is several pixels wide it is
many times what noise leaves of a block.

How strongly the wire is lit from one side is not known, only how bright the wire is: a matt cylinder in the sun is some
tenths of that brighter at one edge than in the middle. Two directions of light, from the picture's right and from
below, are therefore unknown as well, with the mean 0 and the standard deviation 1: the joint estimate takes what they
move for an error that all offsets of a wire share (:func:`sagnode.estimate.offsets.correlated_error`).
"""

from __future__ import annotations

from math import erf

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray
from sagnode.match.closer import SHARP_BLUR_PX
from sagnode.match.robust import median

SLOPE = 0.2
"""Standard deviation of the slope of light across a wire, over the wire's brightness, both in greys. Of a matt cylinder
on which the sun shines twice as strongly as an even sky it is 0 with the sun behind the camera and 0.7 with the sun
across it, under clouds 0; and greys are compressed to about half of that."""
PER_WIDTH, MOST_PX = 0.19, 1.1
"""Shift for a slope as large as the contrast: a share of the width, and px at most."""
MOST_SLOPE = 1.0
"""Most slope over contrast that is reckoned with: where a wire hardly stands out, one side of it is seen."""
LEAST_WIDTH_PX = 0.5
"""Wires that are nowhere wider are shifted by no more than what neighbours share of other errors."""
BESIDE_PX, LEAST_CONTRAST = 4.0, 3.0
"""How far beside a wire's edge its background is looked at; contrasts below so many grey levels are noise."""
WIDE_PX = 4.0
"""Width from which a wider block is no better witness of how bright the wire is."""

_WIDTHS = np.linspace(0.0, 5.0, 101)
_SHARES = _WIDTHS, np.array([max(erf(width / (2 * np.sqrt(2) * SHARP_BLUR_PX)), 0.1) for width in _WIDTHS])


def moved_by_light(
    image: GreyImage,
    pixel: FloatArray,
    normal: FloatArray,
    width: FloatArray,
    contrast: FloatArray,
    snr: FloatArray,
) -> FloatArray | None:
    """By how much blocks of a wire seem to lie aside for a light of one standard deviation, px (M, 2).

    Args:
        image: the frame.
        pixel: places of the blocks (M, 2).
        normal: unit normals there (M, 2); shifts are along them.
        width: expected width of the wire, px (M,).
        contrast: wire minus background, grey levels (M,); NaN where no wire was found.
        snr: amplitude of the wire over its own uncertainty (M,).

    Returns:
        For light from the right and from below; None where it is too little to matter.
    """
    clear: NDArray[np.intp] = np.flatnonzero(np.isfinite(contrast))
    if not len(clear) or width.max() < LEAST_WIDTH_PX:
        return None
    away = (0.5 * width + BESIDE_PX)[:, None] * normal
    background = 0.5 * _grey(image, np.concatenate([pixel + away, pixel - away])).reshape(2, -1).sum(axis=0)
    # a thin wire's contrast is spread over the blur
    found = np.where(np.isfinite(contrast), contrast, 0.0) / _share_within(width)
    # how bright the wire is, its widest and clearest blocks say; air makes far ones like their background
    witnesses = clear[np.argsort(-(snr * np.minimum(width, WIDE_PX))[clear])[: 1 + len(clear) // 4]]
    own = max(median((background + found)[witnesses]), 0.0)
    stands_out = np.maximum(np.maximum(np.abs(found), np.abs(own - background)), LEAST_CONTRAST)
    aside = np.minimum(PER_WIDTH * width, MOST_PX) * np.minimum(SLOPE * own / stands_out, MOST_SLOPE)
    return np.asarray((np.sign(found) * aside)[:, None] * normal)


def _share_within(width: FloatArray) -> FloatArray:
    """Share of a wire's contrast that its middle keeps in a sharp picture (N,)."""
    table_width, table = _SHARES
    return np.asarray(np.interp(width, table_width, table))


def _grey(image: GreyImage, pixel: FloatArray) -> FloatArray:
    """Grey of the nearest pixels (M,), at the frame's edge those inside."""
    height, width = image.shape
    column, row = (np.minimum(np.maximum(pixel.T + 0.5, 0.0), [[width - 1], [height - 1]])).astype(np.intp)
    return np.asarray(image[row, column], dtype=np.float64)
