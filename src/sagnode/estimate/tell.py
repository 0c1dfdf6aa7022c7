"""Telling: from a solved shape to the reported quantities, their uncertainty and its budget.

The law of propagation (JCGM 100): with g the derivatives of a quantity by θ, ``u² = gᵀΣg`` plus what the ground adds.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sagnode.estimate.judge import NOT_EXCLUDED, judge
from sagnode.estimate.load_kinds import LOAD_U
from sagnode.estimate.lone import counts, lone_block
from sagnode.estimate.matched import Matched, on_curve, tip_of, visible_share
from sagnode.estimate.register import Registered
from sagnode.geometry.camera import FloatArray, project
from sagnode.geometry.quantities import Shape, clearance_place_u, conductor_temperature, quantities, quantities_of_many
from sagnode.measurement import Drawing, FrameMeasurement
from sagnode.message import Estimate
from sagnode.quality import Reason, Validity
from sagnode.site import Site, SiteConductor
from sagnode.survey import LOAD, SAG, SIZE, SWING, Survey

K95 = 1.96
"""Coverage factor of a 95 % interval of a normal quantity; linear propagation was found sufficient by Monte Carlo."""
TEMPERATURE_SWING = np.radians(5.0)
"""Beyond this swing the wind's pull is in the sag, and no temperature is derived from it."""
MOST_ASIDE = np.radians(45.0)
"""Angle between a conductor's plane and what its picture shows of it, up to which sag is known to follow swing by one
line of sight. From below the line, sag and swing look alike at one end of the span and unlike at the other."""
_PLACE_STEMS = ("clearance_along", "lowest_along")
_GROUND_STEMS = ("clearance", "midspan_clearance")
_BY_WEIGHT = ("catenary_constant", "tension")
"""What a sag says of a wire that bears its own weight and nothing else."""
_STEPS = {**dict.fromkeys(range(10, 17), 0.001), **dict.fromkeys(range(SWING, SIZE), 1e-4)}
Columns = dict[str, FloatArray]


def refused(site: Site, reasons: list[Reason], registered: Registered | None = None) -> list[FrameMeasurement]:
    """An invalid measurement of every measured conductor, all for the same reasons."""
    landmarks = 0
    residual = None
    if registered is not None:
        residual = registered.residual_px
        landmarks = registered.tracked.count if registered.tracked is not None else 0
    return [
        FrameMeasurement(
            conductor=conductor.id,
            phase=conductor.phase,
            validity=Validity.INVALID,
            reasons=tuple(reasons),
            method=site.method,
            pose_residual_px=residual,
            landmarks_used=landmarks,
            landmarks_by_appearance=0 if registered is None else len(registered.by_appearance),
            oldest_appearance_at=None if registered is None else min(registered.by_appearance, default=None),
        )
        for conductor in site.conductors
        if conductor.measured
    ]


def tell(
    site: Site,
    conductor: SiteConductor,
    registered: Registered,
    found: Matched | None,
) -> FrameMeasurement:
    """The measurement of one conductor in one frame; without numbers where the judgement is invalid."""
    estimates: dict[str, Estimate] = {}
    budget: dict[str, dict[str, float]] = {}
    if found is not None:
        estimates, budget = propagate(site, conductor, found)
    # judge: may it be told?
    tracked = registered.tracked
    landmarks = None if tracked is None else tracked.count / max(int(tracked.visible.sum()), 1)
    validity, reasons = judge(site, conductor, found, estimates, landmarks, budget)
    told = validity is not Validity.INVALID
    return FrameMeasurement(
        conductor=conductor.id,
        phase=conductor.phase,
        validity=validity,
        reasons=tuple(reasons),
        method=site.method,
        estimates=estimates if told else {},
        budget=budget if told else {},
        visible_share=None if found is None else visible_share(found),
        match_score=None if found is None else found.sighting.score,
        pose_residual_px=registered.residual_px,
        landmarks_used=0 if registered.landmarks is None else registered.landmarks.count,
        landmarks_by_appearance=len(registered.by_appearance),
        oldest_appearance_at=min(registered.by_appearance, default=None),
        drawing=None if found is None else draw(site, registered, found),
    )


