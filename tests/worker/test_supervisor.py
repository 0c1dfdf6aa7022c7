"""The supervisor against a real child process that fails in every way that a worker can."""

import gc
import logging
import sys
import time
from pathlib import Path

import pytest
from descriptors import all_low_ones_taken

from sagnode.quality import Cause
from sagnode.worker import supervisor as module
from sagnode.worker.supervisor import Limits, Supervisor

STAND_IN = Path(__file__).with_name("stand_in.py")


def command(plan, *more):
    def build(requests_fd, replies_fd, resume_after):
        words = [sys.executable, "-S", str(STAND_IN), "--plan", str(plan)]
        words += ["--requests-fd", str(requests_fd), "--replies-fd", str(replies_fd), *more]
        return [*words, "--resume-after", resume_after.isoformat()] if resume_after else words

    return build


@pytest.fixture
def start(tmp_path):
    started = []

    def build(words, *more, beat=lambda: True, **limits):
        plan = tmp_path / "plan"
        plan.write_text(words)
        limits = {"deadline_s": 5.0, "backoff_max_s": 0.2, **limits}
        supervisor = Supervisor(command(plan, *more), Limits(**limits), beat)
        started.append(supervisor)
        return supervisor

    yield build
    for supervisor in started:
        supervisor.stop()


