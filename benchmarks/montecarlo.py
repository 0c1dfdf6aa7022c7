r"""The node's linear propagation of uncertainty against Monte Carlo (JCGM 101, clause 8), one scene a view.

    python benchmarks/montecarlo.py [--draws 2000] [--seed 5767] [--views lab,tower] [--out docs]

One frame of each view is rendered and measured, which gives what is observed there: which landmarks, which places along
the wire, how exactly. Then, again and again, everything uncertain is drawn from its stated distribution: camera, lens,
attachments, swing, landmarks and their clicks, ground, white and correlated noise of the offsets across the wire. From
such observations the node's own estimate and propagation are made, without pictures. Its standard uncertainty must be
the standard deviation of its errors, and its interval must hold the truth 95 times of 100.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from groups import groups_by_name
from run import ROOT
from sagnode.estimate.camera import LandmarkObservations, solve_camera
from sagnode.estimate.joint import solve
from sagnode.estimate.locate import locate
from sagnode.estimate.matched import Matched
from sagnode.estimate.offsets import CurveObservations, correlated_error
from sagnode.estimate.register import Registered, register
from sagnode.estimate.tell import K95, propagate
from sagnode.geometry.camera import FloatArray, project
from sagnode.geometry.ground import GroundProfile
from sagnode.geometry.quantities import quantities
from sagnode.message import Estimate
from sagnode.pipeline import load_site
from sagnode.scene.render import render
from sagnode.site import Site, SiteConductor
from sagnode.survey import ATTACHMENTS, CAMERA, SAG, SWING
from worlds import settle

VIEWS = ("lab", "lab45", "tower", "field-tower", "field-ground", "side100")
STEMS = ("sag", "inplane_sag", "swing", "lowest_height", "drop", "clearance", "catenary_constant")
SEED = 5767
AGREE = 0.1
"""Stated and drawn uncertainty agree when they differ by less than a tenth beyond what chance moves the drawn one."""


@dataclass(frozen=True)
class Design:
    """What one frame of a view shows of one conductor, and how exactly."""

    site: Site
    conductor: SiteConductor
    registered: Registered
    found: Matched


@dataclass(frozen=True)
class Trial:
    """One draw: what the node told, and what was true."""

    estimates: dict[str, Estimate]
    truth: dict[str, float]


@dataclass(frozen=True)
class Line:
    """Stated against drawn uncertainty of one quantity in one view."""

    view: str
    stem: str
    draws: int
    stated_u: float
    drawn_u: float
    bias: float
    coverage: float
    interval: tuple[float, float]
    """Ends of the interval that held 95 % of the errors, in stated half-widths: -1 and 1 where all is as stated."""

    @property
    def chance(self) -> float:
        """Standard error of ``drawn_u`` over ``drawn_u``."""
        return 1 / math.sqrt(2 * (self.draws - 1))

    @property
    def agrees(self) -> bool:
        """Whether the stated standard uncertainty is the drawn one."""
        return abs(self.stated_u / self.drawn_u - 1) <= AGREE + 2 * self.chance


def main() -> int:
    parser = argparse.ArgumentParser(description="linear propagation of uncertainty against Monte Carlo")
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--views", default=",".join(VIEWS), help="groups of the suite (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of monte-carlo.md")
    options = parser.parse_args()
    lines: list[Line] = []
    for view in options.views.split(","):
        design = observe_view(view, options.seed)
        if design is None:
            print(f"{view}: nothing is told of its frame, so nothing can be checked", file=sys.stderr)
            continue
        rng = np.random.default_rng([options.seed, len(lines)])
        some = compare(view, [draw(design, rng) for _ in range(options.draws)])
        lines += some
        print("\n".join(_row(line) for line in some), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    words = f"python benchmarks/montecarlo.py --draws {options.draws} --seed {options.seed}"
    (options.out / "monte-carlo.md").write_text(page(lines, words), encoding="utf-8")
    print(f"{options.out / 'monte-carlo.md'}")
    return 0


def observe_view(view: str, seed: int) -> Design | None:
    """Render and measure one frame of a view; None if no measured conductor is found in the first few worlds."""
    cv2.setNumThreads(1)
    group = groups_by_name(view)[0]
    for index in range(5):
        with tempfile.TemporaryDirectory(prefix="sagnode-mc-") as folder:
            setting = settle(group, seed, index, Path(folder))
            site = load_site(setting.survey)
        shot = next(iter(group.shots(setting)))
        image = render(shot.scene, shot.moment).image
        registered, reasons = register(site, image)
        if reasons:
            continue
        located = locate(site, image, registered)
        for conductor in site.conductors:
            found = located.get(conductor.id)
            if found is not None and found.solution.converged and not found.survey.load_u:
                return Design(site, conductor, registered, found)
    return None


def draw(design: Design, rng: np.random.Generator) -> Trial:
    """Draw a truth and the observations that it would give, and let the node estimate it."""
    site, found = design.site, design.found
    survey = found.survey
    sigma, mean = survey.prior_sigma(), survey.prior_mean()
    theta = mean.copy()
    for part in (CAMERA, ATTACHMENTS):
        theta[part] += sigma[part] * rng.standard_normal(theta[part].size)
    theta[SAG] = found.solution.theta[SAG]
    theta[SWING] = sigma[SWING] * rng.standard_normal()
    landmarks = _landmarks(design, theta, rng)
    curve = _offsets(design, theta, rng)
    camera = solve_camera(survey, landmarks)
    start = camera.theta.copy()
    start[SAG], start[SWING] = theta[SAG], found.solution.theta[SWING]
    solution = solve(survey, start, camera.knowledge, curve, iterations=20)
    estimates, _ = propagate(site, design.conductor, replace(found, solution=solution))
    ground = site.ground
    heights = ground.height + ground.height_u * rng.standard_normal(ground.height.shape)
    tops = ground.obstacles + ground.height_u * rng.standard_normal((len(ground.obstacles), 1)) * [0.0, 0.0, 1.0]
    truth = quantities(survey.shape(theta), GroundProfile(ground.along, heights, tops, 0.0))
    return Trial(estimates, truth)


def _landmarks(design: Design, theta: FloatArray, rng: np.random.Generator) -> LandmarkObservations:
    """The landmarks of the frame, where a drawn camera sees them at drawn places."""
    seen = design.registered.landmarks
    if seen is None:
        return LandmarkObservations(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)), np.zeros(0))
    places = seen.positions + seen.position_u[:, None] * rng.standard_normal(seen.positions.shape)
    pixels, _ = project(*design.found.survey.camera(theta), places)
    return replace(seen, pixels=pixels + seen.pixel_u[:, None] * rng.standard_normal(pixels.shape))


def _offsets(design: Design, theta: FloatArray, rng: np.random.Generator) -> CurveObservations:
    """The places along the wire at which it was seen in the frame, on the drawn curve, with drawn noise across it."""
    survey, seen = design.found.survey, design.found.offsets
    camera, shape = survey.camera(theta), survey.shape(theta)

    def pixels(t: FloatArray) -> FloatArray:
        return project(*camera, shape.points(t))[0]

    along = pixels(seen.t + 1e-5) - pixels(seen.t - 1e-5)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    shared = np.linalg.cholesky(correlated_error(seen) + 1e-12 * np.eye(len(seen.arc)))
    noise = seen.sigma * rng.standard_normal(len(seen.t)) + shared @ rng.standard_normal(len(seen.t))
    measured = pixels(seen.t) + noise[:, None] * normal
    kept = np.isfinite(measured).all(axis=1)
    sigma = seen.sigma[kept]
    own = (seen.t[kept], seen.arc[kept], normal[kept], measured[kept], sigma)
    shading = None if seen.shading is None else seen.shading[kept]
    return CurveObservations(*own, shared_px=seen.shared_px, shared_share=seen.shared_share, shading=shading)


def compare(view: str, trials: Sequence[Trial]) -> list[Line]:
    """Stated and drawn uncertainty of every quantity."""
    lines = []
    for stem in STEMS:
        told = [t for t in trials if stem in t.estimates and stem in t.truth]
        if len(told) < 2:
            continue
        error = np.array([t.estimates[stem].value - t.truth[stem] for t in told])
        u = np.array([t.estimates[stem].u for t in told])
        held = [t.estimates[stem].lo <= t.truth[stem] <= t.estimates[stem].hi for t in told]
        low, high = np.quantile(error, [0.025, 0.975])
        stated = float(np.sqrt(np.mean(u**2)))
        lines.append(
            Line(
                view=view,
                stem=stem,
                draws=len(told),
                stated_u=stated,
                drawn_u=float(np.std(error, ddof=1)),
                bias=float(error.mean()),
                coverage=float(np.mean(held)),
                interval=(float(low / (K95 * stated)), float(high / (K95 * stated))),
            )
        )
    return lines


HEADER = (
    "| view | quantity | stated u | drawn u | stated / drawn | bias / u | 95 % holds | 95 % of errors, in half-widths |"
    "\n|---|---|---|---|---|---|---|---|"
)


def _row(line: Line) -> str:
    low, high = line.interval
    return (
        f"| {line.view} | {line.stem} | {line.stated_u:.4g} | {line.drawn_u:.4g}"
        f" | {line.stated_u / line.drawn_u:.2f} ± {2 * line.chance:.2f} | {line.bias / line.stated_u:+.2f}"
        f" | {100 * line.coverage:.1f} % | {low:+.2f} to {high:+.2f} |"
    )


def page(lines: Sequence[Line], command: str) -> str:
    """The Markdown page."""
    apart = [f"{line.view} {line.stem}" for line in lines if not line.agrees]
    limit = f"{100 * AGREE:.0f} % and chance"
    verdict = f"Stated and drawn standard uncertainty agree within {limit} everywhere."
    if apart:
        verdict = f"Stated and drawn standard uncertainty differ by more than {limit} in: {', '.join(apart)}."
    return (
        "\n\n".join(
            [
                "# Linear propagation against Monte Carlo",
                f"Written by `{command}`; do not edit.",
                (__doc__ or "").split("\n\n")[2].replace("\n", " "),
                "Metres and degrees; ± is twice the standard error that the number of draws leaves.",
                "\n".join([HEADER, *(_row(line) for line in lines)]),
                verdict,
            ]
        )
        + "\n"
    )


if __name__ == "__main__":
    sys.exit(main())
