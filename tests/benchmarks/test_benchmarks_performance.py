"""The measuring instruments behind docs/performance.md, on things whose size is known."""

import json
import mmap
import os
import re
import subprocess
import sys
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from performance import compiled, floor, frames, idle, idle_tables, methods, process, prose, proxy, stages, windows
from performance import hotspots as profile
from performance import resource_tables as resources
from performance import speed_tables as tables
from sagnode import native
from sagnode.pipeline import measure_frame
from sagnode.worker.supervisor import Limits, Supervisor

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def tower(tmp_path):
    return frames.shot("tower", tmp_path)


def test_every_stage_that_is_clocked_is_there():
    """Fails when a stage was renamed: then say in benchmarks/performance/stages.py what it is called now."""
    for stage in stages.STAGES:
        stages.bound(stage.module, stage.function)


def test_a_stage_that_is_gone_is_told_with_its_place():
    with pytest.raises(stages.NameGone, match=r"sagnode\.pipeline\.lookk is gone"):
        stages.bound("sagnode.pipeline", "lookk")


def test_stages_are_clocked_and_left_as_they_were(tower):
    import sagnode.pipeline

    before = sagnode.pipeline.look
    with stages.clocked() as spent:
        measure_frame(tower.site, np.zeros_like(tower.image))
    assert sagnode.pipeline.look is before
    # a black frame goes no farther than the first stage
    assert spent.calls == {"look": 1}
    assert spent.seconds["look"] > 0
    assert spent.rest(1.0) == pytest.approx(1.0 - spent.seconds["look"])


@pytest.mark.parametrize("wanted", [300, 2500, 10_000])
def test_the_search_can_be_made_to_compare_so_many_templates(tower, wanted):
    assert methods.Own(tower, wanted).scored() == pytest.approx(wanted, rel=0.4)


def test_the_literal_search_looks_into_the_fewest_quadrants_that_hold_its_templates(tower):
    scene = methods.paper_scene(tower, 5)
    left, top, right, bottom = methods.smallest_roi(tower, scene).box(tower.image.shape)
    for sag in scene.sags:
        curve = scene.visible(scene.near, scene.far, float(sag))
        assert np.all(curve >= (left, top))
        assert np.all(curve < (right, bottom))
    assert (right - left) * (bottom - top) < tower.image.size


def test_a_slope_has_an_uncertainty_that_holds_it():
    rng = np.random.default_rng(1)
    x = np.arange(0.0, 4000.0, 10.0)
    found = process.slope(list(x), list(5e4 + 0.003 * x + rng.normal(0, 4, len(x))))
    assert abs(found.per_thousand - 3.0) < 3 * found.u
    assert 0 < found.u < 1
    with pytest.raises(ValueError, match="too few"):
        process.slope([1.0, 2.0], [1.0, 2.0])


def test_a_slope_takes_neighbours_that_are_alike_for_what_they_are():
    """A height that wanders promises less than as many independent readings would."""
    rng = np.random.default_rng(4)
    x = np.arange(4000.0)
    wandering = np.repeat(rng.normal(0, 50, 40), 100)
    found = process.slope(list(x), list(8e4 + wandering))
    assert found.u > 10 * process.slope(list(x), list(8e4 + rng.permutation(wandering))).u / 3
    assert abs(found.per_thousand) < 4 * found.u


def test_too_few_readings_tell_no_slope():
    slope = {"per_thousand": 770.0, "u": 797.0, "settled": 8e4, "middle": 8e4, "last": 8e4}
    found = {"readings": 150, "slope": slope}
    status = {"runs": 9, "wall_s": 0.06, "cpu_s": 0.06, "bare_s": 0.01, "imported": []}
    page = resources.soak_section({"daemon": found | {"readings": 10_000}, "worker": found, "status": status})
    assert "| 10,000 | 78.12 | 78.12 | 78.12 | +770 ± 797 |" in page
    assert "150 readings are too few to tell" in page


