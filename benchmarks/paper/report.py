"""The measured part of ``docs/paper.md``: our rows beside the printed ones, and whether they agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from paper import printed
from paper.measuring import OWN, PAPER_METHODS, Errors, Result, difference, errors
from paper.modes import ModeRow
from performance.prose import flow

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
METHODS = (*PAPER_METHODS, OWN)
VIEW_NAMES = {"lab": "frontal", "lab45": "at 45°"}


@dataclass(frozen=True)
class Measured:
    """Everything that the tables are made of."""

    command: str
    lab: dict[tuple[str, str], list[Result]]
    """By view and survey (``exact`` or ``surveyed``)."""
    repeats: dict[str, list[Result]]
    """One world and one sag (``noise``); every trial its own (``worlds``)."""
    modes: dict[str, list[ModeRow]]
    free: tuple[int, int, list[float]]
    timing: dict[str, dict[str, float]]
    distortion: dict[tuple[str, bool], list[Result]]
    """By lens and whether its distortion was undone."""
    field: dict[str, list[Result]]
    """By circumstances, in words."""
    pixel_cm: float
    """One pixel of the laboratory's picture at 2.5 m."""


def write(measured: Measured, file: Path) -> None:
    """Put the tables between the marks of a Markdown file; everything else in it stays.

    Raises:
        ValueError: the file has no marks.
    """
    text = file.read_text(encoding="utf-8")
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{file} has no lines {BEGIN} and {END}, between which the tables go")
    file.write_text(f"{before}{BEGIN}\n{sections(measured)}\n{END}{after}", encoding="utf-8")


def sections(m: Measured) -> str:
    """All tables in Markdown."""
    parts = [
        flow(f"""Written by `{m.command}`. Errors are of the clearance at mid-span, measured minus true; `mean` is the
            mean size of the error. "% of 18 cm" is the paper's percentage, of its right line's clearance. One pixel is
            {m.pixel_cm:.2f} cm in the laboratory, {100 * m.pixel_cm / printed.CLEARANCE_CM:.1f} % of 18 cm."""),
        "",
        "![Figure 4 and the errors](paper.png)",
        "",
        _figure_4(m),
        _tables_3_and_4(m),
        _table_5(m),
        _tables_6_and_7(m),
        _table_8(m),
        _table_9(m),
    ]
    return "\n".join(parts).rstrip()


def _percent(cm: float) -> float:
    return 100 * cm / printed.CLEARANCE_CM


def _row(label: str, e: Errors) -> str:
    if not e.told:
        return f"| {label} | 0 of {e.of} | | | | |"
    return (
        f"| {label} | {e.told} of {e.of} | {e.mean_abs:.3f} | {_percent(e.mean_abs):.2f} % | {e.bias:+.3f}"
        f" | {100 * e.held:.0f} % |"
    )


HEAD = "| {} | told | mean, cm | % of 18 cm | bias, cm | 95 % interval holds |\n|---|---|---|---|---|---|"


def _figure_4(m: Measured) -> str:
    lines = [
        "### Figure 4: six matching modes",
        "",
        "Bézier templates, anchored, top quadrants; error of the chosen template's sag.",
        "",
        "| mode | " + " | ".join(f"{VIEW_NAMES.get(v, v)}: mean, cm | worst, cm | within 1 cm" for v in m.modes) + " |",
        "|---|" + "---|---|---|" * len(m.modes),
    ]
    for rows in zip(*m.modes.values(), strict=True):
        cells = (f"{r.mean_abs_cm:.2f} | {r.worst_cm:.2f} | {r.near} of {r.pictures}" for r in rows)
        lines.append(f"| {rows[0].mode} | " + " | ".join(cells) + " |")
    some = next(iter(m.modes.values()))
    fit = [r.mode for r in some if r.near == r.pictures]
    own = next(r for r in some if r.mode == printed.FIGURE_4_BEST)
    alike = [r.mode for r in some if abs(r.mean_abs_cm - own.mean_abs_cm) < 0.005]
    away, pictures, _ = m.free
    alike_words = "It is not alone:" if len(alike) > 1 else "It is alone:"
    lines += [
        "",
        flow(f"""The paper's choice, {printed.FIGURE_4_BEST}, {"holds" if own.mode in fit else "does not hold"}: it
            finds the wire in {own.near} of {own.pictures} pictures. {alike_words} {len(alike)} of the six choose the
            same templates, since with the place fixed and the curves of nearly one length the score is little more
            than the number of edge pixels under the template. The squared differences fail: edge pictures are sparse,
            so that the template with the fewest pixels wins."""),
        "",
        flow(f"""The anchor carries the method. Without it, the best place of any template anywhere in the top quadrants
            starts on the other wire in {away} of {pictures} frontal pictures."""),
        "",
    ]
    return "\n".join(lines)


