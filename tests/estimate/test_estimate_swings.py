"""What the swings of a span say about its loads, against sums over drawn winds and loads."""

import numpy as np
import pytest

from sagnode.estimate.swings import (
    ICED_THEN,
    ICY_READINGS,
    SPREAD,
    WEIGHTED,
    Explanation,
    expected_swing,
    explanation,
    uneven_probabilities,
)

PRIOR_U = np.radians(8.0)


def degrees(log_evidence: float, swing: float, swing_u: float) -> Explanation:
    return Explanation(log_evidence, np.radians(swing), np.radians(swing_u) ** 2)


def likelihood(explained: Explanation, swing: np.ndarray) -> np.ndarray:
    """Evidence of an explanation at a swing: such that its mean over the prior is the evidence stated."""
    shape = np.exp(-0.5 * (swing - explained.swing) ** 2 / explained.variance)
    over_prior = PRIOR_U**2 + explained.variance
    mean = np.sqrt(explained.variance / over_prior) * np.exp(-0.5 * explained.swing**2 / over_prior)
    return np.exp(explained.log_evidence) * shape / mean


def summed_probabilities(pairs: list[tuple[Explanation, Explanation]]) -> np.ndarray:
    """The same for two conductors by brute force: a sum over winds, both swings, both loads, iced readings or not."""
    wind = np.radians(np.linspace(-25.0, 25.0, 201))[:, None, None]
    first, second = wind[:, 0, 0][None, :, None], wind[:, 0, 0][None, None, :]
    spread = np.hypot(SPREAD[0], SPREAD[1] * wind)
    density = np.exp(-0.5 * (wind / PRIOR_U) ** 2 - 0.5 * ((first - wind) ** 2 + (second - wind) ** 2) / spread**2)
    density = density / spread**2
    total, uneven = 0.0, np.zeros(2)
    for share, each in ((ICY_READINGS, ICED_THEN), (1 - ICY_READINGS, WEIGHTED)):
        for loads in ((0, 0), (0, 1), (1, 0), (1, 1)):
            usual = share * np.prod([each if load else 1 - each for load in loads])
            seen = likelihood(pairs[0][loads[0]], first) * likelihood(pairs[1][loads[1]], second)
            weight = float(usual * np.sum(density * seen))
            total += weight
            uneven += weight * np.array(loads)
    return uneven / total


def test_a_likelihood_is_the_posterior_without_its_prior() -> None:
    # 3 ± 1 seen under a prior 0 ± 2: the product has precision 1 + 1/4 and its mean at 3 / (5/4)
    precision = 1 + 1 / 4
    seen = explanation(0.0, 3 / precision, precision**-0.5, 2.0)
    assert seen.swing == pytest.approx(3.0)
    assert seen.variance == pytest.approx(1.0)


@pytest.mark.parametrize("swings", [(3.5, 3.4), (3.5, 0.8), (14.0, 17.0), (-2.0, 4.0)])
def test_probabilities_are_those_of_a_sum_over_winds_and_loads(swings: tuple[float, ...]) -> None:
    pairs = [(degrees(0.0, swing, 0.5), degrees(-2.0, swing - 1.0, 2.0)) for swing in swings]
    assert uneven_probabilities([([even], [uneven]) for even, uneven in pairs], PRIOR_U) == pytest.approx(
        list(summed_probabilities(pairs)), rel=0.02
    )


def test_swings_that_agree_speak_for_even_loads_and_swings_that_part_against() -> None:
    def probabilities(*swings: float) -> list[float]:
        return uneven_probabilities(
            [([degrees(0.0, s, 0.1)], [degrees(-6.0, s, 1.3)]) for s in swings],
            PRIOR_U,
        )

    assert max(probabilities(2.0, 2.2, 1.9)) < 1e-4
    assert max(probabilities(3.5, 1.4, -1.2)) > 0.9


def test_one_conductor_alone_has_its_own_odds_and_what_is_usual() -> None:
    (probability,) = uneven_probabilities([([degrees(0.0, 1.0, 0.2)], [degrees(0.0, 1.0, 0.2)])], PRIOR_U)
    assert probability == pytest.approx(ICY_READINGS * ICED_THEN + (1 - ICY_READINGS) * WEIGHTED, rel=1e-6)


def test_a_swing_is_expected_where_the_others_are() -> None:
    mean, u = expected_swing([[degrees(0.0, 3.0, 0.1)], [degrees(0.0, 3.4, 0.1)]], PRIOR_U)
    assert np.degrees(mean) == pytest.approx(3.2, abs=0.1)
    # their spread about the wind, halved by there being two of them, and this conductor's own
    spread = np.hypot(np.degrees(SPREAD[0]), SPREAD[1] * 3.2)
    # a little more, since one of them may be wrong
    assert 1.0 < np.degrees(u) / (spread * np.sqrt(1.5)) < 1.3


def test_one_that_was_followed_astray_does_not_drag_the_others_there() -> None:
    others = [[degrees(0.0, 8.0, 1.8)], [degrees(0.0, 0.0, 0.3)]]
    mean, u = expected_swing(others, PRIOR_U)
    assert abs(np.degrees(mean) - 8.0) < 3 * np.degrees(u)
    assert abs(np.degrees(mean)) < 3 * np.degrees(u)
    # and of three, the two that agree prevail
    mean, u = expected_swing([[degrees(0.0, 10.0, 0.5)], [degrees(0.0, 10.6, 0.5)], [degrees(0.0, 0.0, 0.5)]], PRIOR_U)
    assert abs(np.degrees(mean) - 10.3) < 1.0


def test_without_others_nothing_is_expected_but_the_survey() -> None:
    mean, u = expected_swing([], PRIOR_U)
    assert mean == pytest.approx(0.0, abs=1e-9)
    assert u == pytest.approx(np.hypot(PRIOR_U, np.hypot(SPREAD[0], SPREAD[1] * PRIOR_U)), rel=0.02)


def test_the_wider_of_two_loads_speaks_where_the_swings_ask_for_it() -> None:
    light, heavy = degrees(-2.0, -4.0, 0.5), degrees(-5.0, -4.0, 2.0)
    others = [([degrees(0.0, swing, 0.1)], [degrees(-3.0, swing, 0.5)]) for swing in (-9.6, -8.2)]
    (alone, *_), (both, *_) = (
        uneven_probabilities([([degrees(0.0, -4.0, 0.1)], uneven), *others], PRIOR_U)
        for uneven in ([light], [light, heavy])
    )
    assert both > 2 * alone
