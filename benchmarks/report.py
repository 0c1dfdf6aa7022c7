"""The report: Markdown tables and a plot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

from demo_day import PAPER_EVERY
from paper import TIMED_TEMPLATES, Timing
from sagnode.quality import Validity
from tally import HEADER, Outcome, statistics, stems_of, table_line
from worlds import GROUPS, NEGATIVES

SHOWN = ("sag", "lowest_height", "clearance")
OWN = "rational-bezier"


def demo_section(own: Sequence[Outcome], paper: Sequence[Outcome], timing: Sequence[Timing]) -> str:
    """The demonstration's day."""
    lines = ["## The demonstration's day", ""]
    if not own:
        return "\n".join([*lines, "No frames with truth beside them are installed.", ""])
    frames = len({o.frame for o in own})
    lines += [
        (
            f"{frames} frames of one day at one place, so survey errors are the same in all of them: read it for how"
            " good the numbers are, and the many worlds below for how honest the intervals are."
        ),
        "",
    ]
    for conductor in sorted({o.conductor for o in own}):
        of_conductor = [o for o in own if o.conductor == conductor]
        lines += [f"### {conductor}", "", HEADER, *_all_rows(of_conductor), ""]
    lines += ["### Beside the paper's methods", ""]
    if paper:
        some = {o.frame for o in paper}
        lines += [
            (
                f'On every {PAPER_EVERY}th frame of the day ({len(some)}), all conductors together. "As printed": the'
                " camera as surveyed, the top quadrants, B'(t) = 0; a conductor that leaves the top quadrants cannot be"
                ' matched. "Helped": the camera as sagnode\'s landmarks show it in the very frame, the whole frame,'
                " and the lowest point where mid-span is in space. The paper has no rule for refusing, and its"
                " intervals are its stated 0.18 % of sag."
            ),
            "",
            *_beside([o for o in own if o.frame in some], paper),
        ]
    if timing:
        base = timing[0].seconds
        lines += [
            (
                f"Time for one frame ({timing[0].frame}) with all conductors, one thread, where this page was written;"
                f" the paper's over the whole frame, timed with {TIMED_TEMPLATES} templates and scaled to its 300:"
            ),
            "",
            "| method | s | times sagnode's |",
            "|---|---|---|",
            *(f"| {t.method} | {t.seconds:.2f} | {t.seconds / base:.0f} |" for t in timing),
            "",
        ]
    return "\n".join(lines)


def worlds_section(outcomes: Sequence[Outcome]) -> str:
    """Coverage over worlds."""
    lines = [
        "## Many worlds",
        "",
        (
            "The same survey, and for each world a truth drawn anew from the standard uncertainties that it states:"
            " attachments, ground, landmarks, clicks, camera, lens. Weather, light, sag and swing are drawn too."
        ),
        "",
    ]
    for group in GROUPS:
        in_group = [o for o in outcomes if o.group == group.name]
        of_group = [o for o in in_group if o.method == OWN]
        if not of_group:
            continue
        worlds = len({o.world for o in of_group})
        chance = 100 * 1.96 * np.sqrt(0.95 * 0.05 / worlds)
        lines += [
            f"### {group.name}: {group.what}",
            "",
            (
                f"{worlds} worlds; chance alone moves a coverage of 95 % by ±{chance:.0f} % (the conductors of one"
                " world share its camera)."
            ),
            "",
            HEADER,
            *_all_rows(of_group),
            "",
            *_not_told(of_group),
        ]
        if group.paper:
            lines += ["Beside the paper's methods:", "", *_beside(of_group, [o for o in in_group if o.method != OWN])]
    return "\n".join(lines)


