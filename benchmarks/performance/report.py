"""Writes ``docs/performance.md`` and its plot from what was measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from performance import speed_tables as speed
from performance.idle_tables import idle_section
from performance.prose import flow
from performance.resource_tables import accuracy_section, memory_section, profile_section, soak_section

Part = dict[str, Any]


def write_report(load: Callable[[str], Part | None], out: Path) -> list[Path]:
    """Write the report and its plot into ``out``; parts that were never measured are left out.

    Args:
        load: gives a part's measurements by its name, or None.
        out: folder; made if need be.
    """
    parts = {name: load(name) for name in ("speed", "accuracy", "memory", "soak", "idle", "profile")}
    measured = {name: part for name, part in parts.items() if part is not None}
    sections = ["# Performance", "", _head(measured), ""]
    out.mkdir(parents=True, exist_ok=True)
    written = [out / "performance.md"]
    if "speed" in measured:
        cases = speed.Cases(measured["speed"]["results"]["cases"])
        plot = out / "performance.png"
        speed.plot(cases, plot)
        written.append(plot)
        others = {name: part["results"] for name, part in measured.items()}
        sections += ["![Growth](performance.png)", "", speed.targets_section(cases, others)]
        sections += [speed.methods_section(cases), speed.stages_section(cases)]
        sections += [speed.native_section(measured["speed"]["results"]["native"]), speed.growth_section(cases)]
    for name, section in (
        ("accuracy", accuracy_section),
        ("memory", memory_section),
        ("soak", soak_section),
        ("idle", idle_section),
        ("profile", profile_section),
    ):
        if name in measured:
            sections.append(section(measured[name]["results"]))
    written[0].write_text("\n".join(sections).rstrip() + "\n", encoding="utf-8")
    return written


def _head(parts: dict[str, Part]) -> str:
    lines = [
        flow(
            """Written by `python benchmarks/performance/run.py`; do not edit. Times are CPU seconds of one thread, the
            least of the rounds, unless wall time is said; ratios are between methods on the same picture in the
            same process of the same run. No Raspberry Pi was at hand: its cores take two to four times as long (an
            estimate, not measured), for all methods alike. Where other programs shared the machine (a load beyond its
            processors) single times scatter: look at ratios, and measure again."""
        ),
        "",
        "| part | measured | version | how long | load | machine |",
        "|---|---|---|---|---|---|",
    ]
    for name, part in parts.items():
        machine = part["machine"]
        words = f"{machine['processor']}, Python {machine['python']}, NumPy {machine['numpy']}"
        words += f", OpenCV {machine['opencv']}"
        load = f"{part['load']:.0f}" if "load" in part else "not noted"
        kind = "thorough" if part["thorough"] else "quick"
        lines.append(f"| {name} | {part['measured_at']} | {part['version']} | {kind} | {load} | {words} |")
    return "\n".join(lines)
