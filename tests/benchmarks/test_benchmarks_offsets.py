"""Errors of the offsets across the wire: what neighbours share is found in drawn errors, and nothing in white ones."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import offsets


def test_errors_are_offsets_from_the_true_curve_along_the_normal() -> None:
    truth = np.column_stack([np.linspace(0, 100, 2001), np.full(2001, 50.0)])
    measured = np.array([[20.0, 50.3], [60.0, 49.8], [160.0, 50.0]])
    seen = SimpleNamespace(
        t=np.array([0.2, 0.6, 1.6]),
        arc=np.array([20.0, 60.0, 160.0]),
        normal=np.tile([0.0, 1.0], (3, 1)),
        measured=measured,
        sigma=np.full(3, 0.1),
        shared_px=0.02,
    )
    found = offsets.errors_of(SimpleNamespace(offsets=seen), truth)
    # the third lies beside the end of what is true
    assert found.error == pytest.approx([0.3, -0.2])
    assert found.arc == pytest.approx([20.0, 60.0])
    assert found.shared_px == 0.02


@pytest.mark.parametrize("together", [0.0, 0.08])
def test_what_neighbours_share_is_found(together: float) -> None:
    rng = np.random.default_rng(1)
    arc = np.arange(0.0, 800.0, 8.0)
    covariance = together**2 * np.exp(-np.abs(arc[:, None] - arc[None]) / 60.0) + 0.05**2 * np.eye(len(arc))
    draws = np.linalg.cholesky(covariance) @ rng.standard_normal((len(arc), 400))
    some = [offsets.Errors(one, arc, np.full(len(arc), 0.05), together) for one in draws.T]
    found = offsets.shared(some)
    middles = [(low + high) / 2 for low, high in pairwise(offsets.LAGS_PX)]
    assert found == pytest.approx([together**2 * np.exp(-lag / 60.0) for lag in middles], abs=4e-4)
