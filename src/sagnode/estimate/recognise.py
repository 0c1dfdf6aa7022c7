"""A second look for landmarks that the reference's patches do not find, by the appearances that are kept of them."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.estimate.movement import ASIDE_PX, SEEN_U_PX, Anchor, agreeing, anchored, movement
from sagnode.geometry.camera import FloatArray
from sagnode.match.agreement import is_chance
from sagnode.match.appearances import FOUND_U_PX, Appearance, Appearances, sightings
from sagnode.match.landmarks import Tracked, consensus, refine
from sagnode.match.patches import Peak, peaks
from sagnode.site import Site

FORETOLD_PX = 3.0
"""Standard uncertainty above which the landmarks that were found foretell nothing of the others."""
SAME_PX = 2.0
"""Places nearer to each other than this are one."""
_PEAKS_MAX = 5


def recognise(site: Site, image: GreyImage, tracked: Tracked, kept: Appearances, needed: int) -> Tracked:
    """What was tracked by the reference's patches, with landmarks that kept appearances add.

    Args:
        site: with its reference picture.
        image: the frame.
        tracked: what the reference's patches found in it.
        kept: appearances of every landmark.
        needed: landmarks without which the camera's place cannot be told.
    """
    missing = tracked.visible & ~tracked.found & np.array([any(a.proven for a in own) for own in kept], dtype=bool)
    if site.patches is None or not missing.any():
        return tracked
    anchor = anchored(site)
    if tracked.count >= needed:
        return _beside(site, anchor, image, tracked, kept, missing)
    return _anew(site, anchor, image, tracked, kept, needed)


def _beside(
    site: Site, anchor: Anchor, image: GreyImage, tracked: Tracked, kept: Appearances, missing: NDArray[np.bool_]
) -> Tracked:
    """Missing landmarks where those that were found foretell them."""
    told = movement(site, anchor, tracked.pixels, np.full(len(kept), SEEN_U_PX), tracked.found)
    places: dict[int, tuple[FloatArray, float, Appearance]] = {}
    for i in np.flatnonzero(missing & (told.sigma <= FORETOLD_PX)):
        expected = told.pixels[i]
        limit = max(ASIDE_PX, 3 * float(np.hypot(told.sigma[i], FOUND_U_PX)))
        for peak, appearance in sightings(image, expected, kept[i], limit + 1):
            place, error = refine(image, appearance.patch(expected), peak)
            if float(np.hypot(*(place - expected))) <= limit:
                places[int(i)] = (place, error, appearance)
                break
    return _with_found(tracked, tracked.found, places)


def _anew(site: Site, anchor: Anchor, image: GreyImage, tracked: Tracked, kept: Appearances, needed: int) -> Tracked:
    """All landmarks by patches and appearances together; as it was where they do not agree closely."""
    patches = list(site.patches or ())
    reach = site.max_movement_px + 8
    options: list[list[Peak]] = []
    by: list[dict[Peak, Appearance]] = []
    for patch, clicked, own in zip(patches, site.landmark_clicks, kept, strict=True):
        first = [] if patch is None else peaks(image, patch, reach)
        others = {} if patch is None else dict(sightings(image, clicked, own, reach))
        # where the reference finds it too, the reference counts
        others = {p: a for p, a in others.items() if all(np.hypot(p[0] - q[0], p[1] - q[1]) > SAME_PX for q in first)}
        options.append(sorted([*first, *others], key=lambda peak: -peak[2])[:_PEAKS_MAX])
        by.append(others)
    chosen = consensus(patches, options, site.intrinsics)
    pixels, sigma, seen = tracked.pixels.copy(), np.full(len(kept), SEEN_U_PX), np.zeros(len(kept), dtype=bool)
    errors = tracked.sigma.copy()
    for i, peak in chosen.items():
        appearance, patch = by[i].get(peak), patches[i]
        if appearance is not None:
            patch, sigma[i] = appearance.patch(site.landmark_clicks[i]), FOUND_U_PX
        if patch is not None:
            pixels[i], errors[i] = refine(image, patch, peak)
            seen[i] = True
    seen = agreeing(site, anchor, pixels, sigma, seen, needed + 1)
    if not seen.any():
        return tracked
    found = {i: peak for i, peak in chosen.items() if seen[i]}
    used = [
        by[i][found[i]].patch(clicked) if i in found and found[i] in by[i] else patch
        for i, (patch, clicked) in enumerate(zip(patches, site.landmark_clicks, strict=True))
    ]
    if is_chance(image, used, options, found, reach, site.intrinsics):
        return tracked
    plain = seen & np.array([i in found and found[i] not in by[i] for i in range(len(kept))], dtype=bool)
    places = {i: (pixels[i], float(errors[i]), by[i][peak]) for i, peak in found.items() if peak in by[i]}
    return _with_found(replace(tracked, pixels=pixels, sigma=errors), plain, places)


def _with_found(
    tracked: Tracked, plain: NDArray[np.bool_], places: dict[int, tuple[FloatArray, float, Appearance]]
) -> Tracked:
    """The landmarks found by the reference (``plain``) and those found by appearances."""
    pixels, sigma = np.where(plain[:, None], tracked.pixels, np.nan), np.where(plain, tracked.sigma, np.nan)
    found, cut_at = plain.copy(), dict[int, datetime]()
    for i, (place, error, appearance) in places.items():
        pixels[i], sigma[i], found[i] = place, np.hypot(error, FOUND_U_PX), True
        cut_at[i] = appearance.cut_at
    return replace(tracked, pixels=pixels, sigma=sigma, found=found, cut_at=cut_at)