def _tables_3_and_4(m: Measured) -> str:
    lines = ["### Tables 3 and 4: hyperbolic cosine and Bézier in the laboratory", "", "Printed:", ""]
    lines += ["| target | method | error, cm | of the clearance |", "|---|---|---|---|"]
    for target, method, cm, percent in (*printed.TABLE_3, *printed.TABLE_4):
        lines.append(f"| {target} | {method} | {cm:g} | {percent:g} % |")
    for survey, words in (
        ("exact", "Ours, camera and attachments known exactly, as in a laboratory:"),
        ("surveyed", "Ours, with errors of a survey (1 mm for attachments, 3 mm and 0.3° for the camera):"),
    ):
        lines += ["", words, "", HEAD.format("view and method")]
        for view, name in VIEW_NAMES.items():
            results = m.lab[view, survey]
            lines += [_row(f"{name}, {method}", errors(results, method)) for method in METHODS]
    lines += ["", "What holds:", ""]
    for view, name in VIEW_NAMES.items():
        lines.append(f"- {_first_and_second(m, view, name)}")
        lines.append(f"- {_second_and_bezier(m, view, name)}")
    exact, own = (errors(m.lab["lab", "exact"], name) for name in ("Bézier", OWN))
    lines.append(
        "- "
        + flow(f"""The printed errors of Method 2 and Bézier, 0.04 to 0.45 cm, lie within {0.45 / m.pixel_cm:.1f} px.
            Edges and templates know whole pixels, and the start may be off by one: ours is {exact.mean_abs:.2f} cm,
            nearly all of it bias. A sub-pixel fit to the same pictures is off by {own.mean_abs:.3f} cm.""")
    )
    return "\n".join([*lines, ""])


def _first_and_second(m: Measured, view: str, name: str) -> str:
    one, two = (errors(m.lab[view, "exact"], method) for method in ("Method 1", "Method 2"))
    holds = one.mean_abs > 2 * two.mean_abs
    verdict = "Holds" if holds else "Does not hold"
    return flow(f"""{verdict} {name}: "perspective and mid-span correct most of Method 1's error" (6.15 % to 1.55 %).
        Ours: {_percent(one.mean_abs):.1f} % to {_percent(two.mean_abs):.1f} %.""")


def _second_and_bezier(m: Measured, view: str, name: str) -> str:
    gap, u, pairs = difference(m.lab[view, "exact"], "Method 2", "Bézier")
    better = gap > 2 * u and gap > 0.25 * m.pixel_cm
    verdict = "Holds" if better else "Does not hold"
    return flow(f"""{verdict} {name}: "Bézier templates are more accurate than hyperbolic cosines" (1.1 % against
        1.55 %). Ours differ by {gap:+.3f} ± {u:.3f} cm over {pairs} pictures, {abs(gap) / m.pixel_cm:.2f} px.""")


