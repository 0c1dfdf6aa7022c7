"""Tables and plot of the timed cases."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

from performance.frames import NAMES
from performance.methods import LITERAL
from performance.prose import flow
from performance.stages import STAGES

PAPER_TEMPLATES = 300
VIEWS = {
    "lab": "laboratory, 960x540",
    "tower": "tower, 1456x1088",
    "field": "field, 4056x3040",
}
RUNNING = ("curve points", "draw", "matchTemplate")
"""Stages of the literal search that are gone through for every template."""
STATUS_WALL_S, WORKER_MB, DAEMON_MB = 0.15, 150.0, 60.0


class Cases:
    """The timed cases, to be looked up by what they are."""

    def __init__(self, rows: list[dict[str, Any]]) -> None:
        self._rows = rows

    def all(self, case: str, **about: object) -> list[dict[str, Any]]:
        """Every case of a kind with these properties."""
        return [r for r in self._rows if r.get("case") == case and all(r.get(k) == v for k, v in about.items())]

    def one(self, case: str, **about: object) -> dict[str, Any]:
        """The only one.

        Raises:
            LookupError: there is none, or there are several.
        """
        found = self.all(case, **about)
        if len(found) != 1:
            raise LookupError(f"{len(found)} cases of {case} with {about}")
        return found[0]

    def seconds(self, case: str, **about: object) -> float:
        """CPU time of the only one."""
        return float(self.one(case, **about)["min"])

    def literal(self, view: str, method: str = "Bézier") -> dict[str, float]:
        """The literal search by stage for all of its 300 templates, s."""
        row = self.one("literal", view=view, method=method)
        factor = PAPER_TEMPLATES / row["templates"]
        return {stage: s * (factor if stage in RUNNING else 1.0) for stage, s in row["spent"].items()}

    def matching(self, view: str, templates: int) -> float:
        """Seconds of what sagnode does in the place of the literal search: search, refinement and joint estimate."""
        return float(self.one("own", view=view, wanted=templates)["spent"]["locate"])

    def ratio(self, view: str, templates: int) -> float:
        """How many times sooner that is done than the literal search."""
        return sum(self.literal(view).values()) / self.matching(view, templates)


def targets_section(cases: Cases, others: dict[str, dict[str, Any]]) -> str:
    """What was asked for beside what was measured; ``others``: results of the other parts, as far as they are there."""
    reading, decoding = (1000 * cases.seconds(case, view="field") for case in ("reading", "decoding"))
    one, eight = (cases.seconds("burst", view="tower", frames=n) for n in (1, 8))
    rows: list[tuple[str, str, str, bool]] = []

    def at_least(what: str, wanted: float, got: float) -> None:
        rows.append((what, f"≥ {wanted:,.0f} ×", f"{got:,.0f} ×", got >= wanted))

    def at_most(what: str, wanted: float, got: float, unit: str) -> None:
        rows.append((what, f"≤ {wanted:,.3g} {unit}", f"{got:,.3g} {unit}", got <= wanted))

    at_least(
        "300 templates, refinement, joint estimate, against the literal search, 1456x1088",
        1000,
        cases.ratio("tower", 300),
    )
    at_least("the same at 12 megapixels", 5000, cases.ratio("field", 300))
    at_least("the same with 10 000 templates, 1456x1088", 250, cases.ratio("tower", 10000))
    at_most("three conductors in one 12-megapixel frame, after decoding", 60, reading, "ms")
    at_most("the same against decoding that frame's JPEG", decoding, reading, "ms")
    at_most("a burst of 8 against one frame", 8, eight / one, "×")
    if "memory" in others:
        memory = others["memory"]
        at_most("worker's peak at 12 megapixels", WORKER_MB, memory["worker"]["field"]["peak_kb"] / 1024, "MB")
        burst = memory["worker_burst"]["peak_kb"] / 1024
        at_most("the same with bursts of 8 from files", WORKER_MB, burst, "MB")
    if "soak" in others:
        soak = others["soak"]
        at_most("daemon's peak", DAEMON_MB, soak["daemon"]["peak_kb"] / 1024, "MB")
        at_most("`sagnode status`, wall time", STATUS_WALL_S, soak["status"]["wall_s"], "s")
    lines = ["## Targets", "", "| what | wanted | measured | |", "|---|---|---|---|"]
    lines += [f"| {what} | {wanted} | {got} | {'met' if met else '**missed**'} |" for what, wanted, got, met in rows]
    if not all(met for *_, met in rows):
        lines += ["", _where_the_time_is(cases)]
    return "\n".join([*lines, ""])


def _where_the_time_is(cases: Cases) -> str:
    """What the reading of the largest frame is made of, in a sentence, the dearest first."""
    words = {
        "register": "landmarks and pose",
        "library": "drawing the templates",
        "search": "the coarse search",
        "refine": "measuring across the curves",
        "solve": "the joint estimates",
        "tell": "quantities and uncertainties",
    }
    row = cases.one("reading", view="field")
    spent = {name: 1e3 * row["spent"].get(name, 0.0) for name in words}
    spent["rest"] = 1e3 * row["staged_s"] - sum(spent.values())
    order = sorted(words, key=lambda name: -spent[name])
    parts = ", ".join(f"{words[name]} {spent[name]:.0f}" for name in order)
    return flow(
        f"""Where a target is missed: of the {1e3 * row["staged_s"]:.0f} ms of three conductors in a 12-megapixel frame,
        in ms: {parts}, all else {max(spent["rest"], 0.0):.0f}. The last section says what the calls that read the
        needed pixels take by themselves. Most of the rest is NumPy on arrays of some hundreds to thousands of numbers,
        where calling costs as much as the arithmetic."""
    )


def methods_section(cases: Cases) -> str:
    """One conductor, all methods."""
    lines = [
        "## One conductor, beside the paper's search",
        "",
        flow(
            """The paper's search is its 300 templates by `cv2.matchTemplate` over the fewest quadrants in which all of
            them lie, after undistorting the frame and finding its edges; where fewer templates were run, evenly
            chosen, their part is multiplied. The anchored search gives the same scores at the anchors alone
            (`sagnode.reference.anchored`) with a library drawn beforehand. sagnode's rows are its whole way of a
            frame: landmarks, pose, search, refinement, joint estimate, uncertainty, judgement; "matching" is what
            takes the literal search's place, without landmarks, pose and the telling of the quantities."""
        ),
        "",
        "| picture | method | templates | CPU ms | × | of it matching, ms | × | sag error |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for view in NAMES:
        base = sum(cases.literal(view).values())
        for method in LITERAL:
            total = sum(cases.literal(view, method).values())
            lines.append(f"| {VIEWS[view]} | paper, {method} | 300 | {1e3 * total:,.0f} | {base / total:.2g} | | | |")
        anchored = cases.seconds("anchored", view=view)
        lines.append(f"| | exact, anchored | 300 | {1e3 * anchored:,.1f} | {base / anchored:,.0f} | | | |")
        for row in cases.all("own", view=view):
            error = "" if row["sag_error"] is None else f"{100 * row['sag_error']:+.2f} %"
            lines.append(
                f"| | sagnode, {row['validity']} | {row['templates']:,} | {1e3 * row['min']:,.1f}"
                f" | {base / row['min']:,.0f} | {1e3 * row['spent']['locate']:,.1f}"
                f" | {base / row['spent']['locate']:,.0f} | {error} |"
            )
    apart = max(row["largest_difference"] for row in cases.all("literal", method="Bézier"))
    drawn = ", ".join(f"{1e3 * cases.seconds('anchored library', view=v):.0f}" for v in NAMES)
    lines += [
        "",
        flow(
            f"""The anchored scores differ from `cv2.matchTemplate`'s by at most {apart:.1g} on these pictures. Drawing
            its library for a new pose takes {drawn} ms."""
        ),
        "",
        "Where the literal search spends its time, ms for 300 templates:",
        "",
        "| picture | method | undistort | edges | curve points | draw | matchTemplate |",
        "|---|---|---|---|---|---|---|",
    ]
    for view in NAMES:
        for method in LITERAL:
            spent = cases.literal(view, method)
            amounts = " | ".join(f"{1e3 * s:,.0f}" for s in spent.values())
            lines.append(f"| {VIEWS[view]} | {method} | {amounts} |")
    return "\n".join([*lines, ""])


