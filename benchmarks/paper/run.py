"""Rebuilds the paper's figure 4 and tables 3 to 9 on rendered scenes; writes them into ``docs/paper.md``.

    python benchmarks/paper/run.py [--trials 12] [--field 6] [--large 1] [--out docs]

Everything but the times is the same for the same options.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the benchmarks beside this package

from paper.figure import draw
from paper.measuring import EVERYWHERE, Result, measure
from paper.modes import Prepared, compare_modes, free_sweep
from paper.report import VIEW_NAMES, Measured, write
from paper.scenes import FIELD_WIDTH_PX, LAB_VIEWS, field_trials, lab_trials
from paper.timing import timing
from presets import LAB_CAMERA, preset
from sagnode.geometry.camera import Intrinsics

ROOT = Path(__file__).resolve().parents[2]
TEMPLATES = 300
REPEATS = 30
"""Table 5's."""
FREE_TEMPLATES = 30
DEPTH_M = 2.5
BARREL = Intrinsics(
    960, 540, LAB_CAMERA.fx, LAB_CAMERA.fy, LAB_CAMERA.cx, LAB_CAMERA.cy, (-0.25, 0.08, 0.0002, 0.0001, 0.0)
)
"""Section 3.3: "one with significant barrel distortion"; its coefficients are not printed."""


def main() -> int:
    options = _options()
    cv2.setNumThreads(1)
    started = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - started:6.0f} s  {text}", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory(prefix="sagnode-paper-") as name:
        folder = Path(name)
        lab: dict[tuple[str, str], list[Result]] = {}
        for view in LAB_VIEWS:
            for survey, scale in (("exact", 0.0), ("surveyed", 1.0)):
                say(f"tables 3 and 4: {view}, {survey}")
                lab[view, survey] = measure(lab_trials(view, options.trials, folder, errors=scale))
        say("table 5")
        repeats = {
            "noise": measure(lab_trials("lab", REPEATS, folder, same=True, seed=5), methods=("Bézier",)),
            "worlds": lab["lab", "surveyed"],
        }
        say("figure 4")
        few = max(3, options.trials // 3)
        prepared = {v: [Prepared.of(t, TEMPLATES) for t in lab_trials(v, few, folder, seed=4)] for v in LAB_VIEWS}
        modes = {view: compare_modes(some) for view, some in prepared.items()}
        free = free_sweep(prepared["lab"], FREE_TEMPLATES)
        say("tables 6 and 7")
        times = timing(prepared["lab"][0].trial, options.timed)
        say("table 8")
        lenses = {"the printed lens": None, "a barrel lens": BARREL}
        distortion = {
            (f"{words}, {VIEW_NAMES[view]}", undone): measure(
                lab_trials(view, few, folder, lens=lens, seed=8), undistort=undone, methods=("Bézier",)
            )
            for words, lens in lenses.items()
            for view in LAB_VIEWS
            for undone in (False, True)
        }
        field = _field(options, folder, say)
        measured = Measured(
            command=f"python benchmarks/paper/run.py --trials {options.trials} --field {options.field}"
            f" --large {options.large}",
            lab=lab,
            repeats=repeats,
            modes=modes,
            free=free,
            timing=times,
            distortion=distortion,
            field=field,
            pixel_cm=100 * DEPTH_M / LAB_CAMERA.fy,
        )
        write(measured, options.out / "paper.md")
        draw(measured, prepared["lab"][0], options.out / "paper.png")
    say(f"wrote {options.out / 'paper.md'} and paper.png")
    return 0


def _field(options: argparse.Namespace, folder: Path, say) -> dict[str, list[Result]]:
    large = preset("field")[1]
    small = f"{FIELD_WIDTH_PX} px"
    say("table 9, small sensor")
    exact = list(field_trials(options.field, folder, width=FIELD_WIDTH_PX))
    surveyed = list(field_trials(options.field, folder, errors=1.0, width=FIELD_WIDTH_PX, seed=2))
    results = {
        f"camera known exactly, {small}": measure(exact, EVERYWHERE),
        f"camera as surveyed, {small}": measure(surveyed, EVERYWHERE),
        f"camera by its landmarks, {small}": measure(surveyed, help_them=True),
    }
    if options.large:
        say("table 9, 12 megapixels")
        trials = list(field_trials(options.large, folder, errors=1.0, seed=3))
        results[f"camera by its landmarks, {large.width} px"] = measure(trials, help_them=True)
    return results


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="the paper's figure 4 and tables 3 to 9 on rendered scenes")
    parser.add_argument("--trials", type=int, default=12, help="pictures of each laboratory view")
    parser.add_argument("--field", type=int, default=6, help="pictures of the field on a small sensor")
    parser.add_argument("--large", type=int, default=1, help="pictures of the field at 12 megapixels; 20 s each")
    parser.add_argument("--timed", type=int, default=40, help="templates of the timed search; multiplied up to 300")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of paper.md")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