def _table_5(m: Measured) -> str:
    p = printed.TABLE_5
    low, high = p["interval"]
    lines = [
        "### Table 5: thirty experiments",
        "",
        "| | mean, cm | s.d., cm | RMSE, cm | 95 % interval of the mean, cm |",
        "|---|---|---|---|---|",
        f"| printed, Bézier | {p['mean']:.2f} | {p['sd']:.2f} | {p['rmse']:.2f} | {low}–{high} |",
    ]
    names = {"noise": "only the noise differs", "worlds": "another survey and sag each"}
    for key, words in names.items():
        for method in ("Bézier", OWN):
            e = errors(m.repeats[key], method)
            half = 1.96 * e.mean_abs_u
            lines.append(
                f"| ours, {method}, {words} ({e.told}) | {e.mean_abs:.3f} | {e.sd:.3f} | {e.rms:.3f}"
                f" | {e.mean_abs - half:.3f}–{e.mean_abs + half:.3f} |"
            )
    noise, worlds = (errors(m.repeats[key], "Bézier") for key in ("noise", "worlds"))
    lines += [
        "",
        flow(f"""Pictures of one scene tell the repeatability, {noise.sd:.3f} cm, and nothing about the accuracy: the
            search picks the same template every time, and their common error, {noise.bias:+.2f} cm, does not scatter.
            With another survey each, the errors scatter by {worlds.sd:.2f} cm. The printed interval is one of the mean
            over repeats, not one that holds the truth."""),
        "",
    ]
    return "\n".join(lines)


def _tables_6_and_7(m: Measured) -> str:
    cosh, bezier = m.timing["cosh with perspective"], m.timing["Bézier"]
    lines = [
        "### Tables 6 and 7: time",
        "",
        "CPU ms for a template, hyperbolic cosine / Bézier, 960x540, `cv2.matchTemplate` over the region of interest:",
        "",
        "| operation | printed, Raspberry Pi 5 | printed ratio | ours | ratio |",
        "|---|---|---|---|---|",
    ]
    for stage, (a, b) in printed.TABLE_6.items():
        ratio, own = (f"{x / y:.2f}" if y else "–" for x, y in ((a, b), (cosh[stage], bezier[stage])))
        lines.append(f"| {stage} | {a:g} / {b:g} | {ratio} | {cosh[stage]:.3f} / {bezier[stage]:.3f} | {own} |")
    lines.append(f"| drawing | not printed | | {cosh['drawing']:.3f} / {bezier['drawing']:.3f} | |")
    speedup = cosh["search"] / bezier["search"]
    verdict = "Holds" if speedup >= printed.FASTER else "Does not hold"
    lines += [
        f"| search of 300 | 160 s / 100 s | 1.60 | {cosh['search']:.2f} s / {bezier['search']:.2f} s | {speedup:.2f} |",
        "",
        flow(f"""{verdict}: "Bézier templates are 1.5 to 2 times faster". Curve
            points and perspective are dearer for the hyperbolic cosine, but matching is
            {100 * bezier["matching"] / (bezier["matching"] + bezier["curve points"] + bezier["drawing"]):.0f} % of the
            time, and it costs the same whatever curve is drawn: OpenCV correlates by Fourier transforms, which know no
            early end and depend on the sizes alone. Ours match in {cosh["matching"]:.1f} and {bezier["matching"]:.1f}
            ms; the printed 413 and 313 ms cannot come from the scores. What makes the search slow is correlating
            millions of places of which nine count: see [performance.md](performance.md)."""),
        "",
    ]
    return "\n".join(lines)


