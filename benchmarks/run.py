"""The scene suite: errors, limits, coverage and refusals against the rendered truth.

    python benchmarks/run.py                                   the report; writes docs/accuracy.md with its plots
    python benchmarks/run.py --groups tower,fog --worlds 4     a look while developing; writes into out/bench

The report is every group, so many worlds of each as `REPORT_WORLDS` says, and the paper's methods beside; all else is
a look. The same options and seed draw the same worlds, whatever the number of processes. Another seed draws all
of them anew. While developing, the seed is another one than the report's, whose worlds nobody looks at.
"""

from __future__ import annotations

import argparse
import csv
import os
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from groups import GROUPS
from plots import write_plots
from report import report, summary
from runner import SEEN, run, tasks
from tally import JUDGED, Outcome

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
BENCH = ROOT / "out" / "bench"
REPORT_SEED = 390001
"""The seed of the report: a fresh one whenever its worlds have been looked at."""
REPORT_WORLDS = 17
"""The report draws so many worlds of each group, or as many as a smaller one has."""
DEVELOPMENT_SEED = 1
HEAD = ("group", "world", "frame", "kind", "conductor", "method", "validity", "reasons", "due", "false")
PARTS = ("value", "u", "lo", "hi", "truth", "limit")


def main() -> int:
    options = options_of(sys.argv[1:])
    try:
        todo = tasks(options.groups, options.seed, options.worlds, paper=not options.no_paper)
    except ValueError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 2
    outcomes = _run_all(todo, options.jobs)
    for folder in (options.out, options.csv.parent):
        folder.mkdir(parents=True, exist_ok=True)
    (options.out / "accuracy.md").write_text(report(outcomes, command_of(options)), encoding="utf-8")
    write_plots(outcomes, options.out)
    write_csv(options.csv, outcomes)
    print(summary(outcomes))
    print(f"\n{options.out / 'accuracy.md'} with its plots; every reading in {options.csv}")
    return 0


def options_of(words: Sequence[str]) -> argparse.Namespace:
    """The options of a command line, and what is not said there filled in."""
    options = _parser().parse_args(words)
    if options.groups is None and options.worlds is None:
        options.worlds = REPORT_WORLDS
    if options.seed is None:
        options.seed = REPORT_SEED if _is_report(options) else DEVELOPMENT_SEED
    options.out = options.out or _folder(options)
    options.csv = options.csv or BENCH / "accuracy.csv"
    return options


def command_of(options: argparse.Namespace) -> str:
    """The command that makes the same page again, at the same place."""
    words = ["python benchmarks/run.py", f"--seed {options.seed}"]
    words += [f"--groups {options.groups}"] if options.groups is not None else []
    words += [f"--worlds {options.worlds}"] if options.worlds is not None else []
    words += ["--no-paper"] if options.no_paper else []
    words += [f"--out {shlex.quote(str(options.out))}"] if options.out.resolve() != _folder(options) else []
    return " ".join(words)


def _is_report(options: argparse.Namespace) -> bool:
    """Whether these are the report's worlds but for the seed, and the report's methods."""
    return options.groups is None and options.worlds == REPORT_WORLDS and not options.no_paper


def _folder(options: argparse.Namespace) -> Path:
    return DOCS if _is_report(options) else BENCH


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="errors, limits, coverage and refusals against the rendered truth")
    names = ", ".join(group.name for group in GROUPS)
    parser.add_argument("--groups", metavar="A,B", help=f"only these groups: {names}")
    parser.add_argument(
        "--worlds",
        type=int,
        metavar="N",
        help=f"at most so many worlds of each group (default: {REPORT_WORLDS}, or all of the groups that are named)",
    )
    parser.add_argument(
        "--seed", type=int, help=f"of everything (default: {REPORT_SEED}, or {DEVELOPMENT_SEED} for a look)"
    )
    parser.add_argument(
        "--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes (default: %(default)s)"
    )
    parser.add_argument("--no-paper", action="store_true", help="a look without the paper's methods")
    parser.add_argument("--out", type=Path, help="folder of the report (default: docs, or out/bench for a look)")
    parser.add_argument("--csv", type=Path, help="table of every reading (default: out/bench/accuracy.csv)")
    return parser


def _run_all(todo: Sequence, jobs: int) -> list[Outcome]:
    results: list[Outcome] = []
    started = last = time.monotonic()
    for done, outcomes in enumerate(run(list(todo), jobs), start=1):
        results += outcomes
        now = time.monotonic()
        if now - last > 15 or done == len(todo):
            last = now
            print(
                f"{now - started:6.0f} s  {done} of {len(todo)} worlds ({todo[done - 1].group})",
                file=sys.stderr,
                flush=True,
            )
    return results


def write_csv(file: Path, outcomes: Sequence[Outcome]) -> None:
    """One line a reading, with the judged quantities, their truth and their limit."""
    with file.open("w", newline="", encoding="utf-8") as sink:
        writer = csv.writer(sink)
        writer.writerow([*HEAD, *SEEN, *(f"{stem}_{part}" for stem in JUDGED for part in PARTS), "why"])
        for o in outcomes:
            line = [o.group, o.world, o.frame, o.kind, o.conductor, o.method, o.validity.value, " ".join(o.reasons)]
            line += [int(o.due), int(o.false), *(o.seen.get(key, "") for key in SEEN)]
            for stem in JUDGED:
                numbers = [round(x, 5) for x in o.estimates[stem]] if stem in o.estimates else [""] * 4
                line += [*numbers, *(round(m[stem], 5) if stem in m else "" for m in (o.truth, o.limit))]
            writer.writerow([*line, o.why])


if __name__ == "__main__":
    sys.exit(main())