def gone(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z"
    except FileNotFoundError:
        return True


def test_descriptors_above_a_thousand_are_as_good_as_others(start):
    with all_low_ones_taken():
        supervisor = start("ok")
        assert supervisor.measure(None).reply.id == 1
        supervisor.stop()


def measure_when_allowed(supervisor):
    time.sleep(supervisor.wait_s())
    return supervisor.measure(None)


def test_one_request_gives_one_reply(start):
    supervisor = start("ok")
    first, second = supervisor.measure(None), supervisor.measure(None)
    assert first.reply.id == 1
    assert second.reply.id == 2
    assert [r.conductor for r in first.reply.results] == ["L1", "L2"]
    assert supervisor.restarts == 0
    assert supervisor.camera == "ok: stand-in"


@pytest.mark.parametrize(
    ("word", "cause", "text"),
    [
        ("crash", Cause.WORKER_CRASHED, "exit status 1"),
        ("segfault", Cause.WORKER_CRASHED, "signal 11 (SIGSEGV)"),
        ("abort", Cause.WORKER_CRASHED, "signal 6 (SIGABRT)"),
        ("fatal", Cause.WORKER_CRASHED, "out of memory"),
        ("garbage", Cause.WORKER_GARBAGE, "not understood"),
        ("half-line", Cause.WORKER_GARBAGE, "not understood"),
        ("long-line", Cause.WORKER_GARBAGE, "not understood"),
        ("flood", Cause.WORKER_GARBAGE, "not understood"),
        ("wrong-id", Cause.WORKER_GARBAGE, "does not answer request 2"),
    ],
)
def test_each_failure_has_its_cause_and_the_next_reading_is_fine(start, word, cause, text):
    supervisor = start(f"ok {word} ok")
    assert supervisor.measure(None).reply
    failed = supervisor.measure(None)
    assert failed.reply is None
    assert failed.reason.cause is cause
    assert text in failed.reason.text
    assert measure_when_allowed(supervisor).reply
    assert supervisor.restarts == 1


def test_a_hang_ends_at_the_deadline_with_its_whole_process_group(start):
    supervisor = start("ok hang-children ok", deadline_s=0.8)
    assert supervisor.measure(None).reply
    pid = supervisor.hello.pid
    before = time.monotonic()
    hung = supervisor.measure(None)
    assert hung.reason.cause is Cause.DEADLINE
    assert time.monotonic() - before > 0.7
    assert gone(pid)
    # what was sent SIGKILL ends when the kernel gets to it
    limit = time.monotonic() + 5.0
    while (alive := [p for p in Path("/proc").glob("[0-9]*/stat") if _alive_in(p, pid)]) and time.monotonic() < limit:
        time.sleep(0.01)
    assert alive == []
    assert measure_when_allowed(supervisor).reply


def _alive_in(stat, group):
    try:
        state, _, its_group = stat.read_text().rpartition(")")[2].split()[:3]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z" and int(its_group) == group


def test_the_tail_of_what_it_printed_is_in_the_log(start, caplog):
    supervisor = start("crash ok")
    with caplog.at_level(logging.WARNING):
        supervisor.measure(None)
    assert "about to fail" in caplog.text


def test_noise_on_stdout_and_stderr_does_not_reach_the_protocol(start):
    supervisor = start("chatty")
    assert supervisor.measure(None).reply
    assert supervisor.measure(None).reply


def test_a_fault_is_passed_on_and_the_worker_stays(start):
    supervisor = start("fault ok")
    outcome = supervisor.measure(None)
    assert outcome.reason.cause is Cause.DARK
    assert supervisor.measure(None).reply
    assert supervisor.restarts == 0


def test_a_camera_that_stays_away_gets_a_new_worker(start):
    supervisor = start("camera-fault camera-fault camera-fault ok")
    causes = [supervisor.measure(None).reason.cause for _ in range(3)]
    assert causes == [Cause.CAMERA_FAULT] * 3
    assert supervisor.restarts == 1
    assert measure_when_allowed(supervisor).reply


def test_end_of_frames_is_no_failure(start):
    supervisor = start("end")
    assert supervisor.measure(None).end_of_frames
    assert supervisor.restarts == 0


@pytest.mark.parametrize("word", ["die-at-start", "start-fault", "bad-hello"])
def test_a_worker_that_cannot_start_is_retried_with_back_off(start, word):
    supervisor = start(f"{word} {word} {word} {word} ok", backoff_max_s=0.3)
    outcomes = []
    until = time.monotonic() + 20
    while time.monotonic() < until and not (outcomes and outcomes[-1].reply):
        outcomes.append(supervisor.measure(None))
        time.sleep(0.05)
    assert outcomes[-1].reply
    assert supervisor.restarts == 4
    assert "next start in" in " ".join(o.reason.text for o in outcomes if o.reason)


def test_a_worker_that_never_says_hello_is_replaced(start, monkeypatch):
    monkeypatch.setattr(module, "START_DEADLINE_S", 0.6)
    supervisor = start("no-hello ok", deadline_s=2.0)
    assert supervisor.measure(None).reason.cause is Cause.DEADLINE
    assert measure_when_allowed(supervisor).reply


def test_a_slow_start_costs_readings_but_not_the_worker(start):
    supervisor = start("no-hello", deadline_s=0.3)
    assert "still starting" in supervisor.measure(None).reason.text
    assert supervisor.restarts == 0


def test_back_off_doubles_up_to_its_maximum(start):
    supervisor = start("die-at-start", backoff_max_s=2.0)
    waits = []
    for _ in range(6):
        supervisor._not_before = 0.0
        supervisor.ready(5.0)
        waits.append(supervisor.wait_s())
    assert waits[0] == 0.0 or supervisor.restarts >= 1
    assert max(waits) <= 2.0
    assert waits[-1] >= 0.9


def test_recycled_after_so_many_readings(start):
    supervisor = start("ok", max_readings=2)
    pids = []
    for _ in range(4):
        assert supervisor.measure(None).reply
        pids.append(supervisor._child.pid)
    assert pids[0] != pids[1]
    assert pids[1] == pids[2]
    assert pids[2] != pids[3]
    assert supervisor.restarts == 0


def test_a_leak_ends_in_a_recycle(start):
    supervisor = start("leak:40", memory_max_mb=150.0)
    first = supervisor.measure(None)
    pid = supervisor._child.pid
    assert first.reply.memory_mb < 150
    while supervisor.measure(None).reply.memory_mb < 150:
        assert supervisor._child.pid == pid
    assert supervisor._child.pid != pid


def test_a_recycled_worker_goes_on_at_the_next_frame_and_a_killed_one_behind_it(start):
    supervisor = start("ok ok hang ok", "--frames-from", "2026-06-01T00:00:00+00:00", max_readings=2, deadline_s=1.0)
    times = []
    for _ in range(4):
        reply = measure_when_allowed(supervisor).reply
        times.append(reply and reply.acquired_at.strftime("%H:%M"))
    assert times == ["00:00", "00:15", None, "00:45"]


def test_stop_kills_the_worker(start):
    supervisor = start("ok")
    supervisor.measure(None)
    pid = supervisor.hello.pid
    supervisor.stop()
    assert gone(pid)


def test_a_wait_is_given_up_when_the_beat_says_so(start):
    supervisor = start("hang", beat=lambda: time.monotonic() < until, deadline_s=60.0)
    until = time.monotonic() + 1.0
    assert supervisor.measure(None).stopped
    assert time.monotonic() < until + 58.0  # the deadline


def test_a_command_that_does_not_exist_is_a_reason_not_an_exception():
    supervisor = Supervisor(lambda *_: ["/nowhere/python"], Limits(deadline_s=1.0))
    assert supervisor.measure(None).reason.cause is Cause.WORKER_CRASHED
    gc.collect()  # what earlier tests left open must not be closed in between
    fds = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        supervisor._not_before = 0.0
        supervisor.measure(None)
    gc.collect()
    assert len(list(Path("/proc/self/fd").iterdir())) <= fds
