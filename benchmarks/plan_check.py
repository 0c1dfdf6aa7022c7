"""Does `sagnode plan` foretell what the node will state, and how large its errors are? Writes docs/planning-check.md.

    python benchmarks/plan_check.py [--groups tower,field-tower] [--worlds 12] [--seed 1] [--jobs 2] [--out docs]

The worlds are those of benchmarks/run.py: the truth differs from the survey by one draw of the stated uncertainties.
The plan knows the survey alone.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from groups import groups_by_name
from sagnode.calibrate.files import load_intrinsics
from sagnode.config.span import Span
from sagnode.pipeline import load_site, measure_burst
from sagnode.plan.camera import PlannedCamera
from sagnode.plan.foresee import LEVELS, Foreseen, foresee, states_at
from sagnode.plan.frame import Backdrop, Look
from sagnode.quality import Validity
from sagnode.scene.catenary import WireState
from sagnode.scene.render import render
from sagnode.scene.truth import true_quantities
from views import View
from worlds import settle

ROOT = Path(__file__).resolve().parents[1]
GROUPS = "tower,field-tower,field-ground,side50,side100,lab,lab45"
STEMS = ("sag", "clearance")


@dataclass(frozen=True)
class Compared:
    """One quantity of one conductor in one frame, m; the plan is that for the very sag and swing of the frame."""

    conductor: str
    stem: str
    planned: float | None
    stated: float | None
    error: float | None


def main() -> int:
    options = _options()
    lines = [
        "# Plan and measurement",
        "",
        (
            f"Written by `python benchmarks/plan_check.py --groups {options.groups} --worlds {options.worlds} --seed"
            f" {options.seed}`; do not edit. *plan*: standard uncertainty that `sagnode plan` foretells from the survey"
            " alone, in the middle of the possible sags in calm air, mm; before a plain sky (*sky*) and before country"
            " (in the laboratory: clutter), in brackets the causes for which the plan calls it doubtful. The other"
            " columns are over worlds drawn from the stated uncertainties, with sags, wind and weather, each with a"
            " plan for its own sag and swing. *stated/plan*: median of what the node states over that plan, and the"
            " range of the middle 80 %. *error/plan*: root mean square of the true errors, each over its plan. *told*:"
            " readings with a number."
        ),
        "",
        "| group | conductor | quantity | plan, sky | plan | stated/plan | error/plan | told |",
        "|---|---|---|---|---|---|---|---|",
    ]
    everything: list[Compared] = []
    with ProcessPoolExecutor(max_workers=options.jobs, mp_context=get_context("spawn")) as pool:
        for group in groups_by_name(options.groups):
            count = min(options.worlds, group.worlds)
            found = [c for world in pool.map(partial(compare, group.name, options.seed), range(count)) for c in world]
            lines += list(_rows(group.name, group.view, found))
            everything += found
            print(f"{group.name}: {count} worlds", file=sys.stderr, flush=True)
    for stem in STEMS:
        lines.append(f"| all | | {stem} | | | {' | '.join(_summary(c for c in everything if c.stem == stem))} |")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "planning-check.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


def compare(name: str, seed: int, index: int) -> list[Compared]:
    """Measure the frames of one drawn world, and plan for each."""
    cv2.setNumThreads(1)
    group = groups_by_name(name)[0]
    results = []
    with tempfile.TemporaryDirectory(prefix="sagnode-plan-") as folder:
        setting = settle(group, seed, index, Path(folder))
        site = load_site(setting.survey)
        for shot in group.shots(setting):
            states = shot.moment.wires
            plan = {f.conductor: f for f in _plan(setting.survey, states, _backdrop(group.view))}
            true = {c.id: true_quantities(shot.scene.true, c, states[c.id]) for c in shot.scene.true.conductors}
            for m in measure_burst(site, [render(shot.scene, shot.moment).image]):
                for stem in STEMS:
                    planned, stated = (of.estimates.get(stem) for of in (plan[m.conductor], m))
                    error = None if stated is None else stated.value - true[m.conductor][stem]
                    u = [None if e is None else e.u for e in (planned, stated)]
                    results.append(Compared(m.conductor, stem, *u, error))
    return results


def _plan(span: Span, states: dict[str, WireState], backdrop: Backdrop) -> list[Foreseen]:
    c = span.camera
    lens = load_intrinsics(c.intrinsics)
    camera = PlannedCamera(lens, c.position, c.azimuth_deg, c.elevation_deg, c.roll_deg)
    return foresee(span, camera, states, Look(backdrop))


def _backdrop(view: View) -> Backdrop:
    return "country" if view.outdoors else "textured"


def _rows(name: str, view: View, found: list[Compared]) -> Iterator[str]:
    with tempfile.TemporaryDirectory(prefix="sagnode-plan-") as folder:
        span = view.survey(Path(folder))
        states = states_at(span, LEVELS["middle"])
        sky = _plan(span, states, "plain")
        plan = _plan(span, states, _backdrop(view))
    for best, one in zip(sky, plan, strict=True):
        for stem in STEMS:
            both = (_planned(f, stem) for f in (best, one))
            own = (c for c in found if (c.conductor, c.stem) == (one.conductor, stem))
            yield f"| {' | '.join([name, one.conductor, stem, *both, *_summary(own)])} |"


def _planned(one: Foreseen, stem: str) -> str:
    """What is planned for, and why it would not be good."""
    if stem not in one.estimates:
        return "-"
    causes = ", ".join(dict.fromkeys(reason.cause.value for reason in one.reasons))
    doubts = "" if one.validity is Validity.GOOD else f" ({causes})"
    return f"{1000 * one.estimates[stem].u:.2f}{doubts}"


def _summary(found: Iterable[Compared]) -> tuple[str, str, str]:
    own = list(found)
    told = [(c.planned, c.stated, c.error) for c in own if c.planned and c.stated and c.error is not None]
    count = f"{sum(c.stated is not None for c in own)} of {len(own)}"
    if not told:
        return "-", "-", count
    planned, stated, error = np.array(told).T
    low, middle, high = np.percentile(stated / planned, [10, 50, 90])
    return f"{middle:.2f} ({low:.2f} to {high:.2f})", f"{np.sqrt(np.mean((error / planned) ** 2)):.2f}", count


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="the plan against what the node states and against the truth")
    parser.add_argument("--groups", default=GROUPS, help=f"of benchmarks/groups.py, by comma (default: {GROUPS})")
    parser.add_argument("--worlds", type=int, default=12, help="at most so many of every group")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the report")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