def _table_8(m: Measured) -> str:
    lines = ["### Table 8: distortion", "", "| target | distorted | corrected |", "|---|---|---|"]
    lines += [f"| printed, {target} | {off:g} % | {on:g} % |" for target, off, on in printed.TABLE_8]
    lenses = list(dict.fromkeys(lens for lens, _ in m.distortion))
    for lens in lenses:
        for method in ("Bézier", OWN):
            cells = []
            for undone in (False, True):
                e = errors(m.distortion[lens, undone], method)
                cells.append(
                    f"{_percent(e.mean_abs):.2f} % ({e.mean_abs:.2f} cm; {e.told} of {e.of})" if e.told else "refused"
                )
            lines.append(f"| {lens}, {method} | " + " | ".join(cells) + " |")
    gap = printed.TABLE_8[2][1] - printed.TABLE_8[2][2]
    gap_px = gap * printed.CLEARANCE_CM / 100 / m.pixel_cm
    lines += [
        "",
        flow(f"""The printed difference, {gap:.2f} % on average, is {gap_px:.1f} px with the camera that is described;
            the coefficients printed for its lens do not move a point near its axis so far. Ours, by lens and view:"""),
        "",
    ]
    for lens in lenses:
        for method in ("Bézier", OWN):
            off, on = (errors(m.distortion[lens, undone], method) for undone in (False, True))
            lines.append(f"- {lens}, {method}: {_undoing(off, on)}.")
    lines += [
        "",
        flow("""Both cameras look at mid-span along their axes, where any lens is straight: the ends of the template are
            wrong there and its middle is not. The claim is one about where in the picture one measures; sagnode fits
            the whole curve, and so feels the lens."""),
        "",
    ]
    return "\n".join(lines)


def _undoing(off: Errors, on: Errors) -> str:
    """What undoing the distortion does to a method's errors."""
    if not off.told:
        return "nothing is told of the distorted picture"
    if off.mean_abs > 1.5 * on.mean_abs:
        return f"holds, {off.mean_abs:.2f} to {on.mean_abs:.2f} cm"
    return f"does not hold, {off.mean_abs:.2f} to {on.mean_abs:.2f} cm"


def _table_9(m: Measured) -> str:
    lines = [
        "### Table 9: the 110 kV field",
        "",
        "| method | measured | true | error |",
        "|---|---|---|---|",
    ]
    for method, (measured, true) in printed.TABLE_9.items():
        lines.append(f"| printed, {method} | {measured:.2f} m | {true:.2f} m | {measured - true:+.2f} m |")
    lines += ["", "Ours; clearance 6.39 m, error in metres:", ""]
    lines += [
        "| circumstances | method | told | mean | bias | worst | interval holds |",
        "|---|---|---|---|---|---|---|",
    ]
    for words, results in m.field.items():
        for method in METHODS:
            e = errors(results, method)
            worst = max(
                (abs(r.error_cm) for r in results if r.method == method and math.isfinite(r.error_cm)), default=0
            )
            lines.append(
                f"| {words} | {method} | {e.told} of {e.of} | {e.mean_abs / 100:.3f} | {e.bias / 100:+.3f}"
                f" | {worst / 100:.3f} | {100 * e.held:.0f} % |"
                if e.told
                else f"| {words} | {method} | 0 of {e.of} | | | | |"
            )
    lines += ["", *_field_verdicts(m), ""]
    return "\n".join(lines)


def _field_verdicts(m: Measured) -> list[str]:
    verdicts = []
    for words, results in m.field.items():
        bezier, cosh = (errors(results, method) for method in ("Bézier", "Method 2"))
        if not (bezier.told and cosh.told):
            continue
        low, high = bezier.bias < 0, cosh.bias > 0
        times = cosh.mean_abs / max(bezier.mean_abs, 1e-9)
        verdicts.append(
            "- "
            + flow(f"""{words}: "Bézier underestimates" {_yes(low)} ({bezier.bias / 100:+.2f} m), "hyperbolic cosine
                overestimates" {_yes(high)} ({cosh.bias / 100:+.2f} m), "Bézier is 2.2 times better" {_yes(times > 1.5)}
                ({times:.1f} times).""")
        )
    return verdicts


def _yes(holds: bool) -> str:
    return "holds" if holds else "does not hold"


def rows_of(results: Sequence[Result]) -> dict[str, Errors]:
    """Statistics by method."""
    return {method: errors(results, method) for method in METHODS}
