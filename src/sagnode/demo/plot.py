"""The plot of the day: sag and clearance of every conductor with their 95 % bands, against the simulated truth."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC
from pathlib import Path
from typing import Any

from sagnode.demo.results import Point
from sagnode.errors import SagnodeError
from sagnode.quality import Validity

_COLOURS = {Validity.GOOD: "#1b6ca8", Validity.QUESTIONABLE: "#d98a1f"}
_TRUTH = "#222222"
_INVALID = "#c23b3b"


def plot_day(points: Sequence[Point], title: str, path: Path) -> None:
    """Draw one column per conductor: sag above, clearance below.

    Args:
        points: readings with their truth, in the order of time.
        title: above everything.
        path: PNG file to write.

    Raises:
        SagnodeError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        import matplotlib as mpl
    except ModuleNotFoundError as error:
        raise SagnodeError("the plot needs matplotlib", 'pip install "sagnode[demo]"') from error
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    conductors = sorted({point.reading.conductor for point in points})
    figure, axes = plt.subplots(
        2, len(conductors), figsize=(4.6 * len(conductors) + 0.8, 6.6), sharex=True, squeeze=False
    )
    for column, conductor in enumerate(conductors):
        own = [point for point in points if point.reading.conductor == conductor]
        for row, stem in enumerate(("sag", "clearance")):
            _panel(axes[row][column], own, stem)
        axes[0][column].set_title(conductor, fontsize=11)
    axes[0][0].set_ylabel("sag, m")
    axes[1][0].set_ylabel("clearance, m")
    _finish(figure, axes, title)
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise SagnodeError(f"{path}: {error.strerror}", "choose another --out") from error
    finally:
        plt.close(figure)


def _panel(axis: Any, points: list[Point], stem: str) -> None:
    true = [(point.time, getattr(point.truth, stem)) for point in points if point.truth is not None]
    if true:
        axis.plot(*zip(*true, strict=True), color=_TRUTH, linewidth=1.2, label="truth", zorder=3)
    for validity, colour in _COLOURS.items():
        seen = [(p.time, e) for p in points if p.validity is validity and (e := p.estimate(stem)) is not None]
        if seen:
            values = [e.value for _, e in seen]
            reach = ([e.value - e.lo for _, e in seen], [e.hi - e.value for _, e in seen])
            axis.errorbar(
                [time for time, _ in seen],
                values,
                yerr=reach,
                fmt="o",
                markersize=3.5,
                color=colour,
                ecolor=colour,
                elinewidth=3,
                alpha=0.75,
                label=f"{validity}, 95 %",
                zorder=2,
            )
    refused = [point.time for point in points if point.validity is Validity.INVALID]
    if refused:
        # On the lower edge, in the axis's own height: an invalid reading has no value to be drawn at.
        axis.plot(
            refused,
            [0.02] * len(refused),
            "|",
            color=_INVALID,
            markersize=9,
            markeredgewidth=1.6,
            transform=axis.get_xaxis_transform(),
            label="invalid (no value)",
            clip_on=False,
        )
    axis.grid(color="#dddddd", linewidth=0.6)
    axis.set_axisbelow(True)


def _finish(figure: Any, axes: Any, title: str) -> None:
    from matplotlib import dates

    for axis in axes[-1]:
        locator = dates.AutoDateLocator(minticks=3, maxticks=9, tz=UTC)  # type: ignore[no-untyped-call]
        axis.xaxis.set_major_locator(locator)
        axis.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator, tz=UTC))  # type: ignore[no-untyped-call]
        axis.set_xlabel("UTC")
    named: dict[str, Any] = {}
    for axis in axes.flat:
        named |= {name: handle for handle, name in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.suptitle(title, fontsize=12)
    figure.legend(named.values(), named.keys(), loc="lower center", ncols=len(named) or 1, frameon=False)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