def test_the_page_carries_the_errors_of_the_code_that_is_timed():
    summary = "group   told\ntower  5/6  "
    page = resources.accuracy_section(
        {"command": "python benchmarks/run.py --worlds 1", "worlds": 1, "summary": summary}
    )
    assert "One world of each group, by `python benchmarks/run.py --worlds 1`" in page
    assert "```\ngroup   told\ntower  5/6\n```" in page


def test_the_page_says_whether_the_kernels_were_in_use():
    row = {"compiled": True, "with_s": 0.02, "without_s": 0.05, "apart": 1e-6}
    page = tables.native_section({"compiled": True, "views": dict.fromkeys(frames.NAMES, row)})
    assert "| laboratory, 960x540 | 20.0 | 50.0 | 2.5 | 1e-06 of their uncertainty |" in page
    assert "were NOT in use" in tables.native_section({"compiled": False, "views": {}})


def test_numbers_with_and_without_the_kernels_are_compared():
    assert compiled.apart({"a": (2.0, 0.1), "b": None}, {"a": (2.01, 0.1), "b": None}) == pytest.approx(0.1)
    with pytest.raises(RuntimeError, match="different conductors"):
        compiled.apart({"a": (2.0, 0.1)}, {"a": None})


def test_memory_and_processor_time_are_this_processs_own():
    pid = os.getpid()
    before = process.resident_kb(pid)
    process.forget_peak(pid)
    # pages of their own: the allocator may have freed memory at hand
    with mmap.mmap(-1, 30_000_000) as block:
        block.write(b"x" * len(block))
        assert process.peak_kb(pid) - before > 25_000
    spent = process.cpu_s(pid)
    sum(i * i for i in range(300_000))
    assert process.cpu_s(pid) > spent
    assert process.written_bytes(pid) >= 0


def test_a_readings_share_is_told_from_that_of_the_waiting():
    """Readings of 0.5 s of CPU in windows of 3 s, every 10 s, on 0.002 s of CPU a second."""
    rng = np.random.default_rng(2)
    before, after, spent = [], [], 5.0
    for k in range(20):
        before.append((10.0 * k, spent))
        spent += 3 * 0.002 + 0.5 + rng.normal(0, 0.01)
        after.append((10.0 * k + 3, spent))
        spent += 7 * 0.002 + rng.normal(0, 0.001)
    before.append((200.0, spent))
    found = windows.share(before, after)
    assert abs(found.rest_per_s - 0.002) < 3 * found.rest_u
    assert abs(found.each - 0.5) < 3 * found.each_u
    assert found.each_u < 0.005
    with pytest.raises(ValueError, match="too few"):
        windows.share(before[:3], after[:2])


def test_no_number_is_told_that_its_uncertainty_does_not_bear():
    assert prose.told(2.566, 0.148) == "2.57 ± 0.15"
    assert prose.told(41.3, 3.2) == "41.3 ± 3.2"
    assert prose.told(-0.3, 0.1) == "under 0.20"
    assert prose.told(770, 797) == "under 2364"
    assert prose.told(0.0, 0.0) == "0"


