"""Tables 6 and 7: what a template costs, and a whole search, on the laboratory's 960x540 picture."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from paper.scenes import Trial
from performance.frames import Shot
from performance.methods import POINTS, Literal
from sagnode.geometry.camera import project
from sagnode.geometry.conductor import conductor_points, sag_profile
from sagnode.pipeline import load_site
from sagnode.reference.bezier import bezier_points

REPEATS = 400
RUNS = 3
"""Of which the least counts, stage by stage."""


def timing(trial: Trial, templates: int) -> dict[str, dict[str, float]]:
    """CPU ms for each template by method and stage, and ``search``: a whole search with 300 templates, s.

    Args:
        trial: a picture of the laboratory.
        templates: how many of the library to run; times are for one, or multiplied up to 300.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        shot = Shot(trial.name, "", trial.span, load_site(trial.span), trial.image, Path(), {})
        return {
            method: _stages(Literal(shot, method, templates), method) for method in ("Bézier", "cosh with perspective")
        }
    finally:
        cv2.setNumThreads(threads)


def _stages(literal: Literal, method: str) -> dict[str, float]:
    runs = []
    for _ in range(RUNS):
        literal()
        runs.append(literal.spent)
    spent = {stage: 1e3 * min(run[stage] for run in runs) / literal.templates for stage in runs[0]}
    scene = literal.scene
    sag = float(scene.sags[len(scene.sags) // 2])
    if method == "Bézier":
        control = literal.controls[len(literal.controls) // 2]
        points, perspective = _each_ms(lambda: bezier_points(control, POINTS)), 0.0
    else:
        span = float(np.hypot(*(scene.far - scene.near)[:2]))
        space = conductor_points(scene.near, scene.far, sag, 0.0, POINTS)
        points = _each_ms(lambda: sag_profile(span, 0.0, sag, POINTS))
        perspective = _each_ms(lambda: project(scene.intrinsics, scene.pose, space))
    running = spent["curve points"] + spent["draw"] + spent["matchTemplate"]
    once = 1e-3 * literal.templates * (spent["undistort"] + spent["edges"])
    return {
        "curve points": points,
        "perspective": perspective,
        "drawing": spent["draw"],
        "matching": spent["matchTemplate"],
        "search": once + 0.3 * running,
    }


def _each_ms(call: Callable[[], object]) -> float:
    call()
    began = time.process_time()
    for _ in range(REPEATS):
        call()
    return 1e3 * (time.process_time() - began) / REPEATS
