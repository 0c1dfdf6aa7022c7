"""Random textures that repeat seamlessly, and their sampling."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Floats = NDArray[np.floating[Any]]
TILE = 512
"""Side of a tile, texels."""


@lru_cache(maxsize=32)
def tile(seed: int, name: str, slope: float = 1.1, coarsest: float = 96.0, finest: float = 2.0) -> Float32:
    """A periodic fractal texture (TILE, TILE) of mean 0 and standard deviation 1.

    Args:
        seed: of the scene.
        name: which texture; others are independent of it.
        slope: fall of the amplitude with frequency (0: white, 1: clouds, 2: soft).
        coarsest: longest wavelength, texels.
        finest: shortest wavelength, texels; keep it >= 2, or bilinear sampling shows the texels.
    """
    rng = np.random.Generator(np.random.PCG64([seed, *name.encode()]))
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None, :])
    with np.errstate(divide="ignore"):
        amplitude = np.where(frequency > 0, frequency**-slope, 0.0)
    amplitude *= 1 / (1 + (1 / (np.maximum(frequency, 1e-9) * coarsest)) ** 4)
    amplitude *= np.exp(-((frequency * finest) ** 2) / 2)
    spectrum = np.fft.rfft2(rng.standard_normal((TILE, TILE))) * amplitude
    texture = np.fft.irfft2(spectrum, s=(TILE, TILE))
    return np.asarray((texture - texture.mean()) / texture.std(), dtype=np.float32)


def sample(texture: Float32, x: Floats, y: Floats) -> Float32:
    """Bilinear values of a repeated tile at texel coordinates (any range), same shape as ``x``."""
    # remap keeps source positions in 16 bits, so they are brought into the first tile before.
    side = np.float32(TILE)
    x = x - side * np.floor(x / side)
    y = y - side * np.floor(y / side)
    flat = x.ndim == 1
    if flat:
        x, y = x[None, :], y[None, :]
    values = cv2.remap(
        texture,
        np.ascontiguousarray(x, dtype=np.float32),
        np.ascontiguousarray(y, dtype=np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )
    return np.asarray(values[0] if flat else values, dtype=np.float32)


def generator(*keys: int | str) -> np.random.Generator:
    """A PCG64 generator of its own for a purpose, e.g. ``generator(seed, "trees")``."""
    words: list[int] = []
    for key in keys:
        words.extend(key.encode() if isinstance(key, str) else [abs(key)])
    return np.random.Generator(np.random.PCG64(words))