def _values(site: Site, conductor: SiteConductor, survey: Survey, theta: FloatArray, *, calm: bool) -> Columns:
    """Every quantity at each of θ (S, 28), arrays (S,) by stem."""
    near, far = survey.near + theta[:, 10:13], survey.far + theta[:, 13:16]
    load = theta[:, LOAD] if survey.load_u > 0 else np.empty((len(theta), 0))
    shapes = Shape(near, far, theta[:, SAG], theta[:, SWING], load)
    values = quantities_of_many(shapes, site.ground, conductor.unit_weight_n_m)
    if conductor.stringing is not None and conductor.unit_weight_n_m is not None and calm:
        chord = far - near
        values["conductor_temp"] = conductor_temperature(
            np.hypot(chord[:, 0], chord[:, 1]),
            chord[:, 2],
            values["catenary_constant"] / np.cos(theta[:, SWING]),
            conductor.unit_weight_n_m,
            conductor.stringing,
        )
    return values


def propagate(
    site: Site, conductor: SiteConductor, found: Matched
) -> tuple[dict[str, Estimate], dict[str, dict[str, float]]]:
    """Estimates by quantity stem, and the standard uncertainty of each by source."""
    told = _over_loads(site, conductor, found) if found.solution.loads else _of_one(site, conductor, found)
    other = {} if found.other is None else propagate(site, conductor, found.other)[0]
    left: dict[str, Estimate] = {}
    alone = 0.0
    if found.without_lone is not None:
        left = propagate(site, conductor, replace(found, solution=found.without_lone, other=None, without_lone=None))[0]
        own_u = max(math.sqrt(sum(told["sag"].parts.values())), 1e-9)
        alone = counts(math.hypot(left["sag"].u, left["sag"].value - told["sag"].value) / own_u)
    estimates, budget = {}, {}
    for stem, (value, parts) in told.items():
        if alone:
            beyond = left[stem].u ** 2 - sum(parts.values())
            parts["blocks that may be texture"] = alone * ((left[stem].value - value) ** 2 + max(beyond, 0.0))
        if stem in other:
            # the 95 % interval reaches as far as the value under the other load, and is no narrower than that one's
            beyond = other[stem].u ** 2 - sum(parts.values())
            reach = ((other[stem].value - value) / K95) ** 2 + max(beyond, 0.0)
            parts["even or uneven load"] = found.other_weight * reach
        u = float(np.sqrt(sum(parts.values())))
        estimates[stem] = Estimate(value, u, value - K95 * u, value + K95 * u)
        budget[stem] = {name: math.sqrt(max(part, 0.0)) for name, part in parts.items()}
    return estimates, budget


class _Told(NamedTuple):
    """A quantity and its variance by source."""

    value: float
    parts: dict[str, float]


def _over_loads(site: Site, conductor: SiteConductor, found: Matched) -> dict[str, _Told]:
    """Every quantity over all kinds of load by their weights: the mean, and the variance within and between them.

    A quantity of the mean shape is none of the mean: where the clearance is least hangs on where the ice is.
    """
    weight = np.array([share for share, _, _ in found.solution.loads])
    weight /= weight.sum()
    each = [
        _of_one(site, conductor, replace(found, survey=survey, solution=solution))
        for _, survey, solution in found.solution.loads
    ]
    told = {}
    for stem, likeliest in each[0].items():
        values = np.array([one[stem].value for one in each])
        variances = np.array([sum(one[stem].parts.values()) for one in each])
        mean = float(weight @ values)
        whole, own = float(weight @ (variances + (values - mean) ** 2)), sum(likeliest.parts.values())
        # all loads together may leave a quantity surer than the likeliest alone
        shrunk = min(whole / own, 1.0) if own > 0 else 1.0
        parts = {name: part * shrunk for name, part in likeliest.parts.items()}
        told[stem] = _Told(mean, {**parts, "which load": max(whole - own, 0.0)})
    return told


