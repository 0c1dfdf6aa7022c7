"""Whole readings with the compiled kernels and without: what is told of a conductor does not depend on a compiler."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sagnode.native import kernels

SITE = Path(__file__).parents[2] / "src" / "sagnode" / "demo" / "site"
FRAMES = [SITE / "frames" / f"20260621T{hour}0000Z.jpg" for hour in ("02", "06", "12", "18")]
"""Night, a low sun, noon, and a warm evening."""
SHARE_OF_U = 0.01
"""So far values may be apart, in their standard uncertainties: where sums are rounded apart, iterations end apart."""


def readings(native):
    """Of the demonstration's frames, by a process of its own."""
    words = [sys.executable, "-m", "sagnode", "measure", *FRAMES, "--config", SITE, "--json"]
    environment = {**os.environ, "SAGNODE_NATIVE": native, "OPENBLAS_NUM_THREADS": "1"}
    said = subprocess.run([*map(str, words)], capture_output=True, text=True, env=environment, timeout=100, check=False)
    assert said.returncode in (0, 1), said.stderr
    return json.loads(said.stdout)["readings"]


@pytest.mark.skipif(kernels is None, reason="the extension was not built here")
def test_a_reading_is_the_same_without_the_compiled_kernels():
    compiled, plain = readings("1"), readings("0")
    assert len(compiled) == len(plain) == 3 * len(FRAMES)
    assert {one["quality"]["validity"] for one in plain} >= {"good", "invalid"}
    compared = 0
    for one, other in zip(compiled, plain, strict=True):
        assert one["conductor"] == other["conductor"]
        assert one["quality"]["validity"] == other["quality"]["validity"]
        causes = [[reason["cause"] for reason in reading["quality"]["reasons"]] for reading in (one, other)]
        assert causes[0] == causes[1]
        for name, u in other.items():
            if not name.endswith("_u") or u is None:
                continue
            stem = name.removesuffix("_u")
            (key,) = other.keys() & {stem, *(f"{stem}_{unit}" for unit in ("m", "deg", "n", "c"))}
            assert abs(one[key] - other[key]) <= SHARE_OF_U * u, (one["conductor"], key)
            assert one[name] == pytest.approx(u, rel=SHARE_OF_U), (one["conductor"], name)
            compared += 1
    assert compared > 50
