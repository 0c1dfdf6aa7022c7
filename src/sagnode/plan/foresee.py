"""What the node would tell of every conductor: its own measurement on the frame that is expected.

The expected frame stands for the picture and the surveyed landmarks, seen where the planned camera would see them,
for the tracked ones. From there on it is the node's code: search, refinement, joint estimate, judgement and the law of
propagation. So whatever makes the node doubt or refuse (too thin, too little in view, two wires in one place) does so
here, and the uncertainty is what a reading of such a frame would state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sagnode.config.span import Span
from sagnode.estimate.camera import NOTHING_KNOWN, LandmarkObservations, solve_camera
from sagnode.estimate.judge import judge
from sagnode.estimate.locate import locate
from sagnode.estimate.matched import Matched, visible_share
from sagnode.estimate.offsets import CORRELATED_PX, CORRELATED_SHARE
from sagnode.estimate.register import Registered
from sagnode.estimate.tell import propagate
from sagnode.geometry.camera import FloatArray, inside, project
from sagnode.geometry.quantities import Shape, quantities
from sagnode.match.landmarks import TRACK_U_PX
from sagnode.message import Estimate
from sagnode.plan.camera import PlannedCamera, placed, planned_site
from sagnode.plan.frame import Look, expected_frame
from sagnode.plan.neighbours import Neighbour, neighbours
from sagnode.quality import Cause, Reason, Validity
from sagnode.scene.catenary import WireState
from sagnode.site import Site, SiteConductor


class Level(NamedTuple):
    """How the wires hang."""

    share: float
    """Place of every sag in its possible range, 0 to 1."""
    wind: float = 0.0
    """Swing, in standard uncertainties of the survey's prior."""


LEVELS = {"small": Level(0.1), "middle": Level(0.5), "large": Level(0.9), "wind": Level(0.5, 1.0)}
"""What a camera is planned for."""
_T = np.linspace(0.0, 1.0, 1001)


@dataclass(frozen=True)
class Foreseen:
    """One conductor at one sag."""

    conductor: str
    sag_m: float
    """For which it was planned."""
    clearance_m: float
    """At that sag."""
    validity: Validity
    reasons: tuple[Reason, ...]
    estimates: dict[str, Estimate]
    """By quantity stem, as :mod:`sagnode.message` names them; of a refused conductor too, where there are any."""
    budget: dict[str, dict[str, float]]
    """Standard uncertainty by quantity stem and source."""
    in_view: float
    """Share of the span in the frame."""
    stands_out: float
    """Share of the span over which a wire stands out in the expected frame."""
    width_px: tuple[float, float, float] | None
    """Of the wire (or the whole bundle) where it enters the frame, in the middle of what is seen, and where it ends."""
    neighbours: tuple[Neighbour, ...]
    """The other conductors that come near in the picture, the nearest first."""
    matched: Matched | None
    """What the node found in the expected frame."""


def states_at(span: Span, level: Level) -> dict[str, WireState]:
    """How every conductor of a span hangs at a level, by id."""
    swing = level.wind * span.swing.prior_u_deg
    return {c.id: WireState(c.sag_min_m + level.share * (c.sag_max_m - c.sag_min_m), swing) for c in span.conductors}


def foresee(span: Span, camera: PlannedCamera, states: Mapping[str, WireState], look: Look) -> list[Foreseen]:
    """What a frame of the planned camera would give, for every measured conductor.

    Args:
        span: the survey; its camera does not count.
        camera: the planned one.
        states: how every conductor hangs, by id, such as :func:`states_at` gives.
        look: what is assumed of the picture.
    """
    site = planned_site(span, camera)
    image = expected_frame(placed(span, camera), site.intrinsics, states, look)
    # what a lens leaves over, no picture shows that was drawn through its model
    found = locate(site, image, expected_landmarks(site), shared=(CORRELATED_PX, CORRELATED_SHARE))
    shapes = {c.id: _shape(c, states[c.id]) for c in site.conductors}
    curves = {name: _pixels(site, shape) for name, shape in shapes.items()}
    return [
        _foreseen(site, conductor, shapes[conductor.id], found.get(conductor.id), curves)
        for conductor in site.conductors
        if conductor.measured
    ]


