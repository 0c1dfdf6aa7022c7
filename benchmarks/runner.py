"""Draws worlds, renders their frames, measures them by the public pipeline and puts every reading beside its truth."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import cv2

from groups import groups_by_name
from limit import limits
from paper import by_paper
from sagnode.measurement import FrameMeasurement
from sagnode.pipeline import load_site, measure_burst
from sagnode.scene.render import render
from sagnode.scene.truth import true_quantities
from sagnode.site import Site
from tally import Outcome, outcome
from worlds import Setting, Shot, settle

SEEN = ("visible_share", "clear_share", "snr")
"""What the renderer says of a conductor that is kept with its outcome."""


@dataclass(frozen=True)
class Task:
    """One world to be drawn, rendered and measured."""

    group: str
    seed: int
    index: int
    paper: bool = False


def tasks(names: str | None, seed: int, worlds: int | None, *, paper: bool = True) -> list[Task]:
    """The worlds of some groups (comma-separated; all by default), as many as each has or ``worlds`` at most."""
    return [
        Task(group.name, seed, index, paper and index < group.paper)
        for group in groups_by_name(names)
        for index in range(group.worlds if worlds is None else min(worlds, group.worlds))
    ]


def run(some: list[Task], jobs: int) -> Iterator[list[Outcome]]:
    """Outcomes of every task, in the tasks' order, whatever the number of processes."""
    if jobs == 1:
        yield from map(run_task, some)
        return
    # spawned, since a fork does not survive the threads that OpenCV has started here
    with ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run_task, some)


def run_task(task: Task) -> list[Outcome]:
    """Draw one world and measure its frames."""
    cv2.setNumThreads(1)
    group = groups_by_name(task.group)[0]
    with tempfile.TemporaryDirectory(prefix="sagnode-bench-") as folder:
        setting = settle(group, task.seed, task.index, Path(folder))
        site = load_site(setting.survey)
        results: list[Outcome] = []
        try:
            for number, shot in enumerate(group.shots(setting)):
                results += measure_shot(setting, site, shot, task, number)[1]
        except Exception as error:
            error.add_note(f"in {task}")
            raise
    return results


def measure_shot(
    setting: Setting, site: Site, shot: Shot, task: Task, number: int
) -> tuple[list[FrameMeasurement], list[Outcome]]:
    """Render and measure one frame: the node's own measurements, and the outcomes of all methods."""
    scene, moment = shot.scene, shot.moment
    rendered = render(scene, moment)
    own = list(measure_burst(site, [rendered.image]))
    by_method: list[tuple[str | None, FrameMeasurement]] = [(None, m) for m in own]
    if task.paper:
        by_method += by_paper(setting.survey, rendered.image)
    conductors = {c.id: c for c in scene.true.conductors}
    views = rendered.truth["conductors"]
    bounds = {} if shot.unseen is not None else limits(site, scene, moment, rendered.seen)
    outcomes = []
    for method, measured in by_method:
        name = measured.conductor
        if shot.unseen is not None and name not in shot.unseen:
            continue
        there = shot.unseen is None
        outcomes.append(
            outcome(
                measured,
                group=task.group,
                world=task.index,
                frame=number,
                kind=shot.kind,
                method=method,
                truth=true_quantities(scene.true, conductors[name], moment.wires[name]) if there else {},
                limit=bounds.get(name, {}),
                seen={key: views[name][key] for key in SEEN} if there else {},
                fair=shot.fair,
            )
        )
    return own, outcomes
