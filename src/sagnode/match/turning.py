"""Movements in a picture as the turns of the camera that make them.

A turn moves what lies at the edge of a picture farther than what lies in its middle, and a wide lens bends that: under
one turn landmarks move apart by a quarter of their movement, which no shift, turn and scale of the picture does. As
turns about the two axes across, they all move alike; and a roll turns and shifts their places in the plane.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray, Intrinsics, distort, undistort

ComplexArray = NDArray[np.complex128]
_STEP = 1e-6
"""Of normalised coordinates, by which the lens's derivatives are taken."""


def as_turns(lens: Intrinsics, pixels: FloatArray, shift: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Places (N,) of pixels (N, 2) in the plane, and the turns (N,) that move them by ``shift`` (N, 2), all in px.

    Real to the right, imaginary down. A turn by v moves the point (x, y) of the plane by
    ``v₂ (1 + x², xy) - v₁ (xy, 1 + y²)``; taken midway between both ends, that holds for long ways too.
    """
    clicked = np.array([_seen_at(lens, u, v) for u, v in pixels.tolist()], dtype=np.complex128)
    way = shift[:, 0] / lens.fx + 1j * shift[:, 1] / lens.fy
    midway = clicked + 0.5 * _before_lens(lens, clicked, way)
    moved = _before_lens(lens, midway, way)
    x, y = midway.real, midway.imag
    along, down = moved.real, moved.imag
    turn = ((1 + y * y) * along - x * y * down) + 1j * ((1 + x * x) * down - x * y * along)
    focal = 0.5 * (lens.fx + lens.fy)
    return np.asarray(focal * clicked), np.asarray(focal * turn / (1 + x * x + y * y), dtype=np.complex128)


@lru_cache(maxsize=512)
def _seen_at(lens: Intrinsics, u: float, v: float) -> complex:
    """Where a pixel lies in the plane, normalised; landmarks are clicked once and looked for in every frame."""
    x, y = undistort(lens, np.array([u]), np.array([v]))
    return complex(x[0], y[0])


def _before_lens(lens: Intrinsics, place: ComplexArray, way: ComplexArray) -> ComplexArray:
    """What small ways (N,) behind the lens are before it, at places (N,) in the plane, normalised."""
    if not any(lens.distortion):
        return way
    steps = np.array([[0.0], [_STEP], [1j * _STEP]])
    x, y = distort(lens, (place + steps).real, (place + steps).imag)
    xx, xy, yx, yy = ((part[k] - part[0]) / _STEP for part in (x, y) for k in (1, 2))
    a, b = way.real, way.imag
    return np.asarray(((yy * a - xy * b) + 1j * (xx * b - yx * a)) / (xx * yy - xy * yx))