def expected_landmarks(site: Site) -> Registered:
    """The registration of a frame in which every landmark is where the survey puts it."""
    survey = site.conductors[0].survey
    if not site.landmark_ids:
        return Registered(survey.prior_mean(), NOTHING_KNOWN, None, None, None, None)
    seen = LandmarkObservations(
        site.landmark_positions,
        site.landmark_position_u,
        site.landmark_clicks,
        np.hypot(site.landmark_click_u, TRACK_U_PX),
    )
    solution = solve_camera(survey, seen)
    return Registered(solution.theta, solution.knowledge, seen, None, 0.0, 0.0)


def _shape(conductor: SiteConductor, state: WireState) -> Shape:
    return Shape(conductor.survey.near, conductor.survey.far, state.sag_m, float(np.radians(state.swing_deg)))


def _pixels(site: Site, shape: Shape) -> FloatArray:
    """Pixels (N, 2) of a conductor by equal steps along the span; NaN where not in the frame."""
    pixels, _ = project(site.intrinsics, site.pose, shape.points(_T))
    return np.where(inside(site.intrinsics, pixels)[:, None], pixels, np.nan)


def _foreseen(
    site: Site, conductor: SiteConductor, shape: Shape, found: Matched | None, curves: dict[str, FloatArray]
) -> Foreseen:
    design = quantities(shape, site.ground)
    estimates: dict[str, Estimate] = {}
    budget: dict[str, dict[str, float]] = {}
    if found is not None:
        estimates, budget = propagate(site, conductor, found)
    validity, reasons = judge(site, conductor, found, estimates, budget=budget)
    if found is not None:
        sag = estimates["sag"]
        if validity is not Validity.INVALID and abs(sag.value - design["sag"]) > 5 * sag.u:
            text = f"in the expected frame another curve (sag {sag.value:.{sag.decimals}f} m) passes for this conductor"
            validity, reasons = Validity.INVALID, [*reasons, Reason(Cause.AMBIGUOUS, text)]
    curve = curves[conductor.id]
    others = {name: other for name, other in curves.items() if name != conductor.id}
    return Foreseen(
        conductor=conductor.id,
        sag_m=design["sag"],
        clearance_m=design["clearance"],
        validity=validity,
        reasons=tuple(reasons),
        estimates=estimates,
        budget=budget,
        in_view=float(np.isfinite(curve[:, 0]).mean()),
        stands_out=0.0 if found is None else visible_share(found),
        width_px=_widths(site, conductor, shape, curve),
        neighbours=tuple(neighbours(curve, others)),
        matched=found,
    )


def _widths(site: Site, conductor: SiteConductor, shape: Shape, curve: FloatArray) -> tuple[float, float, float] | None:
    """Projected width (px) of the conductor at the first, the middle and the last visible place along the span."""
    visible = np.flatnonzero(np.isfinite(curve[:, 0]))
    if not len(visible):
        return None
    places = _T[visible[[0, len(visible) // 2, -1]]]
    _, depth = project(site.intrinsics, site.pose, shape.points(places))
    near, middle, far = conductor.width * site.intrinsics.fx / depth
    return float(near), float(middle), float(far)


def worst(foreseen: Sequence[Foreseen]) -> Foreseen:
    """The conductor that a reader must look at: one that would be refused, else the least certain sag."""

    def trouble(one: Foreseen) -> tuple[int, float]:
        order = {Validity.GOOD: 0, Validity.QUESTIONABLE: 1, Validity.INVALID: 2}
        sag = one.estimates.get("sag")
        return order[one.validity], np.inf if sag is None else sag.u

    return max(foreseen, key=trouble)
