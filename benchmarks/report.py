"""The report: Markdown tables of every group, and what of the targets they meet."""

from __future__ import annotations

from collections.abc import Sequence

from draws import NEGATIVES
from groups import GROUPS
from tally import (
    OWN,
    UNITS,
    Outcome,
    Row,
    answers,
    changes,
    coverage_by_chance,
    statistics,
    stems_of,
)
from verdict import verdicts

NAMES = [group.name for group in GROUPS]
HEADER = (
    "| group | n | RMSE | bias | RMSE / limit | 95 % holds | half-width | half-width / 2 limits | worst error / u |\n"
    "|---|---|---|---|---|---|---|---|---|"
)
IN_METRES = {"lowest_along", "clearance_along", "catenary_constant"}
"""Lengths too large for centimetres."""
RELATIVE = {
    "sag",
    "inplane_sag",
    "drop",
    "clearance",
    "midspan_sag",
    "midspan_clearance",
    "catenary_constant",
    "tension",
}
"""Quantities of which a per cent means something."""
PREAMBLE = """\
Each group draws its worlds anew: the true span, lens and landmarks differ from the survey by errors of the standard
uncertainties that the survey states, the landmarks are clicked with the stated error, and sag, swing, light, clouds,
haze, sharpness and the camera's sway are drawn too; the group says what is special. What stands in the frames is exact:
catenaries, pieces of catenaries where the load is uneven, and projection through the true lens.

- **n**: readings with a number, good and questionable. **RMSE**, **bias**: of estimate minus truth.
- **limit**: the smallest standard uncertainty that a reader of that very frame can have: survey and clicks as they are,
  the whole visible wire at its true place, white pixel noise and nothing else (`benchmarks/limit.py`). **RMSE / limit**
  is the root mean square of each error over the limit of its own frame. Among the targets it stands in brackets: what a
  reader without any error of its own would reach there, whatever the target says; with a ratio above 1.5 stands what
  the readings themselves state over the limit.
- **95 % holds**: how often the stated interval holds the truth; ± is what chance moves a true 95 %, one draw a world,
  since the conductors of one world share its camera.
- **due**: half of the span in the picture, hidden by nothing, with a contrast of three times the noise of a pixel, by
  day, the camera within the movement that the survey allows. **missed**: due and yet invalid.
- **false**: a number where there is nothing to be seen, or a sag or clearance off by more than 5 of its own u."""