def test_what_a_reading_sends_is_counted_by_message_and_never_negative():
    def passed(readings):
        sent = Counter({"measurement": 3 * readings, "health": readings, "keep-alive": readings // 4})
        size = Counter({"measurement": 9000 * readings, "health": 900 * readings, "keep-alive": 2 * (readings // 4)})
        segments = Counter({"measurement": 9 * readings, "health": readings, "keep-alive": readings // 4})
        return proxy.Passed(9900 * readings, 20 * readings, 8 * readings, sent, size, segments)

    found = idle.network([passed(k + 1).since(passed(k)) for k in range(8)])
    assert found["messages"]["measurement"] == {"count": 3.0, "bytes": 9000.0}
    assert found["messages"]["health"] == {"count": 1.0, "bytes": 900.0}
    # eight on the wire, and three messages of three network packets each that loopback carries in one
    assert found["packets"] == 8 + 6
    cpu = {"rest_per_s": 0.001, "rest_u": 1e-4, "each": -0.001, "each_u": 0.002, "windows": 8}
    page = idle_tables.idle_section(
        {
            "waiting": {
                "interval_s": 10.0,
                "burst": 4,
                "conductors": 3,
                "readings": 8,
                "keepalive_s": 60,
                "start": {"daemon": 0.3, "worker": 1.2},
                "cpu": {"daemon": cpu},
                "network": found,
            },
            "disk": {"cycles": 10, "json_bytes": 1, "journal_bytes": 2, "process_bytes": 3},
        }
    )
    assert "| readings, one message a conductor | 3 | 9,000 |" in page
    assert "| daemon | 3.60 ± 0.36 | under 0.05 |" in page
    assert re.search(r"-\d", page) is None


def test_the_stand_in_speaks_the_workers_protocol_and_goes_on_where_it_was(tmp_path):
    reply = {
        "kind": "reply",
        "id": 1,
        "acquired_at": "2026-06-21T00:00:00Z",
        "monotonic_s": 1.0,
        "camera": "recorded",
        "results": [{"conductor": "L1", "validity": "invalid", "method": "recorded"}],
        "elapsed_s": 0.1,
        "memory_mb": 50.0,
    }
    (tmp_path / "reply.json").write_text(json.dumps(reply))
    words = {"SAGNODE_STAND_IN_REPLY": str(tmp_path / "reply.json"), "SAGNODE_STAND_IN_READINGS": "3"}

    def command(requests_fd, replies_fd, resume_after):
        line = ["env", *(f"{k}={v}" for k, v in words.items()), sys.executable]
        line += [str(BENCHMARKS / "performance" / "stand_in.py")]
        line += ["--requests-fd", str(requests_fd), "--replies-fd", str(replies_fd), "--parent", str(os.getpid())]
        return line if resume_after is None else [*line, "--resume-after", resume_after.isoformat()]

    worker = Supervisor(command, Limits(deadline_s=30.0, max_readings=2))
    try:
        times = [worker.measure(None).reply.acquired_at for _ in range(3)]
        assert worker.measure(None).end_of_frames
    finally:
        worker.stop()
    # the worker was replaced after two readings
    assert times == [datetime(2026, 6, 21, 0, m, tzinfo=UTC) for m in (0, 5, 10)]


def test_ratios_scale_the_templates_that_were_run_and_nothing_else():
    spent = {"undistort": 1.0, "edges": 0.5, "curve points": 0.1, "draw": 0.2, "matchTemplate": 3.0}
    rows = [
        {"case": "literal", "view": "lab", "method": "Bézier", "templates": 30, "spent": spent},
        {"case": "own", "view": "lab", "wanted": 300, "min": 0.02, "spent": {"locate": 0.01}},
    ]
    cases = tables.Cases(rows)
    assert sum(cases.literal("lab").values()) == pytest.approx(1.5 + 10 * 3.3)
    assert cases.ratio("lab", 300) == pytest.approx(3450.0)
    with pytest.raises(LookupError, match="0 cases"):
        cases.one("own", view="field")


def growing(frame_sizes: list[dict]) -> list[dict]:
    """Cases of which only the frame sizes matter."""
    found = [{"case": "frame size", "height": r["width"] // 2, **r} for r in frame_sizes]
    for view in tables.NAMES:
        found += [
            {"case": "own", "view": view, "templates": n, "min": 0.01, "spent": {"search": 1e-6 * n}}
            for n in (300, 900)
        ]
        found += [{"case": "burst", "view": view, "frames": n, "min": 0.05 * n} for n in (1, 8)]
    return found + [{"case": "conductors", "conductors": n, "min": 0.02 * n} for n in (1, 2, 3)]


def test_a_small_frame_that_costs_more_is_said_with_its_reason():
    small, large = (
        {"width": 700, "min": 0.45, "calls": {"solve": 66}},
        {"width": 1400, "min": 0.06, "calls": {"solve": 21}},
    )
    text = tables.growth_section(tables.Cases(growing([small, large])))
    assert "| frame size, the same view | 700x350 / 1400x700 | 450 / 60 | 66 / 21 joint estimates |" in text
    said = " ".join(text.split())
    assert "the frame of 700x350 takes 7.5 times as long as that of 1400x700, because 66 joint estimates" in said
    assert "instead of 21." in said
    assert "pixels |" not in text


def test_a_frame_that_costs_more_for_no_more_estimates_has_no_such_reason():
    rows = [{"width": 700, "min": 0.05, "calls": {"solve": 21}}, {"width": 1400, "min": 0.06, "calls": {"solve": 21}}]
    text = tables.growth_section(tables.Cases(growing(rows)))
    assert "because" not in text
    assert "What counts is how much a picture leaves open, not its pixels." in " ".join(text.split())


def test_a_missed_target_says_where_the_time_is_the_dearest_first():
    spent = {"register": 0.008, "locate": 0.085, "search": 0.05, "refine": 0.02, "solve": 0.01, "tell": 0.007}
    cases = tables.Cases(
        [
            {"case": "reading", "view": "field", "min": 0.1, "staged_s": 0.1, "spent": spent},
            {"case": "decoding", "view": "field", "min": 0.03},
            *({"case": "burst", "view": "tower", "frames": n, "min": 0.1 * n} for n in (1, 8)),
            *(
                {"case": "own", "view": v, "wanted": n, "spent": spent}
                for v in ("tower", "field")
                for n in (300, 10000)
            ),
            *(
                {"case": "literal", "view": v, "method": "Bézier", "templates": 300, "spent": {"matchTemplate": 9.0}}
                for v in ("tower", "field")
            ),
        ]
    )
    text = tables.targets_section(cases, {})
    assert "of the 100 ms" in text
    assert "the coarse search 50, measuring across the curves 20, the joint estimates 10" in text
    assert "all else 5." in text


def test_sampled_stacks_are_summed_by_this_programs_functions():
    entry, refine, numpy_ = (
        "measure_frame (sagnode/pipeline.py",
        "observe (sagnode/match/refine.py",
        "cross (numpy/n.py",
    )
    stacks = Counter({(entry,): 1, (entry, refine): 5, (entry, refine, numpy_): 4})
    rows, kinds = profile.summed(stacks, total_ms=100.0)
    assert [(r["name"], r["own_ms"], r["cumulative_ms"]) for r in rows] == [
        ("refine.observe", pytest.approx(90.0), pytest.approx(90.0)),
        ("pipeline.measure_frame", pytest.approx(10.0), pytest.approx(100.0)),
    ]
    assert kinds["NumPy's Python"] == pytest.approx(40.0)


def test_pixels_under_the_samples_are_counted_once():
    image = np.arange(200, dtype=np.uint8).reshape(10, 20)
    u, v = np.array([[2.0, 3.2, 3.4]], np.float32), np.array([[5.0, 5.0, -3.0]], np.float32)
    nu, nv = np.zeros_like(u), np.ones_like(u)
    line = np.array([[[0.0]]], np.float32), np.array([[[1.0]]], np.float32)
    band = np.array([[0.0]], np.float32)
    # two samples in the frame, each with a pixel on either side of it; the third is outside
    samples, ((flat, places),) = floor.sampled([((image, u, v, nu, nv, *line, band), {})] * 2)
    assert samples == 2 * 9
    assert sorted(flat[places].tolist()) == [82, 83, 102, 103, 122, 123]
    # and what OpenCV is given
    samples, ((flat, places),) = floor.sampled([((image, u, v, 1), {})])
    assert (samples, places.tolist()) == (3, [102, 103])


def test_calls_of_the_compiled_functions_are_noted_and_they_are_put_back(tower):
    if native.kernels is None:
        pytest.skip("no compiled functions here")
    with floor.recorded() as (_, compiled):
        measure_frame(tower.site, tower.image)
    assert {"response", "response_sums"} <= set(compiled)
    from sagnode.match import ribbon

    assert ribbon.kernels is native.kernels


def test_the_plan_reaches_the_cases(tmp_path):
    """What the command line chose is what the cases see, in the thorough plan as in the quick one."""
    script = (
        "import sys; from performance import plan as p; from pathlib import Path;"
        "plan = p.thorough(Path(sys.argv[1])); p.announce(plan); assert p.current() == plan"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=True, cwd=BENCHMARKS)
