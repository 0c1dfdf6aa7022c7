"""Many worlds: the honest coverage, and what must not be told."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import cv2

from paper import by_paper
from sagnode.pipeline import load_site, measure_burst
from sagnode.scene.render import render
from sagnode.scene.spec import Moment
from sagnode.scene.truth import true_quantities
from sagnode.site import Site
from tally import Outcome, outcome
from worlds import GROUPS, NEGATIVES, Group, Setting, any_moment, negative, settle

DEAR = 0.1
"""Groups with no more than this share have frames too large for the negatives too."""


@dataclass(frozen=True)
class Task:
    """One world to be drawn, rendered and measured."""

    group: Group
    seed: int
    index: int
    frames: int
    kinds: tuple[str, ...] = ()
    """Negatives to be rendered in place of plain frames."""


def positive_tasks(worlds: int, seed: int, frames: int, views: Sequence[str]) -> list[Task]:
    """Tasks of these groups; each group gets its share of the worlds."""
    return [
        Task(group, seed, index, frames)
        for group in GROUPS
        if group.name in views
        for index in range(max(2, round(worlds * group.share)))
    ]


def negative_tasks(worlds: int, seed: int, views: Sequence[str]) -> list[Task]:
    """Every kind of negative in worlds of their own, for every group but the dear ones."""
    kinds = tuple(NEGATIVES)
    tasks = []
    for group in (g for g in GROUPS if g.name in views and g.share > DEAR):
        count = max(1, round(worlds * group.share / 10))
        chosen = kinds if group.outdoors else tuple(k for k in kinds if k not in {"dense fog", "night"})
        tasks += [Task(group, seed + 1000, index, 0, chosen) for index in range(count)]
    return tasks


def run(tasks: list[Task], jobs: int) -> Iterator[list[Outcome]]:
    """Outcomes of every task, in the tasks' order, whatever the number of processes."""
    # spawned, since a fork does not survive the threads that OpenCV has started here
    with ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run_task, tasks)


def run_task(task: Task) -> list[Outcome]:
    """Draw one world and measure its frames."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory(prefix="sagnode-bench-") as folder:
        setting = settle(task.group, task.seed, task.index, Path(folder))
        site = load_site(setting.survey)
        results = []
        for number in range(task.frames):
            moment = any_moment(task.group, setting)
            results += _measure(site, setting, moment, task, f"{task.group.name}-{task.index}.{number}")
        for kind in task.kinds:
            moment, concerned = negative(kind, setting, any_moment(task.group, setting))
            name = f"{task.group.name}-{task.index}.{kind}"
            measured = _measure(site, setting, moment, task, name, f"{task.group.name}: {kind}")
            results += [o for o in measured if o.conductor in concerned]
    return results


def _measure(
    site: Site, setting: Setting, moment: Moment, task: Task, name: str, group: str | None = None
) -> list[Outcome]:
    image = render(setting.scene, moment).image
    true = setting.scene.true
    truth = {c.id: true_quantities(true, c, moment.wires[c.id]) for c in true.conductors if c.id in moment.wires}
    measured = [(None, m) for m in measure_burst(site, [image])]
    if task.group.paper and group is None:
        measured += by_paper(setting.survey, image)
    return [
        outcome(group or task.group.name, name, task.index, m, {} if group else truth[m.conductor], label)
        for label, m in measured
    ]
