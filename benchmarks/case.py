"""One drawn world of any group again, for looking at: the measured and the true curves, every number beside its truth.

python benchmarks/case.py tower 39 [--seed 1] [--frame 0] [--out case]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

from groups import GROUPS, groups_by_name
from run import DEVELOPMENT_SEED
from runner import Task, measure_shot
from sagnode.geometry.camera import FloatArray
from sagnode.pipeline import load_site
from sagnode.scene.render import render
from sagnode.scene.truth import pixel_curve
from tally import OWN, Outcome
from worlds import Shot, settle

FOUND, TRUE, LANDMARK = (60, 200, 60), (60, 60, 230), (230, 160, 40)


def main() -> None:
    parser = argparse.ArgumentParser(description="render and measure one of the benchmark's worlds again")
    parser.add_argument("group", choices=[group.name for group in GROUPS])
    parser.add_argument("index", type=int)
    parser.add_argument("--seed", type=int, default=DEVELOPMENT_SEED)
    parser.add_argument("--frame", type=int, help="only this frame of the world; all by default")
    parser.add_argument("--out", type=Path, default=Path("case"))
    options = parser.parse_args()
    group = groups_by_name(options.group)[0]
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="sagnode-case-") as folder:
        setting = settle(group, options.seed, options.index, Path(folder))
        site = load_site(setting.survey)
    for number, shot in enumerate(group.shots(setting)):
        if options.frame is not None and options.frame != number:
            continue
        task = Task(group.name, options.seed, options.index)
        measured, outcomes = measure_shot(setting, site, shot, task, number)
        name = f"{group.name}-{options.index}.{number}"
        print(name + (f" ({shot.kind})" if shot.kind else ""))
        for o in outcomes:
            if o.method == OWN:
                _print(o)
        image = render(shot.scene, shot.moment).image
        canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        for one in measured:
            if one.drawing is not None:
                _draw(canvas, one.drawing.curve, FOUND)
        _draw_truth(canvas, shot)
        for place in measured[0].drawing.landmarks if measured[0].drawing is not None else ():
            cv2.circle(canvas, tuple(round(float(x)) for x in place), 9, LANDMARK, 1, cv2.LINE_AA)
        cv2.imwrite(str(options.out / f"{name}.png"), image)
        cv2.imwrite(str(options.out / f"{name}-curves.png"), canvas)
    print(f"pictures in {options.out}: found green, true red, landmarks blue")


def _print(o: Outcome) -> None:
    seen = ", ".join(f"{key} {value:g}" for key, value in o.seen.items())
    print(f"  {o.conductor}: {o.validity.value} {' '.join(o.reasons)} {o.why}")
    print(f"    {seen}{', due' if o.due else ''}{', FALSE' if o.false else ''}")
    for stem, estimate in o.estimates.items():
        if stem in o.truth:
            bound = f"limit {o.limit[stem]:.4f}" if stem in o.limit else ""
            print(
                f"    {stem:20}{estimate.value:11.4f} ± {estimate.u:.4f}   true {o.truth[stem]:11.4f}"
                f"   error {o.error(stem):+.4f}   z {o.z(stem):+5.1f}   {bound}"
            )


def _draw_truth(canvas: np.ndarray, shot: Shot) -> None:
    for conductor in shot.scene.true.conductors:
        if conductor.id in shot.moment.wires:
            _draw(canvas, pixel_curve(shot.scene, shot.moment, conductor), TRUE)


def _draw(canvas: np.ndarray, curve: FloatArray, colour: tuple[int, int, int]) -> None:
    seen = curve[np.isfinite(curve).all(axis=1)]
    points = np.round(seen * 16).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [points], False, colour, 1, cv2.LINE_AA, 4)


if __name__ == "__main__":
    main()
