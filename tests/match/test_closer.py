"""A closer look at a wire: less disturbed by what is behind it, and as certain as it says."""

import numpy as np
import pytest

from sagnode.match import closer
from sagnode.match.kernels import wire_kernel, wire_slope
from sagnode.match.localise import localise
from sagnode.match.ribbon import normals

HEIGHT, WIDTH = 120, 400


def texture(rng, deviation):
    """Clouds and hills: amplitudes that fall with frequency."""
    frequency = np.hypot(np.fft.fftfreq(HEIGHT)[:, None], np.fft.rfftfreq(WIDTH)[None])
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((HEIGHT, WIDTH))) * frequency**-1.2 * np.exp(-2 * frequency**2)
    grey = np.fft.irfft2(spectrum, s=(HEIGHT, WIDTH))
    return deviation * grey / grey.std()


def errors(blur, clouds, noise, width=1.5, contrast=-40.0, *, exact=True):
    """Errors of offsets, px, and what they say of themselves."""
    some = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        row, shift = 60 + rng.uniform(-0.5, 0.5), rng.uniform(-2, 2)
        picture = 130 + texture(rng, clouds) + noise * rng.standard_normal((HEIGHT, WIDTH))
        picture += contrast * wire_kernel(width, np.arange(float(HEIGHT)) - row, blur)[:, None]
        u = np.linspace(10, WIDTH - 10, WIDTH - 19)
        pixels = np.stack([u, np.full_like(u, row + shift)], axis=1)
        image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        blocks = localise_once(image, pixels, width, exact)
        good = blocks.valid & (np.abs(blocks.offset + shift) < 1.5)
        some.append((blocks.offset[good] + shift, blocks.sigma[good]))
    error, sigma = (np.concatenate(part) for part in zip(*some, strict=True))
    return error, sigma


def localise_once(image, pixels, width, exact):
    return localise(image, pixels, normals(pixels), width, 3.0, exact=exact)


def test_before_clouds_and_hills_a_wire_is_placed_much_better_than_by_the_kernel_that_finds_it():
    (near, sigma), (far, _) = errors(0.75, 8.0, 1.0), errors(0.75, 8.0, 1.0, exact=False)
    assert near.std() < 0.75 * far.std()
    assert abs(near.mean()) < 0.01
    assert 0.6 < (near / sigma).std() < 1.5


@pytest.mark.parametrize("blur", [0.65, 0.8, 1.0])
def test_before_a_plain_sky_it_is_hardly_worse_however_sharp_the_picture_is(blur):
    (near, sigma), (far, _) = errors(blur, 0.0, 3.0), errors(blur, 0.0, 3.0, exact=False)
    assert near.std() < 1.15 * far.std()
    assert 0.6 < (near / sigma).std() < 1.4


def test_what_lies_elsewhere_is_not_taken_for_the_wire():
    profile = 100 - 40 * wire_kernel(1.0, 0.5 * np.arange(-30.0, 31.0))[None]
    for away, seen in ((0.3, True), (1.5, False)):
        found = np.array([30 + away / 0.5])
        close = closer.look_closer([profile], np.zeros((1, 1)), np.ones(1), found, 3.0, 12)
        if seen:
            assert close.farther == pytest.approx(-away, abs=0.05)
        else:
            assert close.farther != pytest.approx(-away, abs=0.5)


def test_the_slope_of_a_kernel_is_its_derivative():
    positions, step = np.linspace(-6, 6, 49), 1e-5
    for width in (0.2, 1.0, 4.0):
        difference = (wire_kernel(width, positions + step) - wire_kernel(width, positions - step)) / (2 * step)
        np.testing.assert_allclose(wire_slope(width, positions), difference, atol=2e-2 * min(width, 1.0))
