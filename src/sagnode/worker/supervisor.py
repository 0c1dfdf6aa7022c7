"""The daemon's side of the worker: start it, ask it, wait no longer than agreed, kill it, start it anew.

One reading is in flight at a time. Whatever goes wrong comes back as an :class:`Outcome` that carries the reason, so
that the daemon can record an invalid reading; nothing here raises because of what a worker does.
"""

from __future__ import annotations

import logging
import os
import random
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from sagnode.quality import Cause, Reason
from sagnode.worker.process import EXIT_WAIT_S, Child, CommandLine, status_text
from sagnode.worker.protocol import Fault, Hello, MeasureReply, MeasureRequest, WorkerLine

log = logging.getLogger(__name__)

START_DEADLINE_S = 90.0
"""From start to the first line: imports on a slow card and the camera's warm-up."""
CAMERA_FAULTS_MAX = 3
"""So often in a row the worker reopens its camera itself; after that it is replaced, driver state and all."""
_SLICE_S = 0.25
_JUST_BEFORE = timedelta(microseconds=1)


@dataclass(frozen=True)
class Outcome:
    """What came of one request: either a reply or the reason why there is none."""

    reply: MeasureReply | None = None
    reason: Reason | None = None
    end_of_frames: bool = False
    stopped: bool = False
    """The wait was given up because ``beat`` said so."""


@dataclass(frozen=True)
class Limits:
    """When a worker is ended and how fast it is tried again; see the node file's tables schedule and worker."""

    deadline_s: float
    max_readings: int = 1000
    memory_max_mb: float = 600.0
    backoff_max_s: float = 300.0


def command_line(config: Path, album: Path | None = None) -> CommandLine:
    """The real worker's command line; ``album`` is where it keeps appearances of landmarks, if in a file at all."""

    def build(requests_fd: int, replies_fd: int, resume_after: datetime | None) -> Sequence[str]:
        words = [sys.executable, "-m", "sagnode.worker", "--config", str(config)]
        words += ["--requests-fd", str(requests_fd), "--replies-fd", str(replies_fd), "--parent", str(os.getpid())]
        words += ["--album", str(album)] if album else []
        return words if resume_after is None else [*words, "--resume-after", resume_after.isoformat()]

    return build


