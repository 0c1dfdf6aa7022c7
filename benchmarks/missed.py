"""Why readings that were due were refused: the same frames measured by a node that is told where the wires are.

    python benchmarks/run.py [--seed 7] [--csv out/bench/accuracy.csv]
    python benchmarks/missed.py [--seed 7] [--csv out/bench/accuracy.csv] [--out docs]

Every frame of that table in which a due conductor was refused is measured once more. The search is left out: each
conductor's refinement begins at its true sag, swing, attachments and camera, and has no rivals, which only a search
finds. All else is the node's. What is told then was lost by the search or to a rival; what is refused again is refused
for what the picture shows.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import cv2

from groups import GROUPS, groups_by_name
from limit import true_theta
from run import REPORT_SEED, ROOT
from sagnode.capture.port import GreyImage
from sagnode.estimate import locate
from sagnode.estimate.matched import Matched
from sagnode.estimate.refinement import STAGES, refine
from sagnode.estimate.register import Registered
from sagnode.match.library import Shelf
from sagnode.measurement import FrameMeasurement
from sagnode.pipeline import load_site, measure_frame
from sagnode.scene.render import render
from sagnode.site import SiteConductor
from sagnode.survey import LOAD, Survey
from tally import ABSURD_Z, JUDGED, OWN
from worlds import Shot, settle

Frame = tuple[str, int, int]
"""Group, world, frame."""
ROUNDING_M = 1e-4
"""How far a true sag may differ from the table's, which is rounded, in the same frame."""
WORDS = """\
Every conductor that `docs/accuracy.md` calls due and that was refused there, measured once more with the search left
out: each refinement begins at the true sag, swing, attachments and camera, and has no rivals, which only a search
finds. All else is the node's.

- **told**: what the search lost, or refused for a rival; **of those off**: by more than 5 of its own u all the same.
- **refused as well**: what the picture does not show, or not surely, even to those who know where the wire is; with the
  first causes. `ambiguous`: two conductors may as well hang in each other's places, or other wires hide it all along;
  two equally good answers are none. `uncertain`: the standard uncertainty is beyond what may be told."""


@dataclass(frozen=True)
class Again:
    """A due conductor that was refused, from its true curve."""

    group: str
    told: bool
    off: bool
    cause: str
    """First cause of the refusal; empty where it is told."""


class OtherWorldError(Exception):
    """The table was made with another seed."""


def missed_in(table: Path) -> tuple[Counter[str], dict[Frame, dict[str, float]]]:
    """How many conductors were due, by group; and those of them that were refused with their true sags, by frame."""
    due: Counter[str] = Counter()
    refused: dict[Frame, dict[str, float]] = {}
    with table.open(encoding="utf-8", newline="") as source:
        for row in csv.DictReader(source):
            if row["method"] == OWN and row["due"] == "1":
                due[row["group"]] += 1
                if row["validity"] == "invalid":
                    frame = row["group"], int(row["world"]), int(row["frame"])
                    refused.setdefault(frame, {})[row["conductor"]] = float(row["sag_truth"])
    return due, refused


def again(frame: Frame, sags: Mapping[str, float], seed: int) -> Iterator[Again]:
    """Some conductors of a frame, given with their true sags, from their true curves.

    Raises:
        OtherWorldError: the sags are not those of that seed's frame.
    """
    name, world, number = frame
    group = groups_by_name(name)[0]
    with tempfile.TemporaryDirectory(prefix="sagnode-missed-") as folder:
        setting = settle(group, seed, world, Path(folder))
        site = load_site(setting.survey)
    shot = list(group.shots(setting))[number]
    picture = render(shot.scene, shot.moment)
    with patch.object(locate, "find_even", told_by_truth(shot)):
        measured = {each.conductor: each for each in measure_frame(site, picture.image)}
    for conductor, sag in sags.items():
        one = measured[conductor]
        truth = picture.truth["conductors"][conductor]
        if abs(truth["sag_m"] - sag) > ROUNDING_M:
            raise OtherWorldError(
                f"{name}, world {world}, {conductor}: the table has a true sag of {sag} m, seed {seed} makes it"
                f" {truth['sag_m']:.5f} m; give the seed that the table was made with"
            )
        cause = "" if one.estimates else one.reasons[0].cause.value
        yield Again(name, bool(one.estimates), is_off(one, truth), cause)


def is_off(one: FrameMeasurement, truth: dict[str, float]) -> bool:
    """Whether sag or clearance are absurdly far from the truth."""
    told = [(one.estimates[stem], truth[f"{stem}_m"]) for stem in JUDGED if stem in one.estimates]
    return any(abs(estimate.value - true) > ABSURD_Z * estimate.u for estimate, true in told)


def told_by_truth(shot: Shot) -> Callable[..., Matched | None]:
    """What stands in for the search: refinements that begin at a frame's true curves, under an even load."""

    def find(
        image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered, _: Shelf | None = None
    ) -> Matched | None:
        true = next(c for c in shot.scene.true.conductors if c.id == conductor.id)
        theta = true_theta(survey, shot.scene, shot.moment, true)
        theta[LOAD] = 0.0
        # a load bends the wire away from the even curve: that is found as the node does, from afar
        stages = STAGES if shot.moment.wires[conductor.id].loads else STAGES[-1:]
        return refine(image, conductor, survey, registered, theta, [], stages)

    return find


def table(due: Counter[str], some: Sequence[Again]) -> list[str]:
    """Lines of the page's table: groups in which conductors were refused, and all groups together."""
    lines = [
        "| group | due | refused | told from the true curve | of those off | refused as well, because |",
        "|---|---|---|---|---|---|",
    ]
    names = [group.name for group in GROUPS if any(each.group == group.name for each in some)]
    by_group = [(name, due[name], [each for each in some if each.group == name]) for name in names]
    for name, count, own in [*by_group, ("all groups", due.total(), list(some))]:
        causes = Counter(each.cause for each in own if not each.told)
        because = ", ".join(f"{cause} {number}" for cause, number in causes.most_common())
        told, off = sum(each.told for each in own), sum(each.off for each in own)
        lines.append(f"| {name} | {count} | {len(own)} | {told} | {off} | {because} |")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description="why due readings of the accuracy suite were refused")
    parser.add_argument("--seed", type=int, default=REPORT_SEED, help="that the table was made with")
    parser.add_argument("--csv", type=Path, default=ROOT / "out" / "bench" / "accuracy.csv", help="the suite's table")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of missed.md")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if not options.csv.is_file():
        parser.error(f"{options.csv}: there is no such table; benchmarks/run.py writes one")
    due, refused = missed_in(options.csv)
    try:
        some = [one for frame, sags in refused.items() for one in again(frame, sags, options.seed)]
    except OtherWorldError as error:
        parser.error(f"{options.csv}: {error}")
    lines = table(due, some)
    print("\n".join(lines))
    command = f"python benchmarks/missed.py --seed {options.seed}"
    head = f"# Due and refused\n\nWritten by `{command}` from the table of that seed's run; do not edit.\n\n{WORDS}\n\n"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "missed.md").write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