def report(outcomes: Sequence[Outcome], command: str) -> str:
    """The whole page.

    Args:
        outcomes: of all groups and methods.
        command: that makes this page again.
    """
    own = [o for o in outcomes if o.method == OWN]
    present = [name for name in NAMES if any(o.group == name for o in own)]
    told = {name: [o for o in own if o.group == name and o.truth] for name in present}
    told = {name: some for name, some in told.items() if some}
    parts = [
        "# Accuracy",
        f"Written by `{command}`; do not edit.",
        PREAMBLE,
        "\n".join(f"- **{group.name}**: {group.what}." for group in GROUPS if group.name in present),
        "## Targets",
        _verdicts(own),
        "## Sag",
        _table("sag", told),
        "## Clearance",
        _table("clearance", told),
        "![Error over stated standard uncertainty](accuracy.png)",
        "![Error of sag by group](accuracy-errors.png)",
        "![Coverage by group](accuracy-coverage.png)",
        "## Readings and refusals",
        _answers(told),
        *_sequences(told),
        *_negatives(own),
        "## All quantities",
        "All groups but the laboratory's together, and which reading erred most: group, world.frame and conductor.",
        _all_quantities([o for name, some in told.items() if not name.endswith(("lab", "lab45")) for o in some]),
        *_beside(outcomes, present),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _verdicts(own: Sequence[Outcome]) -> str:
    lines = ["| target | wanted | measured | met |", "|---|---|---|---|"]
    lines += [f"| {v.what} | {v.wanted} | {v.measured} | {'yes' if v.met else 'no'} |" for v in verdicts(own)]
    return "\n".join(lines)


def _table(stem: str, told: dict[str, list[Outcome]]) -> str:
    return "\n".join([HEADER, *(_line(name, some, stem) for name, some in told.items())])


def _line(label: str, outcomes: Sequence[Outcome], stem: str) -> str:
    row = statistics(outcomes, stem)
    if row is None:
        return f"| {label} | 0 | | | | | | | |"
    chance = coverage_by_chance(len({o.world for o in outcomes if stem in o.estimates}))
    return (
        f"| {label} | {row.told} | {_amount(stem, row.rmse, row.rmse_rel)}"
        f" | {_amount(stem, row.bias, row.bias_rel, signed=True)} | {_ratio(row.to_limit)}"
        f" | {100 * row.coverage:.0f} % ± {100 * chance:.0f} | {_amount(stem, row.half_width)}"
        f" | {_ratio(row.width_to_limit)} | {row.worst_z:.1f} |"
    )


def _answers(told: dict[str, list[Outcome]]) -> str:
    lines = [
        "| group | good | questionable | invalid | due | missed | false | reasons of the invalid |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, some in told.items():
        a = answers(some)
        missed = f"{a.missed} ({100 * a.missed / a.due:.0f} %)" if a.due else "–"
        reasons = ", ".join(f"{cause} {n}" for cause, n in a.refusals.most_common())
        lines.append(
            f"| {name} | {a.good} | {a.questionable} | {a.invalid} | {a.due} | {missed} | {a.false} | {reasons} |"
        )
    return "\n".join(lines)


def _sequences(told: dict[str, list[Outcome]]) -> list[str]:
    lines = []
    for group in GROUPS:
        found = changes(told.get(group.name, ())) if group.sequence else None
        if found is not None:
            lines.append(
                f"| {group.name} | {found.worlds} | {found.readings} | {_amount('sag', found.scatter)}"
                f" ({100 * found.scatter_rel:.3f} %) | {_amount('sag', found.step)} |"
            )
    if not lines:
        return []
    head = "| group | worlds | readings | scatter of sag's error within a world | error of a change of sag |"
    return [
        "## From one frame to the next",
        "One camera, one survey: what its errors add is the same in every frame of a world and leaves no scatter.",
        "\n".join([head, "|---|---|---|---|---|", *lines]),
    ]


def _negatives(own: Sequence[Outcome]) -> list[str]:
    nothing = [o for o in own if not o.truth]
    if not nothing:
        return []
    lines = [
        "| group | case | conductors asked for | told good | told questionable | reasons |",
        "|---|---|---|---|---|---|",
    ]
    for name in [n for n in NAMES if any(o.group == n for o in nothing)]:
        for kind, meaning in NEGATIVES.items():
            some = [o for o in nothing if o.group == name and o.kind == kind]
            if not some:
                continue
            a = answers(some)
            reasons = ", ".join(f"{cause} {n}" for cause, n in a.refusals.most_common())
            lines.append(f"| {name} | {kind}: {meaning} | {len(some)} | {a.good} | {a.questionable} | {reasons} |")
    told = sum(o.told for o in nothing)
    return [
        "## What must not be told",
        f"Conductors that are not there or cannot be seen: {len(nothing)} asked for, {told} told.",
        "\n".join(lines),
    ]


def _all_quantities(some: Sequence[Outcome]) -> str:
    if not some:
        return ""
    first, second = HEADER.replace("group", "quantity").splitlines()
    lines = [f"{first} of |", f"{second}---|"]
    for stem in stems_of(some):
        row = statistics(some, stem)
        lines.append(f"{_line(stem, some, stem)} {row.worst if row else ''} |")
    return "\n".join(lines)


def _beside(outcomes: Sequence[Outcome], present: Sequence[str]) -> list[str]:
    """The paper's methods on the frames that they measured too."""
    tables = []
    for name in present:
        in_group = [o for o in outcomes if o.group == name]
        worlds = {o.world for o in in_group if o.method != OWN}
        if not worlds:
            continue
        some = [o for o in in_group if o.world in worlds]
        methods = [OWN, *dict.fromkeys(o.method for o in some if o.method != OWN)]
        for stem in ("sag", "clearance"):
            for method in methods:
                label = f"{name}: {stem}, {'sagnode' if method == OWN else method}"
                tables.append(_line(label, [o for o in some if o.method == method], stem))
    if not tables:
        return []
    return [
        "## Beside the paper's methods",
        (
            'The same frames. "As printed": the camera as surveyed, the top quadrants, B\'(t) = 0; a conductor that'
            ' leaves the top quadrants cannot be matched. "Helped": the camera as sagnode\'s landmarks show it in the'
            " very frame, the whole frame, and the lowest point where mid-span is in space. The paper has no rule for"
            " refusing, and its intervals are its stated 0.18 % of sag."
        ),
        "\n".join([HEADER.replace("group", "group, quantity, method"), *tables]),
    ]


def summary(outcomes: Sequence[Outcome]) -> str:
    """A few plain lines a group for the terminal."""
    own = [o for o in outcomes if o.method == OWN]
    head = f"{'group':16}{'told':>9}{'due':>5}{'miss':>5}{'false':>6}   {'sag RMSE':>10}{'bias':>10}{'/limit':>8}"
    lines = [head + f"{'holds':>7}{'width':>7}{'worst':>7}   {'clear. RMSE':>11}{'holds':>7}  invalid because"]
    for name in [n for n in NAMES if any(o.group == n for o in own)]:
        some = [o for o in own if o.group == name]
        a, sag, gap = answers(some), statistics(some, "sag"), statistics(some, "clearance")
        reasons = ", ".join(f"{cause} {n}" for cause, n in a.refusals.most_common(4))
        numbers = _short(sag, gap) if sag and gap else " " * 65
        told = f"{sum(o.told for o in some)}/{len(some)}"
        lines.append(f"{name:16}{told:>9}{a.due:5}{a.missed:5}{a.false:6}   {numbers}  {reasons}")
    return "\n".join(lines)


def _short(sag: Row, gap: Row) -> str:
    return (
        f"{_amount('sag', sag.rmse):>10}{_amount('sag', sag.bias, signed=True):>10}{_ratio(sag.to_limit):>8}"
        f"{100 * sag.coverage:5.0f} %{_ratio(sag.width_to_limit):>7}{sag.worst_z:7.1f}   "
        f"{_amount('clearance', gap.rmse):>11}{100 * gap.coverage:5.0f} %"
    )


def _ratio(value: float) -> str:
    return "–" if value != value else f"{value:.2f}"


def _amount(stem: str, value: float, relative: float = float("nan"), signed: bool = False) -> str:
    unit = UNITS[stem]
    sign = "+" if signed else ""
    if unit == "m" and stem not in IN_METRES:
        text = f"{100 * value:{sign}.1f} cm" if abs(value) >= 0.005 else f"{1000 * value:{sign}.2f} mm"
    elif unit == "deg":
        text = f"{value:{sign}.2f}°"
    elif not unit:
        text = f"{value:{sign}.3f}"
    else:
        text = f"{value:{sign}.1f} {unit.upper() if unit in {'n', 'c'} else unit}"
    return text if relative != relative or stem not in RELATIVE else f"{text} ({100 * relative:{sign}.2f} %)"
