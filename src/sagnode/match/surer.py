"""Which of two looks at a wire says more surely where it lies, and how surely.

Noise is what a look leaves that is not the same on both sides of the wire: a wire is wider, sharper or darker within
than its kernel says, but alike on both sides, and what is alike on both sides does not move it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray
from sagnode.match.closer import Close
from sagnode.match.robust import median

ROUNDING_GREY = 0.15
"""Least noise of a block's mean profile: 8-bit rounding, averaged along the block."""
UNEVEN = 1.1
"""Factor of the noise seen on one side more than on the other, for what taking the lesser of two and leaving out the
kernel's slope cost it; see the tests."""
AROUND = 3
"""Blocks to either side whose noise counts when the looks are compared: one by itself is too uncertain a judge."""
GAIN = (0.1, 2.0)
"""Bounds of what a movement shows over what it would show in a picture as sharp as the sharp kernel."""


@dataclass(frozen=True)
class Found:
    """What the first look says of M blocks.

    Attributes:
        sigma: standard uncertainty of the offset from all that is left, px (M,).
        noise: that, grey levels (M,).
        uneven: mean square of what of it is not alike on both sides (M,).
        height: wire minus background, grey levels (M,), if it were as wide as a blurred box.
        alike: where the two sides can be compared (M,).
        correlated: factor of an offset's uncertainty because samples share pixels (M,).
    """

    sigma: FloatArray
    noise: FloatArray
    uneven: FloatArray
    height: FloatArray
    alike: NDArray[np.bool_]
    correlated: FloatArray


def settle(found: Found, close: Close) -> tuple[NDArray[np.bool_], FloatArray]:
    """In which blocks (M,) the closer look is surer, and the standard uncertainty (M,) of the surer look, px."""
    with np.errstate(divide="ignore", invalid="ignore"):
        answer = close.reply / (found.height * close.steepness)
        known = np.isfinite(close.farther) & np.isfinite(answer)
        gain = float(np.clip(median(answer[known]), *GAIN)) if known.any() else 1.0
        sharp_unit = found.correlated / (gain * np.abs(found.height) * close.steepness)
        broad_unit = found.sigma / found.noise
        near, wide = _around(found.uneven, 1), _around(found.uneven, AROUND)
        close_near, close_wide = _around(close.uneven, 1), _around(close.uneven, AROUND)
        broad = [
            np.where(found.alike, np.minimum(found.noise, _grey(UNEVEN**2 * part)), found.noise) * broad_unit
            for part in (np.maximum(found.uneven, near), wide)
        ]
        parts = (np.maximum(close.uneven, np.maximum(close_near, close_wide)), close_wide)
        sharp = [np.where(found.alike, _grey(part), _grey(close.noise)) * sharp_unit for part in parts]
    surer = known & (sharp[1] < broad[1])
    return surer, np.where(surer, sharp[0], broad[0])


def _grey(squared: FloatArray) -> FloatArray:
    """Noise in grey levels from its mean square, the rounding of grey levels included."""
    return np.asarray(np.sqrt(squared + ROUNDING_GREY**2))


def _around(values: FloatArray, far: int) -> FloatArray:
    """Means (M,) over each block and those up to ``far`` to either side, mirrored at the ends."""
    far = min(far, len(values) - 1)
    padded = np.pad(values, far, mode="reflect") if far else values
    return np.asarray(np.mean(np.lib.stride_tricks.sliding_window_view(padded, 2 * far + 1), axis=1))