def negatives_section(outcomes: Sequence[Outcome]) -> str:
    """What must not be told."""
    lines = [
        "## What must not be told",
        "",
        "Conductors that are not there or cannot be seen; every number is a mistake.",
        "",
        "| view | case | conductors asked for | told good | told questionable | reasons |",
        "|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(o.group for o in outcomes):
        some = [o for o in outcomes if o.group == name]
        group, kind = name.split(": ")
        good = sum(o.validity is Validity.GOOD for o in some)
        doubtful = sum(o.validity is Validity.QUESTIONABLE for o in some)
        causes = Counter(o.reason.split(":")[0] for o in some)
        said = ", ".join(f"{cause} {n}" for cause, n in causes.most_common())
        lines.append(f"| {group} | {kind}: {NEGATIVES[kind]} | {len(some)} | {good} | {doubtful} | {said} |")
    return "\n".join([*lines, ""])


def plot(own: Sequence[Outcome], paper: Sequence[Outcome], worlds: Sequence[Outcome], file: Path) -> None:
    """Standardised errors of every view beside the normal distribution, and errors of sag by method."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    grid = np.linspace(-5, 5, 201)
    left.fill_between(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), color="0.88", label="as stated")
    for group in GROUPS:
        z = [o.z(s) for o in worlds if o.group == group.name and o.method == OWN for s in SHOWN if s in o.estimates]
        if z:
            left.hist(np.clip(z, -5, 5), bins=25, range=(-5, 5), density=True, histtype="step", label=group.name)
    left.axvline(-1.96, color="0.6", lw=0.8)
    left.axvline(1.96, color="0.6", lw=0.8)
    left.set(xlabel="error / stated standard uncertainty", title="many worlds: sag, lowest height, clearance")
    left.legend(frameon=False)
    named = [
        ("sagnode", own),
        *((name, [o for o in paper if o.method == name]) for name in {o.method: 0 for o in paper}),
    ]
    errors = [
        (name, [100 * o.error("sag") / o.truth["sag"] for o in some if "sag" in o.estimates]) for name, some in named
    ]
    for i, (_, values) in enumerate(errors):
        shown = np.clip(values, -60, 60)
        right.plot(shown, np.full(len(values), i) + np.linspace(-0.25, 0.25, len(values)), ".", ms=4)
        told = f"{len(values)} told"
        right.text(1.01, i, told, va="center", fontsize=8, transform=right.get_yaxis_transform())
    right.set_yticks(range(len(errors)), [name for name, _ in errors])
    right.invert_yaxis()
    right.axvline(0, color="0.6", lw=0.8)
    right.set_xscale("symlog", linthresh=1)
    right.set(xlabel="error of sag, % (symmetric log beyond 1 %)", title="demonstration's day", xlim=(-65, 65))
    figure.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _beside(own: Sequence[Outcome], paper: Sequence[Outcome]) -> list[str]:
    """Lines of a table of sagnode and the paper's methods on the same frames."""
    methods = [("sagnode", own)]
    methods += [(name, [o for o in paper if o.method == name]) for name in dict.fromkeys(o.method for o in paper)]
    lines = [HEADER.replace("quantity", "quantity, method")]
    for stem in SHOWN:
        for name, outcomes in methods:
            row = statistics(outcomes, stem)
            label = f"{stem}, {name}"
            lines.append(table_line(label, row) if row else f"| {label} | {_counts(outcomes)} | | | | | | |")
    return [*lines, ""]


def _all_rows(outcomes: Sequence[Outcome]) -> list[str]:
    rows = [(stem, statistics(outcomes, stem)) for stem in stems_of(outcomes)]
    lines = [table_line(stem, row) for stem, row in rows if row]
    return lines or [f"| none told | {_counts(outcomes)} | | | | | | |"]


def _counts(outcomes: Sequence[Outcome]) -> str:
    counts = Counter(o.validity for o in outcomes)
    return " / ".join(str(counts[v]) for v in (Validity.GOOD, Validity.QUESTIONABLE, Validity.INVALID))


def _not_told(outcomes: Sequence[Outcome]) -> list[str]:
    """Reasons of the readings that were refused though the conductor is in the picture."""
    refused = Counter(o.reason.split(":")[0] for o in outcomes if o.validity is Validity.INVALID)
    if not refused:
        return []
    said = ", ".join(f"{cause} {n}" for cause, n in refused.most_common())
    return [f"Refused though the wire is in the picture: {refused.total()} of {len(outcomes)} ({said}).", ""]
