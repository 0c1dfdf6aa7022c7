"""One method on one picture in a process of its own: its peak memory, or again and again to be looked at.

python benchmarks/performance/child.py (literal|anchored|reading|burst|repeat|timed) NODE.TOML; prints JSON
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the folder of this package

import cv2

from performance.frames import Shot
from performance.methods import Anchored, Literal
from performance.process import forget_peak, peak_kb, resident_kb
from sagnode.capture.images import read_grey
from sagnode.config.load import load_node
from sagnode.native import kernels
from sagnode.pipeline import load_site, measure_burst, measure_frame

FEW = 3
"""Templates; more of them, one after the other, take no more memory."""
ROUNDS = 5
REPEAT_S = 12.0
"""CPU seconds; at some hundred looks a second thousands of them."""


def main() -> None:
    method, path = sys.argv[1], Path(sys.argv[2])
    cv2.setNumThreads(1)
    loaded = load_node(path)
    assert loaded.node.camera.replay is not None
    jpeg = Path(loaded.node.camera.replay.path)
    shot = Shot("child", "", loaded.span, load_site(loaded.span), read_grey(jpeg), jpeg, {})
    if method in {"repeat", "timed"}:
        _repeat(shot) if method == "repeat" else _timed(shot)
        return
    call = {
        "literal": lambda: Literal(shot, "Bézier", FEW)(),
        "anchored": lambda: Anchored(shot, 300)(),
        "reading": lambda: measure_burst(shot.site, [shot.image]),
        "burst": lambda: measure_burst(shot.site, (shot.image.copy() for _ in range(8))),
    }[method]
    before = resident_kb(os.getpid())
    forget_peak(os.getpid())
    call()
    print(json.dumps({"before_kb": before, "peak_kb": peak_kb(os.getpid())}))


def _timed(shot: Shot) -> None:
    measured = measure_frame(shot.site, shot.image)
    spent = []
    for _ in range(ROUNDS):
        began = time.process_time()
        measure_frame(shot.site, shot.image)
        spent.append(time.process_time() - began)
    sags = {m.conductor: m.estimates.get("sag") for m in measured}
    told = {name: None if sag is None else (sag.value, sag.u) for name, sag in sags.items()}
    print(json.dumps({"compiled": kernels is not None, "cpu_s": min(spent), "sags": told}))


def _repeat(shot: Shot) -> None:
    began = time.process_time()
    while time.process_time() - began < REPEAT_S:
        measure_frame(shot.site, shot.image)


if __name__ == "__main__":
    main()
