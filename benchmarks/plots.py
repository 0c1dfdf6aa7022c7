"""Plots of the suite: errors over their stated uncertainty, errors by group, coverage by group."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from groups import GROUPS
from tally import JUDGED, OWN, Outcome, coverage_by_chance

SEQUENCES = {group.name for group in GROUPS if group.sequence}


def write_plots(outcomes: Sequence[Outcome], folder: Path) -> list[Path]:
    """Write ``accuracy.png``, ``accuracy-errors.png`` and ``accuracy-coverage.png``; returns their paths."""
    mpl.use("Agg")
    own = [o for o in outcomes if o.method == OWN and o.truth]
    by_group = {group.name: [o for o in own if o.group == group.name and o.told] for group in GROUPS}
    by_group = {name: some for name, some in by_group.items() if some}
    if not by_group:
        return []
    return [
        _standardised(by_group, folder / "accuracy.png"),
        _errors(by_group, folder / "accuracy-errors.png"),
        _coverage(by_group, folder / "accuracy-coverage.png"),
    ]


def _standardised(by_group: dict[str, list[Outcome]], file: Path) -> Path:
    """Errors over stated standard uncertainty beside the normal distribution; sequences tell the same error often."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained", sharey=True)
    grid = np.linspace(-6, 6, 241)
    for axis, stem in zip(axes, JUDGED, strict=True):
        z = [o.z(stem) for name, some in by_group.items() if name not in SEQUENCES for o in some if stem in o.estimates]
        axis.hist(np.clip(z, -6, 6), bins=48, range=(-6, 6), density=True, color="0.75", label=f"{len(z)} readings")
        axis.plot(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), color="C3", lw=1.2, label="as stated")
        axis.set(xlabel="error / stated standard uncertainty", title=stem, xlim=(-6, 6))
        axis.legend(frameon=False)
    axes[0].set_ylabel("density")
    figure.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(figure)
    return file


def _errors(by_group: dict[str, list[Outcome]], file: Path) -> Path:
    """Every error of sag, in per cent of it, by group."""
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(9, 1.2 + 0.27 * len(by_group)), layout="constrained")
    rng = np.random.default_rng(0)
    for row, some in enumerate(by_group.values()):
        errors = np.array([100 * o.error("sag") / o.truth["sag"] for o in some])
        held = np.array([o.covered("sag") for o in some])
        place = row + rng.uniform(-0.3, 0.3, len(errors))
        axis.plot(errors[held], place[held], ".", ms=3.5, color="C0", alpha=0.7)
        axis.plot(errors[~held], place[~held], ".", ms=4.5, color="C3")
    axis.plot([], [], ".", color="C0", label="interval holds the truth")
    axis.plot([], [], ".", color="C3", label="it does not")
    axis.set_xscale("symlog", linthresh=1)
    reach = max(1.0, max(abs(100 * o.error("sag") / o.truth["sag"]) for some in by_group.values() for o in some))
    ticks = [x for x in (0, 0.5, 1, 2, 5, 10, 20, 50, 100, 200) if x <= 1.3 * reach]
    axis.set_xticks([-x for x in ticks[:0:-1]] + ticks)
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_locator(NullLocator())
    axis.axvline(0, color="0.6", lw=0.8)
    axis.grid(axis="x", color="0.9")
    axis.set(xlabel="error of sag, % of it (logarithmic beyond 1 %)")
    _rows(axis, by_group)
    figure.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(figure)
    return file


def _rows(axis: Axes, by_group: dict[str, list[Outcome]]) -> None:
    """Names of the groups, the first above, and the legend over all of them."""
    axis.set_yticks(range(len(by_group)), list(by_group))
    axis.set_ylim(len(by_group) - 0.4, -0.6)
    axis.legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)


def _coverage(by_group: dict[str, list[Outcome]], file: Path) -> Path:
    """Share of 95 % intervals that hold the truth, with what chance moves it."""
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(9, 1.2 + 0.27 * len(by_group)), layout="constrained")
    axis.axvspan(93, 98, color="C2", alpha=0.15, label="wanted: 93 to 98 %")
    for row, some in enumerate(by_group.values()):
        chance = 100 * coverage_by_chance(len({o.world for o in some}))
        axis.plot([95 - chance, min(95 + chance, 100)], [row, row], color="0.8", lw=5, solid_capstyle="butt")
        for stem, place, colour in (("sag", row - 0.15, "C0"), ("clearance", row + 0.15, "C1")):
            held = [o.covered(stem) for o in some if stem in o.estimates]
            axis.plot(100 * np.mean(held), place, "o", ms=4.5, color=colour, label=stem if row == 0 else None)
        axis.text(1.01, row, f"{len(some)}", va="center", fontsize=8, transform=axis.get_yaxis_transform())
    lowest = min(np.mean([o.covered(s) for o in some]) for some in by_group.values() for s in JUDGED)
    axis.set(
        xlabel="95 % interval holds the truth, % (grey: a true 95 % by chance)", xlim=(min(100 * lowest - 2, 78), 101)
    )
    _rows(axis, by_group)
    figure.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(figure)
    return file
