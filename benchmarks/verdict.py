"""What is wanted of the suite, and whether its outcomes show it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from groups import GROUPS
from tally import Outcome, Row, answers, changes, coverage_by_chance, statistics

ENOUGH = 50
"""Readings from which a group's coverage is judged."""
ALONG_AND_SIDE = ("tower", "field", "field-tower", "field-ground", "side50", "side100", "side-beside", "side200")


@dataclass(frozen=True)
class Verdict:
    """One target beside what was measured."""

    what: str
    wanted: str
    measured: str
    met: bool


SEQUENCES = {group.name for group in GROUPS if group.sequence}


def verdicts(own: Sequence[Outcome]) -> list[Verdict]:
    """All targets that these outcomes can speak about."""
    by_group = {group.name: [o for o in own if o.group == group.name] for group in GROUPS}
    return [
        *_laboratory(by_group),
        *_field(by_group),
        *_clearance(by_group),
        *_limits(by_group),
        *_intervals(by_group),
        *_steps(by_group),
        *_false(own),
        *_missed(own),
    ]


def _laboratory(by_group: dict[str, list[Outcome]]) -> Iterator[Verdict]:
    for name in ("lab", "lab45"):
        row = statistics(by_group[name], "sag")
        if row:
            yield Verdict(f"{name}: error of sag", "RMSE ≤ 0.3 %", _relative(row), row.rmse_rel <= 0.003)
    found = changes(by_group["repeat-lab"])
    if found:
        text = f"{100 * found.scatter_rel:.3f} % of {found.readings}"
        yield Verdict("laboratory: repeatability of sag", "≤ 0.05 %", text, found.scatter_rel <= 0.0005)


def _field(by_group: dict[str, list[Outcome]]) -> Iterator[Verdict]:
    for name in ("field", "field-tower", "field-ground"):
        row = statistics(by_group[name], "sag")
        if row:
            yield Verdict(f"{name}: error of sag", "RMSE ≤ 0.4 %", _relative(row), row.rmse_rel <= 0.004)


def _relative(row: Row) -> str:
    return f"{100 * row.rmse_rel:.2f} % of {row.told} (limit {100 * row.limit_rel:.2f} %)"


def _clearance(by_group: dict[str, list[Outcome]]) -> Iterator[Verdict]:
    rows = {name: statistics(by_group[name], "clearance") for name in ALONG_AND_SIDE}
    found = {name: row for name, row in rows.items() if row}
    if found:
        text = ", ".join(f"{name} {100 * row.rmse:.1f} cm (limit {100 * row.limit:.1f})" for name, row in found.items())
        met = all(row.rmse <= 0.05 for row in found.values())
        yield Verdict("clearance, along the line and from the side", "RMSE ≤ 5 cm", text, met)


def _limits(by_group: dict[str, list[Outcome]]) -> Iterator[Verdict]:
    rows = {name: statistics(some, "sag") for name, some in by_group.items()}
    over = {name: row for name, row in rows.items() if row and not row.to_limit <= 1.5}
    if any(rows.values()):
        text = ", ".join(f"{name} {row.to_limit:.2f} (stated {row.stated_to_limit:.2f})" for name, row in over.items())
        count = sum(row is not None for row in rows.values())
        text = f"over in {len(over)} of {count} groups: {text}" if over else f"at most 1.5 in all {count} groups"
        yield Verdict("RMSE of sag over the limit of the scene", "≤ 1.5", text, not over)


def _intervals(by_group: dict[str, list[Outcome]]) -> Iterator[Verdict]:
    for stem in ("sag", "clearance"):
        # frames of a sequence share all of the survey's errors, and hold the truth together or not at all
        rows = {name: statistics(some, stem) for name, some in by_group.items() if name not in SEQUENCES}
        enough = {name: row for name, row in rows.items() if row and row.told >= ENOUGH}
        if not enough:
            continue
        outside = {name: row for name, row in enough.items() if not 0.925 <= row.coverage < 0.985}
        chance = {name: coverage_by_chance(len({o.world for o in by_group[name]})) for name in outside}
        beyond = sum(abs(row.coverage - 0.95) > chance[name] for name, row in outside.items())
        text = f"outside in {len(outside)} of {len(enough)} groups, by more than chance in {beyond}"
        if outside:
            shown = (f"{name} {100 * row.coverage:.0f} % ± {100 * chance[name]:.0f}" for name, row in outside.items())
            text += ": " + ", ".join(shown)
        yield Verdict(f"95 % interval of {stem} holds the truth, groups of {ENOUGH}", "93 to 98 %", text, not outside)
        wide = {name: row for name, row in enough.items() if not row.width_to_limit <= 2.5}
        text = f"wider in {len(wide)} of {len(enough)} groups"
        if wide:
            text += ": " + ", ".join(f"{name} {row.width_to_limit:.1f}" for name, row in wide.items())
        yield Verdict(f"half-width of {stem} over twice the limit", "≤ 2.5", text, not wide)


def _steps(by_group: dict[str, list[Outcome]]) -> Iterator[Verdict]:
    found = changes(by_group["steps"])
    if found:
        text = f"RMSE of a change {100 * found.step:.2f} cm of {found.readings}"
        yield Verdict("one frame to the next, from the tower", "1 cm of sag resolved", text, found.step <= 0.01)


def _false(own: Sequence[Outcome]) -> Iterator[Verdict]:
    false = [o for o in own if o.false]
    where = ", ".join(sorted({o.group for o in false}))
    text = f"{len(false)} of {len(own)}" + (f" ({where})" if where else "")
    yield Verdict("a number where nothing is to be seen, or off by more than 5 u", "0 in 2 000", text, not false)


def _missed(own: Sequence[Outcome]) -> Iterator[Verdict]:
    a = answers(own)
    if a.due:
        share = 1 - a.missed / a.due
        text = f"{100 * share:.1f} % of {a.due}"
        if a.missed:
            text += "; missed: " + ", ".join(f"{cause} {count}" for cause, count in a.missed_because.most_common())
        yield Verdict("a valid reading where one is due", "≥ 97 %", text, share >= 0.97)
