"""Does `sagnode plan` foretell what the node will state, and what its errors will be? Writes docs/planning-check.md.

    python benchmarks/plan_check.py [--worlds 12] [--seed 1] [--views tower side lab lab45] [--jobs 2] [--out docs]

Every world of a view is drawn as in benchmarks/run.py: the truth differs from the survey by one draw of the stated
uncertainties. The plan knows the survey alone.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from sagnode.calibrate.files import load_intrinsics
from sagnode.config.span import Span
from sagnode.pipeline import load_site, measure_burst
from sagnode.plan.camera import PlannedCamera
from sagnode.plan.foresee import SHARES, Foreseen, foresee
from sagnode.plan.frame import Backdrop, Look
from sagnode.quality import Validity
from sagnode.scene.render import render
from sagnode.scene.truth import true_quantities
from worlds import GROUPS, Group, any_moment, settle

ROOT = Path(__file__).resolve().parents[1]
STEMS = ("sag", "clearance")


@dataclass(frozen=True)
class Reading:
    """One conductor in one world: what the node stated, and how far it was off (m)."""

    conductor: str
    valid: bool
    u: dict[str, float]
    error: dict[str, float]


def main() -> int:
    options = _options()
    lines = [
        "# Plan and measurement",
        "",
        (
            f"Written by `python benchmarks/plan_check.py --worlds {options.worlds} --seed {options.seed} --views"
            f" {' '.join(options.views)}`; do not edit. *plan*: standard uncertainty that `sagnode plan` foretells from"
            " the survey, in the middle of the possible sags, in mm, before a plain sky and before country (the"
            " laboratory: clutter). *stated*: median of what the node states over the drawn worlds, sags and weather."
            " *stated/plan* refers to the second. *error/plan*: root mean square of the true errors over it."
        ),
        "",
        "| view | conductor | quantity | plan, sky | plan | stated | stated/plan | error/plan | told |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    with ProcessPoolExecutor(max_workers=options.jobs, mp_context=get_context("spawn")) as pool:
        for group in (g for g in GROUPS if g.name in options.views):
            readings = [
                r for some in pool.map(partial(measure, group, options.seed), range(options.worlds)) for r in some
            ]
            lines += list(_rows(group, readings))
            print(f"{group.name} done", file=sys.stderr, flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "planning-check.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


def measure(group: Group, seed: int, index: int) -> list[Reading]:
    """Measure one drawn world."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory(prefix="sagnode-plan-") as folder:
        setting = settle(group, seed, index, Path(folder))
        site = load_site(setting.survey)
        moment = any_moment(group, setting)
        true = setting.scene.true
        truth = {c.id: true_quantities(true, c, moment.wires[c.id]) for c in true.conductors}
        return [
            Reading(
                m.conductor,
                m.validity is not Validity.INVALID,
                {stem: e.u for stem, e in m.estimates.items()},
                {stem: m.estimates[stem].value - truth[m.conductor][stem] for stem in STEMS if m.estimates},
            )
            for m in measure_burst(site, [render(setting.scene, moment).image])
        ]


def planned(group: Group, backdrop: Backdrop) -> list[Foreseen]:
    """What the plan says of a view, from its survey alone."""
    with tempfile.TemporaryDirectory(prefix="sagnode-plan-") as folder:
        span, _ = group.survey(Path(folder))
        return foresee(span, _camera(span), SHARES["middle"], Look(backdrop))


def _camera(span: Span) -> PlannedCamera:
    c = span.camera
    return PlannedCamera(load_intrinsics(c.intrinsics), c.position, c.azimuth_deg, c.elevation_deg, c.roll_deg)


def _rows(group: Group, readings: list[Reading]) -> Iterator[str]:
    sky = {f.conductor: f for f in planned(group, "plain")}
    for one in planned(group, "country" if group.outdoors else "textured"):
        own = [r for r in readings if r.conductor == one.conductor]
        told = [r for r in own if r.valid]
        for stem in STEMS:
            plan, best = (f.estimates.get(stem) for f in (one, sky[one.conductor]))
            stated = float(np.median([r.u[stem] for r in told])) if told else float("nan")
            rms = float(np.sqrt(np.mean([r.error[stem] ** 2 for r in told]))) if told else float("nan")
            u = float("nan") if plan is None else plan.u
            cells = [
                group.name,
                one.conductor,
                stem,
                "-" if best is None else f"{1000 * best.u:.2f}",
                f"{1000 * u:.2f}" + ("" if one.validity is Validity.GOOD else f" ({one.validity})"),
                f"{1000 * stated:.2f}",
                f"{stated / u:.2f}",
                f"{rms / u:.2f}",
                f"{len(told)} of {len(own)}",
            ]
            yield f"| {' | '.join(cells)} |"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="the plan against what the node states and against the truth")
    parser.add_argument("--worlds", type=int, default=12, help="of every view")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    views = [group.name for group in GROUPS]
    default = ["tower", "side", "lab", "lab45"]
    parser.add_argument("--views", nargs="+", choices=views, default=default, help="kinds of view")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the report")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