class Supervisor:
    """Keeps one worker alive and asks it for readings.

    Args:
        command: builds the worker's command line.
        limits: deadline, recycling, back-off.
        beat: called at least every quarter of a second while waiting; the watchdog and a request to stop live there.
            When it returns False the wait is given up.
        configuration: what every worker finds on its standard input.
    """

    def __init__(
        self,
        command: CommandLine,
        limits: Limits,
        beat: Callable[[], bool] = lambda: True,
        configuration: bytes = b"",
    ) -> None:
        self._command = command
        self._configuration = configuration
        self._limits = limits
        self._beat = beat
        self._child: Child | None = None
        self._stopped = False
        self._failures = 0
        self._camera_faults = 0
        self._not_before = 0.0
        self._request_id = 0
        self._next_frame_at: datetime | None = None
        self._resume_after: datetime | None = None
        self._last_reason: Reason | None = None
        self._lines: TypeAdapter[WorkerLine] = TypeAdapter(WorkerLine)
        self.calibration_id = "unknown"
        """Of the last worker that said hello."""
        self.restarts = 0
        """Workers that had to be replaced because of a failure."""

    @property
    def hello(self) -> Hello | None:
        """What the living worker said at its start, or None while there is none."""
        return self._child.hello if self._child else None

    @property
    def camera(self) -> str:
        """One line on the camera for health and status."""
        if self._last_reason is not None:
            return self._last_reason.text
        if self.hello is not None:
            return f"ok: {self.hello.camera}"
        return "stopped" if self._stopped else "starting"

    @property
    def consecutive_failures(self) -> int:
        """Requests since the last reply."""
        return self._failures

    def wait_s(self) -> float:
        """Seconds until a worker may be started again; 0 when there is one or it may be started now."""
        return 0.0 if self._child else max(0.0, self._not_before - time.monotonic())

    def start(self) -> None:
        """Start a worker if there is none and the back-off allows it; returns at once."""
        self._stopped = False
        if self._child is None and self.wait_s() == 0.0:
            try:
                self._child = Child(self._command, self._resume_after, self._configuration)
            except OSError as error:
                self._failed(Reason(Cause.WORKER_CRASHED, f"worker cannot be started: {error}"))

    def ready(self, timeout_s: float) -> Outcome | None:
        """Wait until the worker has said hello; None means that it has, an Outcome says why not."""
        outcome = self._ready(timeout_s)
        return outcome if isinstance(outcome, Outcome) else None

    def measure(self, overlay_dir: Path | None) -> Outcome:
        """Ask for one reading and wait for it, no longer than the deadline."""
        give_up = time.monotonic() + self._limits.deadline_s
        child = self._ready(self._limits.deadline_s)
        if isinstance(child, Outcome):
            return child
        self._request_id += 1
        request = MeasureRequest(id=self._request_id, overlay_dir=str(overlay_dir) if overlay_dir else None)
        # A frame that kills its worker must not be met again by the next one; an answer moves this on.
        self._resume_after = self._next_frame_at
        if not child.ask(request):
            return self._crashed(child)
        answer = self._next_line(child, give_up)
        if isinstance(answer, Outcome):
            return answer
        if isinstance(answer, MeasureReply) and answer.id == request.id:
            return self._accept(child, answer)
        if isinstance(answer, Fault):
            return self._fault(answer)
        if answer is not None:
            return self._garbage(f"a line of kind {answer.kind} that does not answer request {request.id}")
        deadline = self._limits.deadline_s
        reason = Reason(Cause.DEADLINE, f"no reading within schedule.deadline_s = {deadline:g}; worker killed")
        return self._replace(reason)

    def stop(self) -> None:
        """End the worker and everything that it started."""
        self._stopped = True
        if self._child is not None:
            self._child.end()
            self._child = None

    # -- what a line means

    def _ready(self, timeout_s: float) -> Child | Outcome:
        self.start()
        child = self._child
        if child is None:
            return Outcome(reason=self._waiting_reason())
        if child.hello is not None:
            return child
        start_ends = child.started + START_DEADLINE_S
        line = self._next_line(child, min(time.monotonic() + timeout_s, start_ends))
        if isinstance(line, Outcome):
            return line
        if isinstance(line, Hello):
            child.hello = line
            self.calibration_id = line.calibration_id
            self._next_frame_at = line.first_frame_at
            log.info("worker %d ready: %s", line.pid, line.camera)
            return child
        if isinstance(line, Fault):
            return self._fault(line)
        if line is not None:
            return self._garbage("its first line is no hello")
        if time.monotonic() >= start_ends:
            text = f"worker was not ready after {START_DEADLINE_S:g} s; killed; its last words are in the log"
            return self._replace(Reason(Cause.DEADLINE, text))
        return Outcome(reason=Reason(Cause.DEADLINE, f"worker was still starting after {timeout_s:g} s"))

    def _accept(self, child: Child, reply: MeasureReply) -> Outcome:
        self._failures = 0
        self._camera_faults = 0
        self._last_reason = None
        self._next_frame_at = reply.next_frame_at
        self._resume_after = reply.next_frame_at - _JUST_BEFORE if reply.next_frame_at else None
        child.readings += 1
        if reply.memory_mb > self._limits.memory_max_mb:
            log.warning("worker %d holds %.0f MB; recycled", child.pid, reply.memory_mb)
            self._recycle()
        elif child.readings >= self._limits.max_readings:
            log.info("worker %d recycled after %d readings", child.pid, child.readings)
            self._recycle()
        return Outcome(reply=reply)

    def _fault(self, fault: Fault) -> Outcome:
        if fault.end_of_frames:
            return Outcome(end_of_frames=True)
        reason = Reason(fault.reason.cause, fault.reason.text)
        self._camera_faults = self._camera_faults + 1 if reason.cause is Cause.CAMERA_FAULT else 0
        if fault.fatal or self._camera_faults >= CAMERA_FAULTS_MAX:
            return self._replace(reason)
        self._last_reason = reason
        return Outcome(reason=reason)

    def _garbage(self, what: str) -> Outcome:
        return self._replace(Reason(Cause.WORKER_GARBAGE, f"worker's answer is not understood: {what}; killed"))

    def _crashed(self, child: Child) -> Outcome:
        return self._replace(Reason(Cause.WORKER_CRASHED, f"worker ended: {status_text(child.end(EXIT_WAIT_S))}"))

    def _next_line(self, child: Child, give_up: float) -> WorkerLine | Outcome | None:
        """The next line; an Outcome when there will be none; None when the time is up."""
        while self._beat():
            left = give_up - time.monotonic()
            if left <= 0:
                return None
            raw = child.read_line(min(left, _SLICE_S))
            if raw is None:
                continue
            if raw == b"":
                return self._crashed(child)
            try:
                return self._lines.validate_json(raw)
            except ValidationError as error:
                log.error("worker %d wrote %r", child.pid, raw[:200])
                return self._garbage(f"{error.error_count()} faults, first {error.errors()[0]['msg']}")
        return Outcome(stopped=True)

    # -- life and death

    def _recycle(self) -> None:
        self.stop()
        self.start()

    def _replace(self, reason: Reason) -> Outcome:
        """The worker has failed: kill its remains, log its last words, start another when the back-off allows."""
        child, self._child = self._child, None
        if child is not None:
            child.end()
            for words in child.last_words():
                log.warning("worker %d: %s", child.pid, words)
        self._camera_faults = 0
        self._failed(reason)
        self.start()
        return Outcome(reason=reason)

    def _failed(self, reason: Reason) -> None:
        self.restarts += 1
        self._failures += 1
        self._last_reason = reason
        # The first failure is mended at once; after that twice the wait each time, with jitter.
        ceiling = 0.0 if self._failures == 1 else min(self._limits.backoff_max_s, 2.0 ** min(self._failures - 2, 30))
        wait = ceiling * random.uniform(0.5, 1.0)  # noqa: S311 - not for secrecy
        self._not_before = time.monotonic() + wait
        log.error("%s (failure %d in a row, next start in %.1f s)", reason.text, self._failures, wait)

    def _waiting_reason(self) -> Reason:
        last = self._last_reason or Reason(Cause.WORKER_CRASHED, "no worker")
        return Reason(last.cause, f"{last.text} (next start in {self.wait_s():.0f} s)")