def stages_section(cases: Cases) -> str:
    """A whole reading by stage."""
    lines = [
        "## Where a reading's time goes",
        "",
        flow(
            """All conductors of the site in one frame; CPU ms by stage, parts indented, of the quickest of some runs
            with a clock on every stage. "refine" measures the wire across the curve, "solve" is the joint estimate."""
        ),
        "",
        "| stage | " + " | ".join(VIEWS[v] for v in NAMES) + " |",
        "|---|" + "---|" * len(NAMES),
    ]
    rows = {view: cases.one("reading", view=view) for view in NAMES}
    for stage in STAGES:
        name = f"– {stage.name}" if stage.within else stage.name
        cells = (_stage_cell(rows[view], stage.name) for view in NAMES)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    lines.append("| **all** | " + " | ".join(f"**{1e3 * rows[v]['staged_s']:.1f}**" for v in NAMES) + " |")
    for case, words in (("decoding", "decoding the frame's JPEG"), ("site", "site made ready, once")):
        lines.append(f"| {words} | " + " | ".join(f"{1e3 * cases.seconds(case, view=v):.1f}" for v in NAMES) + " |")
    for frames in (1, 8):
        words = f"worker's cycle, burst of {frames}, decoding and reply included"
        cells = (f"{1e3 * cases.seconds('worker cycle', view=v, frames=frames):.1f}" for v in NAMES)
        lines.append(f"| {words} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def _stage_cell(row: dict[str, Any], stage: str) -> str:
    if stage not in row["spent"]:
        return "–"
    calls = row["calls"][stage]
    return f"{1e3 * row['spent'][stage]:.1f}" + (f" ({calls} ×)" if calls > 1 else "")


def native_section(found: dict[str, Any]) -> str:
    """Compiled kernels beside the same in NumPy."""
    lines = ["## Compiled kernels", ""]
    if not found["compiled"]:
        words = """The compiled kernels were NOT in use: this installation has none (`sagnode.native`), and every number
            of sagnode on this page is that of its NumPy code."""
        return "\n".join([*lines, flow(words), ""])
    lines += [
        flow(
            """The inner loops in C (`sagnode.native`) were in use. With `SAGNODE_NATIVE=0` NumPy does the same; here
            both ways by turns, in processes of their own, on all conductors of one frame."""
        ),
        "",
        "| picture | compiled, CPU ms | NumPy, CPU ms | × | sags apart by at most |",
        "|---|---|---|---|---|",
    ]
    for view in NAMES:
        row = found["views"][view]
        lines.append(
            f"| {VIEWS[view]} | {1e3 * row['with_s']:.1f} | {1e3 * row['without_s']:.1f}"
            f" | {row['without_s'] / row['with_s']:.1f} | {row['apart']:.2g} of their uncertainty |"
        )
    return "\n".join([*lines, ""])


def growth_section(cases: Cases) -> str:
    """How the time grows with everything."""
    lines = ["## Growth", "", "| with | values | CPU ms | |", "|---|---|---|---|"]
    for view in NAMES:
        rows = cases.all("own", view=view)
        last, first = rows[-1], rows[0]
        slope = (last["spent"]["search"] - first["spent"]["search"]) / (last["templates"] - first["templates"])
        words = f"{1e6 * slope:.1f} µs a template, in the search" if slope > 0 else "no growth seen in the search"
        lines.append(_growth(f"templates, {VIEWS[view]}", [f"{r['templates']:,}" for r in rows], rows) + f" {words} |")
    rows = cases.all("frame size")
    sizes = [f"{r['width']}x{r['height']}" for r in rows]
    solves = " / ".join(str(_solves(r)) for r in rows)
    lines.append(_growth("frame size, the same view", sizes, rows) + f" {solves} joint estimates |")
    rows = cases.all("conductors")
    steps = " and ".join(f"{1e3 * (b['min'] - a['min']):+.0f}" for a, b in pairwise(rows))
    lines.append(_growth("conductors, tower", [str(r["conductors"]) for r in rows], rows) + f" {steps} ms |")
    for view in NAMES:
        rows = cases.all("burst", view=view)
        growth = rows[-1]["min"] / rows[0]["min"]
        lines.append(
            _growth(f"frames of a burst, {VIEWS[view]}", [str(r["frames"]) for r in rows], rows)
            + f" {growth:.2f} × one frame |"
        )
    return "\n".join([*lines, "", flow(_of_frame_size(cases.all("frame size"))), ""])


def _of_frame_size(rows: list[dict[str, Any]]) -> str:
    """Which size costs most, and why."""
    words = "Only what lies near the curves is read. What counts is how much a picture leaves open, not its pixels"
    least, most = min(rows, key=lambda r: r["min"]), max(rows, key=lambda r: r["min"])
    if _solves(most) <= _solves(least):
        return f"{words}."
    dear, cheap = (f"{r['width']}x{r['height']}" for r in (most, least))
    return (
        f"{words}: the frame of {dear} takes {most['min'] / least['min']:.2g} times as long as that of {cheap}, because"
        f" {_solves(most)} joint estimates are made in it instead of {_solves(least)}."
    )


def _solves(row: dict[str, Any]) -> int:
    return int(row["calls"].get("solve", 0))


def _growth(what: str, values: list[str], rows: list[dict[str, Any]]) -> str:
    times = " / ".join(f"{1e3 * r['min']:.0f}" for r in rows)
    return f"| {what} | {' / '.join(values)} | {times} |"


def plot(cases: Cases, file: Path) -> None:
    """Four panels: templates, frame size, conductors, frames."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, ((a, b), (c, d)) = plt.subplots(2, 2, figsize=(11, 8), constrained_layout=True)
    for view, colour in zip(NAMES, ("tab:blue", "tab:orange", "tab:green"), strict=True):
        rows = cases.all("own", view=view)
        a.loglog([r["templates"] for r in rows], [1e3 * r["min"] for r in rows], "o-", color=colour, label=VIEWS[view])
        literal, anchored = 1e3 * sum(cases.literal(view).values()), 1e3 * cases.seconds("anchored", view=view)
        a.plot(PAPER_TEMPLATES, literal, "x", color=colour, ms=9)
        a.plot(PAPER_TEMPLATES, anchored, "+", color=colour, ms=10)
        rows = cases.all("burst", view=view)
        d.plot([r["frames"] for r in rows], [1e3 * r["min"] / r["frames"] for r in rows], "o-", color=colour)
    a.plot([], [], "xk", label="the paper's search")
    a.plot([], [], "+k", label="exact, anchored")
    a.set(xlabel="templates", ylabel="CPU ms, one conductor", title="Templates")
    a.legend(fontsize=8)
    rows = cases.all("frame size")
    b.plot([r["width"] * r["height"] / 1e6 for r in rows], [1e3 * r["min"] for r in rows], "o-", color="k")
    for r in rows:
        at = (r["width"] * r["height"] / 1e6, 1e3 * r["min"])
        b.annotate(str(_solves(r)), at, xytext=(6, 5), textcoords="offset points", fontsize=8)
    b.set(xlabel="megapixels", ylabel="CPU ms", title="Frame size: the tower view, and joint estimates made")
    b.margins(0.1)
    b.set(xlim=(0, None), ylim=(0, None))
    rows = cases.all("conductors")
    c.plot([r["conductors"] for r in rows], [1e3 * r["min"] for r in rows], "o-", color="tab:orange")
    c.set(xlabel="conductors", ylabel="CPU ms", title="Conductors: tower", xticks=[1, 2, 3], ylim=(0, None))
    d.set(xlabel="frames of a burst", ylabel="CPU ms a frame", title="Frames", xticks=[1, 2, 4, 8], ylim=(0, None))
    for axis in (a, b, c, d):
        axis.grid(alpha=0.3, which="both")
    figure.savefig(file, dpi=90)
    plt.close(figure)
