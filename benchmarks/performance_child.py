"""Peak memory of one method on one picture, in a process of its own.

python benchmarks/performance_child.py (literal|anchored|reading|burst) NODE.TOML; prints JSON
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import cv2

from performance_frames import Shot
from performance_methods import Anchored, Literal
from performance_process import forget_peak, peak_kb, resident_kb
from sagnode.capture.images import read_grey
from sagnode.config.load import load_node
from sagnode.pipeline import load_site, measure_burst

FEW = 3
"""Templates; more of them, one after the other, take no more memory."""


def main() -> None:
    method, path = sys.argv[1], Path(sys.argv[2])
    cv2.setNumThreads(1)
    loaded = load_node(path)
    assert loaded.node.camera.replay is not None
    jpeg = Path(loaded.node.camera.replay.path)
    shot = Shot("child", "", loaded.span, load_site(loaded.span), read_grey(jpeg), jpeg, {})
    call = {
        "literal": lambda: Literal(shot, "Bézier", FEW)(),
        "anchored": lambda: Anchored(shot, 300)(),
        "reading": lambda: measure_burst(shot.site, [shot.image]),
        "burst": lambda: measure_burst(shot.site, [shot.image.copy() for _ in range(8)]),
    }[method]
    before = resident_kb(os.getpid())
    forget_peak(os.getpid())
    call()
    print(json.dumps({"before_kb": before, "peak_kb": peak_kb(os.getpid())}))


if __name__ == "__main__":
    main()
