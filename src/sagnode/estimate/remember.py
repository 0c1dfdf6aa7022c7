"""Remembering: what a frame teaches about the looks of landmarks, where the reference's own patches fix the camera.

Nothing that an appearance has found takes part in this: the reference's landmarks place every cut, and every proof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from sagnode.capture.port import GreyImage
from sagnode.estimate.movement import ASIDE_PX, SEEN_U_PX, Anchor, anchored, movement
from sagnode.estimate.register import register
from sagnode.geometry.camera import FloatArray
from sagnode.match.appearances import (
    KEPT_MAX,
    KEPT_NCC_MIN,
    Appearance,
    Appearances,
    cut_appearance,
    likeness,
    proven_again,
    with_added,
)
from sagnode.match.landmarks import Tracked, refine
from sagnode.match.patches import peaks
from sagnode.site import Site

TEACHERS_MIN = 4
"""Landmarks found by the reference without which the place of another is not foretold."""
PLACE_U_MAX_PX = 0.25
"""Standard uncertainty of a place above which nothing is cut there."""
NEW_BELOW = 0.85
"""A look that correlates more than this with one that is known teaches nothing."""
TRIAL = timedelta(minutes=30)
"""What is seen again sooner may still be the same bird."""
PATIENCE = timedelta(days=1)
"""So long an appearance on trial keeps its place among those that are full."""


@dataclass(frozen=True)
class _Lesson:
    """A frame whose camera the reference's landmarks fix."""

    site: Site
    image: GreyImage
    at: datetime
    anchor: Anchor
    tracked: Tracked
    teachers: NDArray[np.bool_]

    def place(self, i: int) -> FloatArray | None:
        """Where landmark ``i`` is (2,), by its own patch and by what the others foretell; None where unsure."""
        others = self.teachers.copy()
        others[i] = False
        if int(others.sum()) < TEACHERS_MIN:
            return None
        told = movement(self.site, self.anchor, self.tracked.pixels, np.full(len(others), SEEN_U_PX), others)
        foretold, u = told.pixels[i], float(told.sigma[i])
        own = self.tracked.pixels[i]
        if not self.tracked.found[i] or float(np.hypot(*(own - foretold))) > 3 * float(np.hypot(u, SEEN_U_PX)):
            # where its own patch is pulled aside by a changed look, all the others know better
            return foretold if u <= PLACE_U_MAX_PX else None
        weight = u**2 / (u**2 + SEEN_U_PX**2)
        return np.asarray(foretold + weight * (own - foretold))


def remember(site: Site, image: GreyImage, kept: Appearances, at: datetime) -> Appearances:
    """What is kept after a frame: appearances it proves or contradicts, and new looks of landmarks that it shows.

    A frame in which nothing was measured should not be asked: where no wire fits the camera, the camera may be wrong.

    Args:
        site: with its reference picture.
        image: the frame (height, width) uint8.
        kept: what was kept before.
        at: when the frame was taken, aware UTC.
    """
    if site.patches is None:
        return kept
    lesson = _lesson(site, image, at)
    if lesson is None:
        return kept
    after = list(kept)
    for i in np.flatnonzero(lesson.tracked.visible):
        place = lesson.place(int(i))
        if place is not None:
            after[i] = _taught(lesson, int(i), place, kept[i])
    return tuple(after)


def _lesson(site: Site, image: GreyImage, at: datetime) -> _Lesson | None:
    registered, reasons = register(site, image)
    tracked = registered.tracked
    if reasons or tracked is None or tracked.count < TEACHERS_MIN:
        return None
    anchor = anchored(site)
    told = movement(site, anchor, tracked.pixels, np.full(len(tracked.found), SEEN_U_PX), tracked.found)
    aside = np.hypot(*(np.where(tracked.found[:, None], tracked.pixels, np.inf) - told.pixels).T)
    return _Lesson(site, image, at, anchor, tracked, aside <= ASIDE_PX)


def _taught(lesson: _Lesson, i: int, place: FloatArray, kept: Sequence[Appearance]) -> tuple[Appearance, ...]:
    """The appearances of one landmark after a frame in which its place is known."""
    patch = (lesson.site.patches or ())[i]
    if patch is None:
        return tuple(kept)
    left = [a for a in kept if not _contradicted(lesson, i, place, a)]
    alike = [likeness(lesson.image, a.image, place) for a in left]
    best = max([likeness(lesson.image, patch.image, place), *alike])
    after = tuple(
        proven_again(a, lesson.at, best=same == best)
        if same >= KEPT_NCC_MIN and abs(lesson.at - a.cut_at) >= TRIAL
        else a
        for a, same in zip(left, alike, strict=True)
    )
    full = len(after) >= KEPT_MAX
    if best >= NEW_BELOW or (full and any(not a.proven and abs(lesson.at - a.cut_at) < PATIENCE for a in after)):
        return after
    new = cut_appearance(lesson.image, place, patch.image.shape[0], lesson.at)
    return after if new is None else with_added(after, new)


def _contradicted(lesson: _Lesson, i: int, place: FloatArray, appearance: Appearance) -> bool:
    """Whether an appearance finds its landmark clearly where it is not."""
    patch = appearance.patch(lesson.site.landmark_clicks[i])
    seen = peaks(lesson.image, patch, lesson.site.max_movement_px + 8, KEPT_NCC_MIN)
    if not seen:
        return False
    found, _ = refine(lesson.image, patch, seen[0])
    return float(np.hypot(*(found - place))) > ASIDE_PX
