"""What is timed, one case a test; pytest-benchmark is the clock. Run by ``python benchmarks/performance/run.py``.

All cases run in one process on the same pictures, one thread, and count CPU seconds of that process, so that ratios
between them hold even where other programs share the machine. (pyperf would give every case processes of its own.)
"""

from __future__ import annotations

import time

import cv2
import pytest

from performance import plan as plans
from performance.frames import NAMES, scaled_tower, shot
from performance.methods import LITERAL, Anchored, Literal, Own
from performance.node import write_node
from performance.stages import bound, clocked
from sagnode.capture import open_source
from sagnode.capture.images import read_grey
from sagnode.pipeline import load_site, measure_burst, measure_frame
from sagnode.worker.protocol import MeasureRequest

PLAN = plans.current()
pytestmark = pytest.mark.benchmark(timer=time.process_time, disable_gc=True, warmup=False)


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """OpenCV on one thread, as the ratios are stated."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


def timed(benchmark, call, *, rounds=None, warm=1, **about):
    """Run a case and note what it is; returns the last result."""
    result = benchmark.pedantic(call, rounds=rounds or PLAN.rounds, iterations=1, warmup_rounds=warm)
    benchmark.extra_info.update(about)
    return result


def staged(call):
    """CPU time and calls of each stage: of the least disturbed of some runs."""
    runs = []
    for _ in range(PLAN.rounds):
        with clocked() as spent:
            began = time.process_time()
            call()
            runs.append((time.process_time() - began, spent))
    total, least = min(runs, key=lambda run: run[0])
    return {"spent": least.seconds, "calls": least.calls, "staged_s": total}


def told(measured, truth):
    """Validity, and the error of the sag where one is told."""
    sag = measured.estimates.get("sag")
    error = None if sag is None else (sag.value - truth[measured.conductor]["sag"]) / truth[measured.conductor]["sag"]
    return {"validity": measured.validity.value, "sag_error": error}


@pytest.mark.parametrize("view", NAMES)
@pytest.mark.parametrize("method", LITERAL)
def test_literal(benchmark, view, method):
    picture = shot(view, PLAN.folder)
    literal = Literal(picture, method, PLAN.literal_templates[view])
    timed(
        benchmark,
        literal,
        rounds=1,
        warm=0,
        case="literal",
        view=view,
        method=method,
        templates=literal.templates,
    )
    benchmark.extra_info.update(spent=literal.spent, roi=str(literal.roi.box(picture.image.shape)))
    if method == "Bézier":
        same = Anchored(picture, literal.templates).scores()
        apart = [abs(a - b) for a, b in zip(same, literal.scores, strict=True) if a == a and b == b]
        assert [a == a for a in same] == [b == b for b in literal.scores], "other templates fit"
        benchmark.extra_info.update(largest_difference=max(apart), compared=len(apart))


@pytest.mark.parametrize("view", NAMES)
def test_anchored(benchmark, view):
    anchored = Anchored(shot(view, PLAN.folder), 300)
    timed(benchmark, anchored, case="anchored", view=view, templates=300)


@pytest.mark.parametrize("view", NAMES)
def test_anchored_library(benchmark, view):
    anchored = Anchored(shot(view, PLAN.folder), 300)
    timed(benchmark, anchored.draw, case="anchored library", view=view, templates=300)


@pytest.mark.parametrize("view", NAMES)
@pytest.mark.parametrize("templates", [300, 2500, 10000])
def test_own(benchmark, view, templates):
    picture = shot(view, PLAN.folder)
    own = Own(picture, templates)
    with own.prepared():
        measured = timed(benchmark, own, case="own", view=view, wanted=templates, templates=own.scored())
        stages = staged(own)
    benchmark.extra_info.update(stages | told(measured[0], picture.truth))


@pytest.mark.parametrize("view", NAMES)
def test_reading(benchmark, view):
    """Every conductor of the site in one frame, the search left as the product has it."""
    picture = shot(view, PLAN.folder)
    measured = timed(benchmark, lambda: measure_frame(picture.site, picture.image), case="reading", view=view)
    benchmark.extra_info.update(staged(lambda: measure_frame(picture.site, picture.image)))
    benchmark.extra_info.update(
        conductors=len(picture.site.conductors), told=[told(m, picture.truth) for m in measured]
    )


@pytest.mark.parametrize("view", NAMES)
def test_decoding(benchmark, view):
    picture = shot(view, PLAN.folder)
    timed(benchmark, lambda: read_grey(picture.jpeg), case="decoding", view=view, bytes=picture.jpeg.stat().st_size)


@pytest.mark.parametrize("view", NAMES)
def test_site(benchmark, view):
    """Survey, lens and reference picture made ready: once a configuration."""
    picture = shot(view, PLAN.folder)
    timed(benchmark, lambda: load_site(picture.span), case="site", view=view, rounds=3)


@pytest.mark.parametrize("view", NAMES)
@pytest.mark.parametrize("frames", [1, 2, 4, 8])
def test_burst(benchmark, view, frames):
    """The same picture so many times: a real burst differs in noise and sway, not in work."""
    if frames not in PLAN.burst_frames[view]:
        pytest.skip("left out")
    picture = shot(view, PLAN.folder)
    images = [picture.image] * frames
    timed(
        benchmark,
        lambda: measure_burst(picture.site, images),
        rounds=PLAN.slow_rounds,
        case="burst",
        view=view,
        frames=frames,
    )


@pytest.mark.parametrize("view", NAMES)
@pytest.mark.parametrize("frames", [1, 8])
def test_worker_cycle(benchmark, view, frames):
    """As the worker does it: take the frames from the camera (JPEG files here), measure, put the reply into words."""
    picture = shot(view, PLAN.folder)
    loaded = write_node(picture, PLAN.folder / f"node-{view}-{frames}", frames)
    _, measure = bound("sagnode.worker.child", "_measure")
    _, make_task = bound("sagnode.worker.child", "_Task")
    source = open_source(loaded.node.camera)
    source.open()
    task = make_task(loaded, picture.site, source, album=None)

    def cycle():
        return measure(MeasureRequest(id=1), task)[0].model_dump_json()

    try:
        reply = timed(benchmark, cycle, rounds=PLAN.slow_rounds, case="worker cycle", view=view, frames=frames)
    finally:
        source.close()
    benchmark.extra_info.update(bytes=len(reply))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_conductors(benchmark, count):
    picture = shot("tower", PLAN.folder)
    site = picture.alone(count)
    timed(benchmark, lambda: measure_frame(site, picture.image), case="conductors", view="tower", conductors=count)


@pytest.mark.parametrize("width", PLAN.widths)
def test_frame_size(benchmark, width):
    picture = scaled_tower(width, PLAN.folder)
    measured = timed(
        benchmark,
        lambda: measure_frame(picture.site, picture.image),
        rounds=PLAN.slow_rounds,
        case="frame size",
        view="tower",
        width=width,
        height=picture.image.shape[0],
    )
    benchmark.extra_info.update(staged(lambda: measure_frame(picture.site, picture.image)))
    benchmark.extra_info.update(told=[told(m, picture.truth) for m in measured])
