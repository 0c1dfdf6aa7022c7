"""One drawn world again, for looking at: the measured and the true curves, and every number beside its truth.

python benchmarks/case.py tower 39 [--seed 1] [--frames 1] [--out case]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

from sagnode.geometry.camera import FloatArray
from sagnode.pipeline import load_site, measure_burst
from sagnode.scene.render import render
from sagnode.scene.truth import pixel_curve, true_quantities
from tally import UNITS
from worlds import GROUPS, any_moment, settle

FOUND, TRUE = (60, 200, 60), (60, 60, 230)


def main() -> None:
    parser = argparse.ArgumentParser(description="render and measure one of the benchmark's worlds again")
    parser.add_argument("view", choices=[group.name for group in GROUPS])
    parser.add_argument("index", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("case"))
    options = parser.parse_args()
    group = next(group for group in GROUPS if group.name == options.view)
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="sagnode-case-") as folder:
        setting = settle(group, options.seed, options.index, Path(folder))
        site = load_site(setting.survey)
    true = setting.scene.true
    for number in range(options.frames):
        moment = any_moment(group, setting)
        image = render(setting.scene, moment).image
        canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        print(f"{options.view}-{options.index}.{number}")
        for measured in measure_burst(site, [image]):
            conductor = next(c for c in true.conductors if c.id == measured.conductor)
            print(f"  {measured.conductor}: {measured.validity.value}; " + "; ".join(r.text for r in measured.reasons))
            truth = true_quantities(true, conductor, moment.wires[conductor.id])
            for stem, estimate in measured.estimates.items():
                if stem in truth:
                    text = f"{estimate.value:10.3f} ± {estimate.u:.3f}   true {truth[stem]:10.3f} {UNITS[stem]}"
                    print(f"    {stem:20}{text}")
            if measured.drawing is not None:
                _draw(canvas, measured.drawing.curve, FOUND)
            _draw(canvas, pixel_curve(setting.scene, moment, conductor), TRUE)
        stem = options.out / f"{options.view}-{options.index}.{number}"
        cv2.imwrite(f"{stem}.png", image)
        cv2.imwrite(f"{stem}-curves.png", canvas)
    print(f"pictures in {options.out}: found green, true red")


def _draw(canvas: np.ndarray, curve: FloatArray, colour: tuple[int, int, int]) -> None:
    seen = curve[np.isfinite(curve).all(axis=1)]
    points = np.round(seen * 16).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [points], False, colour, 1, cv2.LINE_AA, 4)


if __name__ == "__main__":
    main()
