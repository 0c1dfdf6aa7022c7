"""The picture of ``docs/paper.md``: figure 4 again, and the errors of all methods."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from paper.measuring import OWN, PAPER_METHODS
from paper.modes import Prepared
from paper.report import VIEW_NAMES, Measured, rows_of
from sagnode.reference.matching import MODES

METHODS = (*PAPER_METHODS, OWN)


def draw(measured: Measured, prepared: Prepared, file: Path) -> None:
    """Scores of the six modes over the library of one picture; mean error of every method in every circumstance."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(12.5, 6), constrained_layout=True)
    for number, mode in enumerate(MODES):
        sags, scores = prepared.curve(mode)
        spread = float(np.ptp(scores)) or 1.0
        level = -1.3 * number
        left.plot(100 * sags, (scores - scores.min()) / spread + level, lw=1)
        left.text(100 * sags[0], level + 1.02, mode, fontsize=8, va="bottom")
    truth = 100 * prepared.trial.truth["midspan_sag"]
    left.axvline(truth, color="k", lw=0.8, ls=":")
    left.set(xlabel=f"sag of the template, cm (dotted: true, {truth:.1f} cm)", yticks=[])
    left.set(title="Figure 4: score over the library, each to its own scale")
    groups = {f"laboratory {VIEW_NAMES[view]}, {survey}": rows_of(r) for (view, survey), r in measured.lab.items()}
    groups |= {f"field, {words}": rows_of(results) for words, results in measured.field.items()}
    width = 0.8 / len(METHODS)
    for number, method in enumerate(METHODS):
        places = np.arange(len(groups)) + (number - (len(METHODS) - 1) / 2) * width
        right.bar(places, [rows[method].mean_abs for rows in groups.values()], width, label=method)
    right.set_yscale("log")
    right.axhline(measured.pixel_cm, color="k", lw=0.8, ls=":", label="1 px in the laboratory")
    right.set_xticks(np.arange(len(groups)), list(groups), fontsize=7.5, rotation=22, ha="right")
    right.set(ylabel="mean error of the clearance, cm", title="Errors (no bar: the method told nothing)")
    right.legend(fontsize=7)
    right.grid(alpha=0.3, axis="y", which="both")
    figure.savefig(file, dpi=95)
    plt.close(figure)
