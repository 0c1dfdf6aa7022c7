"""Accuracy, coverage and speed against the rendered truth; writes ``docs/accuracy.md`` and its plot.

    python benchmarks/run.py [--worlds 60] [--seed 1] [--frames 1] [--jobs 2] [--out docs]

Everything but the timings is the same for the same options.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from demo_day import PAPER_EVERY, frames_of_the_day, measure_day, measure_day_by_paper, time_of_a_frame
from many_worlds import negative_tasks, positive_tasks, run
from paper import Timing
from report import demo_section, negatives_section, plot, worlds_section
from tally import Outcome
from worlds import GROUPS

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = ("group", "frame", "conductor", "method", "validity", "quantity", "value", "u", "lo", "hi", "truth", "reason")


def main() -> int:
    options = _options()
    started = time.monotonic()
    frames = [] if options.no_day else frames_of_the_day()
    _say(started, f"demonstration's day: {len(frames)} frames")
    own = list(measure_day(frames, options.jobs))
    paper: list[Outcome] = []
    timing: list[Timing] = []
    if frames and not options.no_paper:
        some = frames[PAPER_EVERY // 2 :: PAPER_EVERY]
        _say(started, f"the paper's methods on {len(some)} of them")
        paper = list(measure_day_by_paper(some, options.jobs))
        timing = time_of_a_frame(frames[len(frames) // 2])
    positive = _run_all(
        positive_tasks(options.worlds, options.seed, options.frames, options.views), options.jobs, started, "worlds"
    )
    negative = _run_all(negative_tasks(options.worlds, options.seed, options.views), options.jobs, started, "negatives")
    sections = [
        "# Accuracy",
        "",
        (
            f"Written by `python benchmarks/run.py --worlds {options.worlds} --seed {options.seed} --frames"
            f" {options.frames}`; do not edit. RMSE, bias and coverage are over all readings that tell a number, good"
            " and questionable; bias is estimate minus truth; z is the error over the stated standard uncertainty."
            " Truth comes from the scene generator's exact catenaries, not from the curve that is fitted."
        ),
        "",
        "![Errors](accuracy.png)",
        "",
        demo_section(own, paper, timing),
        worlds_section(positive),
        negatives_section(negative),
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "accuracy.md").write_text("\n".join(sections), encoding="utf-8")
    plot(own, paper, positive, options.out / "accuracy.png")
    if options.csv:
        _write_csv(options.csv, [*own, *paper, *positive, *negative])
    _say(started, f"wrote {options.out / 'accuracy.md'} and accuracy.png")
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="accuracy, coverage and speed against the rendered truth")
    parser.add_argument("--worlds", type=int, default=60, help="worlds of the tower view; other views get a share")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=1, help="frames for each world")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    names = [group.name for group in GROUPS]
    parser.add_argument("--views", nargs="+", choices=names, default=names, help="kinds of view to draw worlds of")
    parser.add_argument("--no-day", action="store_true", help="leave the demonstration's day out")
    parser.add_argument("--no-paper", action="store_true", help="leave the paper's methods and the timings out")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the report")
    parser.add_argument("--csv", type=Path, help="also write every single error here")
    return parser.parse_args()


def _run_all(tasks: Sequence, jobs: int, started: float, what: str) -> list[Outcome]:
    results: list[Outcome] = []
    step = max(1, len(tasks) // 5)
    for done, outcomes in enumerate(run(list(tasks), jobs), start=1):
        results += outcomes
        if done % step == 0 or done == len(tasks):
            _say(started, f"{what}: {done} of {len(tasks)}")
    return results


def _say(started: float, text: str) -> None:
    print(f"{time.monotonic() - started:6.0f} s  {text}", file=sys.stderr, flush=True)


def _write_csv(file: Path, outcomes: Sequence[Outcome]) -> None:
    with file.open("w", newline="", encoding="utf-8") as sink:
        writer = csv.writer(sink)
        writer.writerow(COLUMNS)
        for o in outcomes:
            head = [o.group, o.frame, o.conductor, o.method, o.validity.value]
            for stem, e in o.estimates.items():
                writer.writerow([*head, stem, e.value, e.u, e.lo, e.hi, o.truth.get(stem, ""), o.reason])
            if not o.estimates:
                writer.writerow([*head, "", "", "", "", "", "", o.reason])


if __name__ == "__main__":
    sys.exit(main())
