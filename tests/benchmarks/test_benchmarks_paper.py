"""What docs/paper.md is made of: trials that are the same for the same seed, statistics of known errors, the marks."""

import math
from dataclasses import replace

import numpy as np
import pytest

from paper import measuring, modes, report, scenes


def results(method, errors, held=True):
    return [measuring.Result(method, f"t{k}", e, 1.0, "good", held) for k, e in enumerate(errors)]


def test_statistics_of_known_errors():
    found = measuring.errors(results("Bézier", [1.0, -3.0, math.nan]), "Bézier")
    assert (found.told, found.of) == (2, 3)
    assert found.mean_abs == pytest.approx(2.0)
    assert found.bias == pytest.approx(-1.0)
    assert found.rms == pytest.approx(math.sqrt(5.0))
    assert found.sd == pytest.approx(math.sqrt(2.0))
    assert found.mean_abs_u == pytest.approx(1.0)
    assert measuring.errors(results("Bézier", [math.nan]), "Bézier").told == 0


def test_methods_are_compared_on_the_same_pictures():
    some = results("Method 2", [1.0, 2.0, -4.0]) + results("Bézier", [0.5, -1.5, math.nan])
    gap, u, pairs = measuring.difference(some, "Method 2", "Bézier")
    assert (gap, pairs) == (pytest.approx(0.5), 2)
    assert u == pytest.approx(0.0)


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    return list(scenes.lab_trials("lab", 2, tmp_path_factory.mktemp("lab"), same=True))


def test_the_same_seed_gives_the_same_trials(laboratory, tmp_path):
    again = next(scenes.lab_trials("lab", 1, tmp_path, same=True))
    assert np.array_equal(again.image, laboratory[0].image)
    assert again.truth == laboratory[0].truth
    # repeats differ in their noise only
    assert laboratory[1].truth == laboratory[0].truth
    assert not np.array_equal(laboratory[1].image, laboratory[0].image)


def test_every_method_tells_of_the_laboratory_and_only_sagnodes_interval_is_worth_its_name(laboratory):
    found = measuring.measure(laboratory[:1], replace(measuring.ON_THE_LINE, templates=90))
    assert [r.method for r in found] == ["Method 1", "Method 2", "Bézier", "sagnode"]
    assert all(abs(r.error_cm) < 1.5 for r in found)
    assert abs(found[-1].error_cm) < 0.1
    assert found[-1].held


def test_thin_edges_defeat_the_squared_differences(laboratory):
    prepared = modes.Prepared.of(laboratory[0], 60)
    rows = {row.mode: row for row in modes.compare_modes([prepared])}
    assert rows["TM_CCOEFF_NORMED"].near == 1
    assert rows["TM_SQDIFF"].near == 0
    on_a_neighbour, pictures, away = modes.free_sweep([prepared], 5)
    assert (pictures, len(away)) == (1, 1)
    assert on_a_neighbour in (0, 1)


def some_measurements():
    lab = [r for name in report.METHODS for r in results(name, [0.4, -0.3])]
    mode = [modes.ModeRow(m, 0.1, 0.2, 2, 2) for m in modes.MODES]
    stages = {"curve points": 0.1, "perspective": 0.1, "drawing": 0.1, "matching": 10.0, "search": 3.0}
    return report.Measured(
        command="the command",
        lab={(view, survey): lab for view in report.VIEW_NAMES for survey in ("exact", "surveyed")},
        repeats={"noise": lab, "worlds": lab},
        modes={"lab": mode, "lab45": mode},
        free=(1, 2, [61.0, 1.0]),
        timing={"Bézier": stages, "cosh with perspective": stages},
        distortion={("a lens", undone): lab for undone in (False, True)},
        field={"some field": lab, "nothing told": [replace(r, error_cm=math.nan) for r in lab]},
        pixel_cm=0.36,
    )


def test_the_tables_go_between_the_marks_and_nothing_else_is_touched(tmp_path):
    file = tmp_path / "paper.md"
    file.write_text(f"before\n{report.BEGIN}\nold\n{report.END}\nafter\n", encoding="utf-8")
    report.write(some_measurements(), file)
    text = file.read_text(encoding="utf-8")
    assert text.startswith(f"before\n{report.BEGIN}\nWritten by `the command`.")
    assert text.endswith(f"{report.END}\nafter\n")
    assert "\nold\n" not in text
    assert "| nothing told | Bézier | 0 of 2 | | | | |" in text
    report.write(some_measurements(), file)
    assert file.read_text(encoding="utf-8") == text


def test_a_document_without_marks_is_refused(tmp_path):
    file = tmp_path / "paper.md"
    file.write_text("no marks\n", encoding="utf-8")
    with pytest.raises(ValueError, match="has no lines"):
        report.write(some_measurements(), file)
