"""Planning one camera thoroughly, and many of them for a table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sagnode.config.span import Landmark, Span
from sagnode.geometry.camera import undistort
from sagnode.plan.aim import Angles, best_aim
from sagnode.plan.camera import PlannedCamera, placed, planned_site
from sagnode.plan.foresee import LEVELS, Foreseen, foresee, states_at, worst
from sagnode.plan.frame import Look
from sagnode.plan.improve import Gain, gains
from sagnode.quality import Cause, Validity
from sagnode.scene.spec import SpanFrame, survey_pose
from sagnode.site import Site

MORE_LANDMARKS = "eight landmarks more, all over the picture, near and far, surveyed to 3 cm"


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
    longer = _longer_lens(span, camera)
    direction = f"azimuth {longer.azimuth_deg:.1f}°, elevation {longer.elevation_deg:.1f}°"
    improvements = [
        *gains(site, weakest),
        *_tried(f"twice the focal length ({direction})", span, longer, look, weakest),
        *_tried(MORE_LANDMARKS, _more_landmarks(span, camera), camera, look, weakest),
    ]
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


def aimed(span: Span, camera: PlannedCamera, wanted: Angles | None = None) -> PlannedCamera:
    """The camera turned to where it sees most of the span, level; ``wanted`` is kept where it is nearly as good."""
    angles = best_aim(span, np.array(camera.position), camera.intrinsics, wanted)
    turned_from = None if angles == wanted else wanted
    return replace(camera, azimuth_deg=angles[0], elevation_deg=angles[1], roll_deg=0.0, turned_from=turned_from)


def _longer_lens(span: Span, camera: PlannedCamera) -> PlannedCamera:
    """Twice the focal length, the camera turned to see as much as it then can."""
    lens = camera.intrinsics
    double = replace(lens, fx=2 * lens.fx, fy=2 * lens.fy, distortion=(), model="pinhole", reach=0.0)
    return aimed(span, replace(camera, intrinsics=double))


def _more_landmarks(span: Span, camera: PlannedCamera) -> Span:
    """Eight landmarks more, near and far by turns, in two rows across the picture."""
    lens = camera.intrinsics
    columns, rows = np.meshgrid(np.array([0.12, 0.37, 0.63, 0.88]) * lens.width, np.array([0.3, 0.85]) * lens.height)
    x, y = undistort(lens, columns.ravel(), rows.ravel())
    depth = SpanFrame.of(span).length * np.array([0.3, 0.8, 0.3, 0.8, 0.8, 0.3, 0.8, 0.3])
    pose = survey_pose(placed(span, camera))
    places = (depth[:, None] * np.stack([x, y, np.ones_like(x)], axis=1)) @ pose.rotation + pose.position
    more = tuple(
        Landmark(id=f"new-{k}", position=(float(p[0]), float(p[1]), float(p[2])), position_u_m=0.03, pixel=(0.0, 0.0))
        for k, p in enumerate(places, start=1)
    )
    return span.model_copy(update={"landmarks": (*span.landmarks, *more)})


def _tried(what: str, span: Span, camera: PlannedCamera, look: Look, weakest: Foreseen) -> Iterator[Gain]:
    """What a change does that has to be planned anew; nothing where there is nothing to compare with.

    A change after which the node would still refuse the conductor as too uncertain helps all the same, and is told with
    that. Where it would refuse it for anything else, the numbers might be of another curve, and no gain is told.
    """
    if not weakest.estimates:
        return
    (row,) = compare(span, [camera], look)
    one = next(f for f in row.foreseen if f.conductor == weakest.conductor)
    causes = ", ".join(dict.fromkeys(str(reason.cause) for reason in one.reasons))
    words = {Validity.GOOD: "", Validity.QUESTIONABLE: f" (doubtful: {causes})"}
    comparable = one.validity is not Validity.INVALID or all(r.cause is Cause.UNCERTAIN for r in one.reasons)
    after, before = (
        [f.estimates[stem].u for stem in ("sag", "clearance")] for f in (one if comparable else weakest, weakest)
    )
    shares = (1 - a / b for a, b in zip(after, before, strict=True))
    yield Gain(what + words.get(one.validity, f" (still refused: {causes})"), *after, *shares)
