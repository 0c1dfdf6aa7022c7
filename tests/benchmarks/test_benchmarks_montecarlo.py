"""The Monte Carlo check of the node's propagation: it finds what is wrong, and nothing wrong in the laboratory."""

from __future__ import annotations

import numpy as np
import pytest

import montecarlo
from sagnode.message import Estimate


def trials(stated: float, drawn: float, count: int = 4000) -> list:
    errors = drawn * np.random.default_rng(1).standard_normal(count)
    return [
        montecarlo.Trial({"sag": Estimate(8 + e, stated, 8 + e - 1.96 * stated, 8 + e + 1.96 * stated)}, {"sag": 8.0})
        for e in errors
    ]


def test_an_honest_uncertainty_agrees() -> None:
    (line,) = montecarlo.compare("v", trials(0.02, 0.02))
    assert line.agrees
    assert line.coverage == pytest.approx(0.95, abs=0.01)
    assert line.interval == pytest.approx((-1.0, 1.0), abs=0.06)


@pytest.mark.parametrize("stated", [0.016, 0.025])
def test_an_uncertainty_that_is_a_quarter_off_does_not(stated: float) -> None:
    (line,) = montecarlo.compare("v", trials(stated, 0.02))
    assert not line.agrees
    assert "differ" in montecarlo.page([line], "command")
    assert "v sag" in montecarlo.page([line], "command")


def test_drawn_errors_of_the_laboratory_are_as_large_as_the_node_says() -> None:
    design = montecarlo.observe_view("lab", 3)
    assert design is not None
    rng = np.random.default_rng(6)
    lines = {line.stem: line for line in montecarlo.compare("lab", [montecarlo.draw(design, rng) for _ in range(100)])}
    assert lines.keys() >= {"sag", "swing", "clearance"}
    # 100 draws leave 7 % of standard error
    assert lines["sag"].stated_u / lines["sag"].drawn_u == pytest.approx(1.0, abs=0.3)
    assert abs(lines["sag"].bias) < 0.5 * lines["sag"].stated_u
