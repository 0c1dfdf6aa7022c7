"""Sections on errors, memory, and where the remaining time goes."""

from __future__ import annotations

from typing import Any

from performance.frames import NAMES
from performance.prose import flow

MB = 1024.0
FEWEST = 5000
"""Readings of which a slope is told: fewer are over before allocator and caches have come to rest."""
METHOD_NAMES = {
    "literal": "paper, literal (any number of templates, one after the other)",
    "anchored": "exact, anchored, 300 templates",
    "reading": "sagnode, one frame",
    "burst": "sagnode, burst of 8, frames handed over one by one",
}


def accuracy_section(results: dict[str, Any]) -> str:
    """The scene suite's summary, as it prints it."""
    worlds = "One world" if results["worlds"] == 1 else f"{results['worlds']} worlds"
    lines = [
        "## Errors of the same code",
        "",
        flow(
            f"""{worlds} of each group, by `{results["command"]}`: a look, to see that speed has cost nothing.
            [accuracy.md](accuracy.md) has many worlds, and says what the columns and the groups are."""
        ),
        "",
        "```",
        *(line.rstrip() for line in results["summary"].splitlines()),
        "```",
        "",
    ]
    return "\n".join(lines)


def memory_section(results: dict[str, Any]) -> str:
    """Peaks."""
    lines = ["## Memory", "", "Peak of resident memory above what was there with libraries and picture loaded, MB:", ""]
    lines += ["| method | " + " | ".join(NAMES) + " |", "|---|" + "---|" * len(NAMES)]
    for method, name in METHOD_NAMES.items():
        rows = (results["methods"][view][method] for view in NAMES)
        lines.append(f"| {name} | " + " | ".join(f"{(r['peak_kb'] - r['before_kb']) / MB:.1f}" for r in rows) + " |")
    lines += [
        "",
        "The real worker process under the daemon's own supervisor; frames come from JPEG files, one by one:",
        "",
    ]
    lines += ["| frames | ready, MB | peak, MB | after, MB |", "|---|---|---|---|"]
    workers = {f"{view}, one a reading": results["worker"][view] for view in NAMES}
    workers["field, burst of 8"] = results["worker_burst"]
    lines += [
        f"| {name} | {w['ready_kb'] / MB:.0f} | {w['peak_kb'] / MB:.0f} | {w['after_kb'] / MB:.0f} |"
        for name, w in workers.items()
    ]
    lines += [
        "",
        flow(
            """A live camera's frames wait for nobody: a burst of it is held until it is measured, which takes one byte
            more for every pixel of every further frame."""
        ),
    ]
    return "\n".join([*lines, ""])


def soak_section(results: dict[str, Any]) -> str:
    """Growth over many readings, and ``sagnode status``."""
    lines = [
        "## Over many readings",
        "",
        flow(
            """Resident memory, MB, after a first quarter in which caches and pools fill up. The slope is that of a line
            through the means of twenty blocks of readings, ± its standard uncertainty from their scatter."""
        ),
        "",
        "| process | readings | settled | middle | end | kB more for every 1 000 readings |",
        "|---|---|---|---|---|---|",
    ]
    for name, key in (
        ("daemon with journal and broker; a stand-in measures, three conductors", "daemon"),
        ("worker, laboratory frames", "worker"),
    ):
        found = results[key]
        slope = found["slope"]
        heights = " | ".join(f"{slope[where] / MB:.2f}" for where in ("settled", "middle", "last"))
        lines.append(f"| {name} | {found['readings']:,} | {heights} | {_growth(found)} |")
    status = results["status"]
    heavy = ", ".join(status["imported"]) or "neither NumPy nor OpenCV, nor pydantic, APScheduler or paho"
    lines += [
        "",
        flow(
            f"""`sagnode status` on the journal that the daemon left takes {1e3 * status["wall_s"]:.0f} ms of wall time,
            the median of {status["runs"]} ({1e3 * status["cpu_s"]:.0f} ms CPU; the bare interpreter
            {1e3 * status["bare_s"]:.0f} ms), and imports {heavy}."""
        ),
        "",
    ]
    return "\n".join(lines)


def _growth(found: dict[str, Any]) -> str:
    """A slope, where there were enough readings to tell one."""
    if found["readings"] < FEWEST:
        return f"{found['readings']:,} readings are too few to tell: `run.py --thorough --only soak`"
    slope = found["slope"]
    return f"{slope['per_thousand']:+.0f} ± {slope['u']:.0f}"


def profile_section(results: dict[str, Any]) -> str:
    """The largest items of the profile, and the floor."""
    lines = ["## Where the remaining time goes", ""]
    for view, found in results.items():
        floor = found["floor"]
        lines += [
            f"### {view}: {found['conductors']} conductors, {found['cpu_ms']:.1f} ms",
            "",
            "| function | own ms | with callees, ms |",
            "|---|---|---|",
        ]
        lines += [f"| `{row['name']}` | {row['own_ms']:.1f} | {row['cumulative_ms']:.1f} |" for row in found["top"]]
        kinds = ", ".join(f"{name} {ms:.0f} ms" for name, ms in found["kinds"].items())
        lines += [
            "",
            flow(f"""From {found["samples"]:,} looks by py-spy. A function's own time has NumPy's and OpenCV's functions
            in it that it calls. By the innermost frame: {kinds}."""),
            "",
            "The floor:",
            "",
            "| by itself | ms |",
            "|---|---|",
        ]
        lines += [f"| {words} | {ms:.2f} |" for words, ms in floor]
        lines.append("")
    return "\n".join(lines)
