"""Why due readings were refused: which of them, and the same measured from the true curve."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

import missed
from sagnode.capture.port import GreyImage
from sagnode.estimate.matched import Matched
from sagnode.site import SiteConductor
from tally import OWN
from worlds import Shot

ROW = {"world": 0, "frame": 0, "method": OWN, "due": 1, "validity": "invalid", "sag_truth": 8.25}


SEED, TRUE_SAGS = 4, {"L1": 7.8576, "L3": 8.4489}
"""A world of the suite, and true sags in it, m."""


def test_what_was_due_and_refused_is_asked_about_and_nothing_else(tmp_path: Path) -> None:
    rows = [
        {**ROW, "group": "tower", "conductor": "L1"},
        {**ROW, "group": "tower", "conductor": "L2", "validity": "good"},
        {**ROW, "group": "tower", "conductor": "L3", "due": 0},
        {**ROW, "group": "tower", "conductor": "L1", "method": "paper-bezier, as printed"},
        {**ROW, "group": "fog", "conductor": "L2", "frame": 3},
    ]
    with (tmp_path / "table.csv").open("w", encoding="utf-8", newline="") as sink:
        writer = csv.DictWriter(sink, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    due, refused = missed.missed_in(tmp_path / "table.csv")
    assert due == {"tower": 2, "fog": 1}
    assert refused == {("tower", 0, 0): {"L1": 8.25}, ("fog", 0, 3): {"L2": 8.25}}


def test_what_a_search_lost_is_told_from_the_true_curve() -> None:
    frame, asked = ("tower", 0, 0), []
    from_truth = missed.told_by_truth

    def noted(shot: Shot) -> Callable[..., Matched | None]:
        find = from_truth(shot)

        def noting(image: GreyImage, conductor: SiteConductor, *rest: Any) -> Matched | None:
            asked.append((conductor.id, shot.moment.wires[conductor.id].sag_m, find(image, conductor, *rest)))
            return asked[-1][-1]

        return noting

    with patch.object(missed, "told_by_truth", noted):
        found = list(missed.again(frame, TRUE_SAGS, seed=SEED))
    assert [(each.told, each.off, each.cause) for each in found] == [(True, False, "")] * 2
    assert {name for name, _, _ in asked} >= {"L1", "L2", "L3"}
    for _, sag, match in asked:
        assert match is not None
        assert abs(match.sag[0] - sag) < 4 * match.sag[1]


def test_a_table_of_another_seed_is_not_answered() -> None:
    with pytest.raises(missed.OtherWorldError, match="give the seed"):
        list(missed.again(("tower", 0, 0), TRUE_SAGS, seed=SEED + 1))


def test_the_table_counts_by_group_and_together() -> None:
    some = [
        missed.Again("tower", told=True, off=False, cause=""),
        missed.Again("fog", told=False, off=False, cause="ambiguous"),
        missed.Again("fog", told=False, off=False, cause="ambiguous"),
    ]
    lines = missed.table(Counter({"tower": 9, "fog": 4, "night": 2}), some)
    assert lines[2:] == [
        "| tower | 9 | 1 | 1 | 0 |  |",
        "| fog | 4 | 2 | 0 | 0 | ambiguous 2 |",
        "| all groups | 15 | 3 | 1 | 0 | ambiguous 2 |",
    ]
