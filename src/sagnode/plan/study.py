"""Planning one camera thoroughly, and many of them for a table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sagnode.config.span import Span
from sagnode.plan.aim import best_aim
from sagnode.plan.camera import PlannedCamera, planned_site
from sagnode.plan.foresee import LEVELS, Foreseen, foresee, states_at, worst
from sagnode.plan.frame import Look
from sagnode.plan.improve import Gain, gains
from sagnode.quality import Validity
from sagnode.site import Site


@dataclass(frozen=True)
class Study:
    """One camera, all levels of sag, and what would make it better."""

    camera: PlannedCamera
    site: Site
    levels: dict[str, list[Foreseen]]
    """By name of the level (:data:`sagnode.plan.foresee.LEVELS`)."""
    weakest: Foreseen
    """Of the middle level: what the improvements are told for."""
    improvements: list[Gain]
    """The most helpful first."""

    @property
    def refused(self) -> bool:
        """Whether the node would refuse any conductor at any level."""
        return any(one.validity is Validity.INVALID for level in self.levels.values() for one in level)


@dataclass(frozen=True)
class Row:
    """One line of a table of cameras: every measured conductor in the middle of its possible sags."""

    camera: PlannedCamera
    landmarks: int
    """In view."""
    foreseen: list[Foreseen]

    @property
    def worst(self) -> Foreseen:
        """The conductor that decides."""
        return worst(self.foreseen)


def study(span: Span, camera: PlannedCamera, look: Look) -> Study:
    """Plan one camera at every level of sag."""
    site = planned_site(span, camera)
    levels = {name: foresee(span, camera, states_at(span, level), look) for name, level in LEVELS.items()}
    weakest = worst(levels["middle"])
    improvements = [*gains(site, weakest), *_longer_lens(span, camera, look, weakest)]
    return Study(camera, site, levels, weakest, sorted(improvements, key=lambda gain: -gain.best))


def compare(span: Span, cameras: Iterable[PlannedCamera], look: Look) -> Iterator[Row]:
    """Plan every camera at the middle level of sag."""
    states = states_at(span, LEVELS["middle"])
    for camera in cameras:
        site = planned_site(span, camera)
        yield Row(camera, len(site.landmark_ids), foresee(span, camera, states, look))


def best(rows: Iterable[Row]) -> Row:
    """The camera under which the weakest conductor fares best; refused ones come last."""
    order = {Validity.GOOD: 0, Validity.QUESTIONABLE: 1, Validity.INVALID: 2}

    def trouble(row: Row) -> tuple[int, float]:
        weakest = row.worst
        sag = weakest.estimates.get("sag")
        return order[weakest.validity], np.inf if sag is None else sag.u

    return min(rows, key=trouble)


def aimed(span: Span, camera: PlannedCamera) -> PlannedCamera:
    """The camera turned to where it sees most of the span, level."""
    azimuth, elevation = best_aim(span, np.array(camera.position), camera.intrinsics)
    return replace(camera, azimuth_deg=azimuth, elevation_deg=elevation, roll_deg=0.0)


def _longer_lens(span: Span, camera: PlannedCamera, look: Look, weakest: Foreseen) -> Iterator[Gain]:
    """What twice the focal length would do, the camera turned to see as much as it then can."""
    if not weakest.estimates:
        return
    lens = camera.intrinsics
    double = replace(lens, fx=2 * lens.fx, fy=2 * lens.fy, distortion=(), model="pinhole", reach=0.0)
    (row,) = compare(span, [aimed(span, replace(camera, intrinsics=double))], look)
    one = next(f for f in row.foreseen if f.conductor == weakest.conductor)
    if one.validity is Validity.INVALID or not one.estimates:
        return
    after, before = ([f.estimates[stem].u for stem in ("sag", "clearance")] for f in (one, weakest))
    yield Gain("a lens of twice the focal length", *after, *(1 - a / b for a, b in zip(after, before, strict=True)))
