"""Whether landmarks survive light, season and weather: with appearances kept and without, over drawn years.

    python benchmarks/appearances.py [--worlds 2] [--seed 1] [--out docs/appearances.md]

Worlds of the suite's views, their errors drawn from the survey's stated uncertainty, are seen on days through a year:
sun and shadow wander over everything, leaves fall, snow comes and half goes, some days are overcast, hazy or dim. Every
frame is registered without and with what has been kept until then; then it may teach. In a part of the frames something
stands or flies before a landmark, and one landmark of each world is moved for good in the middle of the year. The
same options give the same document.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np

from appearances_report import Outcome, document
from groups import groups_by_name
from sagnode.capture.port import GreyImage
from sagnode.estimate.camera import LandmarkObservations, solve_camera
from sagnode.estimate.judge import look
from sagnode.estimate.register import Registered, moved_survey, register
from sagnode.estimate.remember import remember
from sagnode.geometry.camera import FloatArray, project, projection_derivatives
from sagnode.match.appearances import Appearances, none_kept
from sagnode.pipeline import load_site, measure_burst
from sagnode.scene.catenary import WireState, wire_points
from sagnode.scene.day import sun_position
from sagnode.scene.render import render
from sagnode.scene.spec import Moment, Scene
from sagnode.scene.truth import true_quantities
from sagnode.site import Site
from sagnode.survey import CAMERA
from worlds import Setting, any_moment, settle

VIEWS = ("tower", "side100", "field-ground")
DAYS, HOURS = 6, (7.5, 11.0, 14.5)
"""Days through the year, each with the next one, and hours of readings (UTC)."""
DISTURBED = 0.25
"""Share of the frames in which something hides a landmark."""
MEASURED_MAX = 3
"""Frames a world of which the conductors are measured too: those in which appearances count."""


def year(setting: Setting, rng: np.random.Generator) -> Iterator[tuple[datetime, Moment]]:
    """Moments of days through a year, in their order."""
    first = datetime(2026, 3, 10, tzinfo=UTC)
    for k in range(DAYS):
        day = first + timedelta(days=math.floor(k * 365 / DAYS + rng.uniform(0, 12)))
        winter = 0.5 + 0.5 * math.cos((day.timetuple().tm_yday - 15) / 365 * 2 * math.pi)
        snow = float(rng.choice([0.0, 0.5, 1.0])) if winter > 0.75 else 0.0
        for further in range(2):
            cloud, haze = float(rng.uniform(0, 1)), float(np.exp(rng.uniform(math.log(1e-4), math.log(2.5e-3))))
            for hour in HOURS:
                at = day + timedelta(days=further, hours=hour + float(rng.uniform(0, 1.5)))
                azimuth, elevation = sun_position(at, 51.0, 12.0)
                if elevation > -3.0:
                    yield (
                        at,
                        replace(
                            any_moment(setting),
                            time=at,
                            relief=1.0,
                            snow=snow,
                            bare=winter,
                            sun_azimuth_deg=azimuth,
                            sun_elevation_deg=elevation,
                            cloud=float(np.clip(cloud + 0.15 * rng.normal(), 0, 1)),
                            fog_per_m=haze,
                        ),
                    )


def disturbed(image: GreyImage, site: Site, rng: np.random.Generator) -> GreyImage:
    """Something passes before a landmark: a bird, a vehicle, an animal."""
    image = image.copy()
    u, v = site.landmark_clicks[int(rng.integers(len(site.landmark_ids)))] + rng.uniform(-6, 6, 2)
    size = (int(rng.uniform(8, 30)), int(rng.uniform(8, 30)))
    cv2.ellipse(image, (round(u), round(v)), size, float(rng.uniform(0, 180)), 0, 360, int(rng.uniform(0, 255)), -1)
    cv2.line(image, (round(u) - 20, round(v)), (round(u) + 20, round(v) - 9), int(rng.uniform(0, 255)), 4)
    return image


def middle_seen(scene: Scene, moment: Moment) -> tuple[FloatArray, FloatArray]:
    """The middle of the first conductor's visible part (1, 3), and where it truly is in the frame (1, 2)."""
    conductor = next(c for c in scene.true.conductors if c.measured)
    wire = moment.wires.get(conductor.id, WireState(conductor.sag_min_m))
    point = wire_points(np.array(conductor.near), np.array(conductor.far), wire, np.linspace(0.0, 1.0, 41))
    true, _ = project(scene.intrinsics, scene.pose_at(moment), point)
    width, height = scene.intrinsics.width, scene.intrinsics.height
    inside = np.flatnonzero((true > 0).all(axis=1) & (true[:, 0] < width) & (true[:, 1] < height))
    middle = inside[len(inside) // 2 : len(inside) // 2 + 1]
    return point[middle], true[middle]


def pose_error(
    site: Site, scene: Scene, moment: Moment, registered: Registered, now: FloatArray
) -> tuple[float, float, float]:
    """How wrong the camera's place is: px at the middle of the conductor.

    Returns:
        The error; the same over its standard uncertainty along an axis; and how far it is from what all landmarks of
        the reference picture would give, every one found exactly where it is (``now``, px (N, 2), clicks' errors kept).
    """
    survey = moved_survey(site.conductors[0].survey, registered.movement_px or 0.0)
    point, true = middle_seen(scene, moment)
    intrinsics, pose = survey.camera(registered.theta)
    thought = project(intrinsics, pose, point)[0]
    error = (thought - true)[0]
    _, by_camera = projection_derivatives(intrinsics, pose, point)
    prior = np.diag(1 / survey.prior_sigma()[CAMERA] ** 2)
    covariance = by_camera[0] @ np.linalg.inv(registered.camera.precision + prior) @ by_camera[0].T
    seen = registered.tracked.visible if registered.tracked is not None else np.ones(len(now), dtype=bool)
    exact = LandmarkObservations(
        site.landmark_positions[seen], site.landmark_position_u[seen], now[seen], site.landmark_click_u[seen]
    )
    best = project(*survey.camera(solve_camera(survey, exact).theta), point)[0]
    z = float(np.sqrt(error @ np.linalg.solve(covariance, error) / 2))
    return float(np.hypot(*error)), z, float(np.hypot(*(thought - best)[0]))


def without_a_landmark(scene: Scene, rng: np.random.Generator) -> Scene:
    """The world in which one landmark has been moved by some decimetres, for good."""
    marks = list(scene.true.landmarks)
    i = int(rng.integers(len(marks)))
    x, y, z = np.array(marks[i].position) + rng.choice([-1, 1], 3) * rng.uniform(0.15, 0.5, 3)
    marks[i] = marks[i].model_copy(update={"position": (float(x), float(y), float(z))})
    return replace(scene, true=scene.true.model_copy(update={"landmarks": tuple(marks)}))


def world(view: str, seed: int, index: int) -> Outcome:
    """One world through its year."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory(prefix="sagnode-appearances-") as folder:
        setting = settle(groups_by_name(view)[0], seed, index, Path(folder))
        site = load_site(setting.survey)
    rng = np.random.default_rng([seed, index, len(view)])
    kept, outcome, scene = none_kept(len(site.landmark_ids)), Outcome(), setting.scene
    moments = list(year(setting, rng))
    places = {m.id: np.array(m.position) for m in scene.true.landmarks}
    positions = np.array([places[name] for name in site.landmark_ids])
    at_rest = project(scene.intrinsics, scene.pose, positions)[0]
    later = without_a_landmark(scene, rng)
    for number, (at, moment) in enumerate(moments):
        present = scene if number < len(moments) // 2 else later
        image = render(present, moment).image
        if rng.random() < DISTURBED:
            image = disturbed(image, site, rng)
        if look(site, image):
            continue
        now = project(scene.intrinsics, scene.pose_at(moment), positions)[0] + site.landmark_clicks - at_rest
        _registered(outcome, site, scene, moment, image, kept, now)
        kept = remember(site, image, kept, at)
    outcome.appearances = sum(a.proven for own in kept for a in own)
    for image in strange(setting, rng):
        outcome.negatives += 1
        registered, reasons = register(site, image, kept)
        outcome.believed += not reasons
        outcome.believed_by_appearance += not reasons and bool(registered.by_appearance)
    return outcome


def _registered(
    outcome: Outcome, site: Site, scene: Scene, moment: Moment, image: GreyImage, kept: Appearances, now: FloatArray
) -> None:
    tellers: list[tuple[Registered, bool, tuple[float, float, float] | None]] = []
    for appearances in ((), kept):
        registered, reasons = register(site, image, appearances)
        error = None if reasons else pose_error(site, scene, moment, registered, now)
        tellers.append((registered, bool(reasons), error))
    outcome.without.take(*tellers[0])
    outcome.kept.take(*tellers[1])
    tracked = tellers[1][0].tracked
    if tracked is None or not tracked.cut_at:
        return
    outcome.helped.take(*tellers[1])
    outcome.unhelped.take(*tellers[0])
    outcome.places += [float(e) for i in tracked.cut_at for e in tracked.pixels[i] - now[i]]
    if len(outcome.readings) < 3 * MEASURED_MAX:
        _measured(outcome, site, scene, moment, image, kept)


def _measured(outcome: Outcome, site: Site, scene: Scene, moment: Moment, image: GreyImage, kept: Appearances) -> None:
    conductors = {c.id: c for c in scene.true.conductors}
    for before, after in zip(measure_burst(site, [image]), measure_burst(site, [image], kept), strict=True):
        true = true_quantities(scene.true, conductors[after.conductor], moment.wires[after.conductor])
        sag = after.estimates.get("sag")
        z = float("nan") if sag is None else (sag.value - true["sag"]) / sag.u
        outcome.readings.append((bool(before.estimates), bool(after.estimates), z))


def strange(setting: Setting, rng: np.random.Generator) -> Iterator[GreyImage]:
    """Pictures in which the landmarks are not where they could be: turned away, another place, fogged, clutter."""
    for k in range(3):
        moment = replace(any_moment(setting), relief=1.0, snow=float(k == 1), seed=int(rng.integers(2**31)))
        turn = (0.0, math.radians(rng.uniform(15, 40)), 0.0)
        yield render(setting.scene, replace(moment, turn_rad=turn)).image
        yield render(replace(setting.scene, intrinsics=setting.scene.intrinsics), replace(moment, lens="fogged")).image
        shape = (setting.scene.intrinsics.height, setting.scene.intrinsics.width)
        noise = rng.integers(0, 255, shape).astype(np.uint8)
        yield np.asarray(cv2.GaussianBlur(noise, (0, 0), float(rng.uniform(0.8, 2.5))), np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description="landmarks with and without kept appearances, over drawn years")
    parser.add_argument("--worlds", type=int, default=2, help="of each view")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("docs/appearances.md"))
    options = parser.parse_args()
    outcomes: dict[str, list[Outcome]] = {}
    for view in VIEWS:
        outcomes[view] = []
        for index in range(options.worlds):
            outcomes[view].append(world(view, options.seed, index))
            one = outcomes[view][-1]
            print(one.without.row(f"{view} {index}, reference alone"), one.kept.row("with"), sep="\n", flush=True)
    text = document(outcomes, options.seed)
    options.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