def _of_one(site: Site, conductor: SiteConductor, found: Matched) -> dict[str, _Told]:
    """Every quantity of one shape, with what is uncertain about that."""
    theta, survey = found.solution.theta, found.survey
    calm = abs(float(theta[SWING])) < TEMPERATURE_SWING and not survey.load_u and found.other is None
    around, steps = _around(found)
    all_values = _values(site, conductor, survey, around, calm=calm)
    if found.other is not None:
        # the same sag under a weight is half as much tension again: an interval that held both would say nothing
        all_values = {stem: values for stem, values in all_values.items() if stem not in _BY_WEIGHT}
    table = np.array(list(all_values.values()))
    g = np.zeros((len(table), SIZE))
    g[:, list(steps)] = (table[:, 1:-2:2] - table[:, 2:-2:2]) / (2 * np.array(list(steps.values())))
    pieces = found.solution.information(survey)
    if not survey.load_u:
        pieces["one block alone"] = lone_block(found.solution, tip_of(found))
    linear = np.sum((g @ np.stack(list(pieces.values()))) * g, axis=-1)
    # half the second difference over one standard uncertainty of swing to both sides (JCGM 100, 5.1.2, note)
    second = 0.5 * (table[:, -2] + table[:, -1] - 2 * table[:, 0]) ** 2
    loads = found.unexcluded
    loaded = {}
    if loads is not None:
        loaded = _values(site, conductor, replace(survey, load_u=LOAD_U), loads.theta, calm=False)
    told = {}
    for row, stem in enumerate(all_values):
        value = float(table[row, 0])
        parts = dict(zip(pieces, linear[:, row].tolist(), strict=True))
        parts["swing, second order"] = float(second[row])
        if stem in _GROUND_STEMS:
            parts["ground"] = site.ground.height_u**2
        if stem in _PLACE_STEMS:
            # a kink of the ground holds the place, but not the survey's idea of where along the span it is
            parts["survey along the span"] = survey.attachment_u**2
        if stem == "clearance_along":
            parts["ground"] = clearance_place_u(survey.shape(theta), site.ground) ** 2
        if loads is not None:
            # what an uneven load leaves undefined, as a tension, is off by what the even one's sag and swing are
            there = loaded.get(stem, value + (loads.theta - theta) @ g[row])
            # as far as the interval does not reach to the other load anyway
            parts[NOT_EXCLUDED] = (1 - found.other_weight) * loads.variance(value, there)
        told[stem] = _Told(value, parts)
    return told


def _around(found: Matched) -> tuple[FloatArray, dict[int, float]]:
    """θ (S, 28): the solution, a step to both sides of each of its shape's unknowns, and one deviation of swing aside.

    A view from the side hardly sees swing. What it sees is the part of the sag across its line of sight: along what it
    leaves open, the sag in the swung plane grows as 1/cos(swing + elevation), which no straight line follows. How sag
    and swing vary together says which elevation that is. The last two rows follow that curve.
    """
    theta, (swing, swing_u) = found.solution.theta, found.swing
    unknowns = len(found.survey.unknowns())
    steps = {k: step for k, step in _STEPS.items() if k < unknowns}
    around = np.tile(theta, (2 * len(steps) + 3, 1))
    for row, (k, step) in enumerate(steps.items()):
        around[2 * row + 1, k] += step
        around[2 * row + 2, k] -= step
    turned = np.clip(swing + swing_u * np.array([-1.0, 1.0]), -1.4, 1.4)
    covariance = found.solution.covariance
    aside = np.arctan2(covariance[SAG, SWING], covariance[SWING, SWING] * theta[SAG])
    aside = np.clip(aside, -MOST_ASIDE, MOST_ASIDE)
    around[-2:, SWING] = turned
    around[-2:, SAG] = theta[SAG] * np.cos(aside) / np.cos(np.clip(aside + turned - swing, -1.4, 1.4))
    return around, steps


def draw(site: Site, registered: Registered, found: Matched) -> Drawing:
    """Everything an overlay needs, in pixels of this frame."""
    theta, survey = found.solution.theta, found.survey
    intrinsics, pose = survey.camera(theta)
    shape = survey.shape(theta)

    def pixels(points: FloatArray) -> FloatArray:
        return project(intrinsics, pose, points)[0]

    space = shape.points(np.linspace(0.0, 1.0, 1201))
    values = quantities(shape, site.ground)
    heading = (shape.far - shape.near)[:2]
    heading = heading / np.hypot(*heading)
    along = (space[:, :2] - shape.near[:2]) @ heading
    place = space[int(np.argmin(np.abs(along - values["clearance_along"])))]
    foot = np.array([place[0], place[1], place[2] - values["clearance"]])
    lowest = space[int(np.argmin(space[:, 2]))]
    chord = shape.near + np.linspace(0.0, 1.0, 101)[:, None] * (shape.far - shape.near)
    observed = found.observed
    seen = on_curve(found.solution, observed)
    landmarks = registered.landmarks
    return Drawing(
        curve=pixels(space),
        seen=(observed.pixel + observed.offset[:, None] * observed.normal)[seen],
        lowest=pixels(lowest),
        clearance=pixels(np.stack([place, foot])),
        chord=pixels(chord),
        landmarks=np.empty((0, 2)) if landmarks is None else landmarks.pixels,
        predicted=np.empty((0, 2)) if landmarks is None else pixels(landmarks.positions),
        rational=found.view.rational_bezier(float(theta[SAG]), float(theta[SWING])),
    )
