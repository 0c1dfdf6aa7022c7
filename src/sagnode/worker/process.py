"""One worker process: its pipes, its process group, its last words."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import IO

from sagnode.worker.protocol import Hello, MeasureRequest

log = logging.getLogger(__name__)

MAX_LINE = 1_000_000
"""Bytes; a longer line is garbage."""
KILL_WAIT_S = 5.0
"""Longest wait for a killed worker to be gone."""
EXIT_WAIT_S = 1.0
"""A worker that closed its pipe may tell by its exit status why, before it is killed."""

CommandLine = Callable[[int, int, "datetime | None"], Sequence[str]]
"""(requests fd, replies fd, time of the last frame) to the worker's command line."""


class Child:
    """A running worker.

    Args:
        command: builds its command line.
        resume_after: passed on to it.
        configuration: what it finds on its standard input.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self, command: CommandLine, resume_after: datetime | None, configuration: bytes = b"") -> None:
        requests_read, self._requests = os.pipe()
        self._replies, replies_write = os.pipe()
        os.set_blocking(self._requests, False)
        os.set_blocking(self._replies, False)
        try:
            # In memory and not a pipe: a worker that never reads must not block the daemon.
            given = os.memfd_create("configuration", os.MFD_CLOEXEC)
        except OSError:
            for end in (requests_read, self._requests, self._replies, replies_write):
                os.close(end)
            raise
        try:
            with os.fdopen(given, "r+b", closefd=False) as stdin:
                stdin.write(configuration)
                stdin.seek(0)
            # The protocol has pipes of its own: what camera libraries print on stdout goes to the log with stderr.
            # A session of its own, so that its whole process group can be killed.
            self._process = subprocess.Popen(
                list(command(requests_read, replies_write, resume_after)),
                stdin=given,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(requests_read, replies_write),
                start_new_session=True,
                # One arena per thread would cost 64 MB of address space each, and never shrink.
                # The matrices are small: threads of the linear algebra only wait for each other.
                env={"MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1", **os.environ},
            )
        except OSError:
            os.close(self._requests)
            os.close(self._replies)
            raise
        finally:
            os.close(given)
            os.close(requests_read)
            os.close(replies_write)
        self.pid = self._process.pid
        self.started = time.monotonic()
        self.hello: Hello | None = None
        self.readings = 0
        self._ended = False
        self._status: int | None = None
        self._buffer = bytearray()
        self._words: deque[str] = deque(maxlen=20)
        assert self._process.stdout is not None  # noqa: S101 - a pipe was asked for
        self._listener = threading.Thread(target=self._listen, args=(self._process.stdout,), daemon=True)
        self._listener.start()

    def ask(self, request: MeasureRequest) -> bool:
        """Send a request; False when the worker has gone."""
        line = request.model_dump_json().encode() + b"\n"
        try:
            return os.write(self._requests, line) == len(line)
        except (BrokenPipeError, BlockingIOError):
            return False

    def read_line(self, timeout_s: float) -> bytes | None:
        """The next line; b"" at its end; None when nothing came in time. An overlong line is cut, and so is garbage."""
        if b"\n" not in self._buffer and len(self._buffer) < MAX_LINE:
            replies = select.poll()  # select(2) knows no descriptor above 1023
            replies.register(self._replies, select.POLLIN)
            if not replies.poll(1000 * timeout_s):
                return None
            chunk = os.read(self._replies, 1 << 16)
            if not chunk:
                return bytes(self._buffer)  # half a line is garbage, none is the end
            self._buffer += chunk
        end = self._buffer.find(b"\n")
        if end < 0 and len(self._buffer) < MAX_LINE:
            return None
        line = bytes(self._buffer[: end + 1 or MAX_LINE])
        del self._buffer[: len(line)]
        return line

    def end(self, exit_wait_s: float = 0.0) -> int | None:
        """Kill the whole process group; returns the exit status, None when not even that worked (state D)."""
        if not self._ended:
            self._ended = True
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._status = self._process.wait(exit_wait_s)
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.pid, signal.SIGKILL)
            try:
                self._status = self._process.wait(KILL_WAIT_S)
            except subprocess.TimeoutExpired:
                log.critical("worker %d cannot be killed; a driver holds it", self.pid)
            os.close(self._requests)
            os.close(self._replies)
        return self._status

    def last_words(self) -> list[str]:
        """The tail of what it printed."""
        self._listener.join(0.5)
        return list(self._words)

    def _listen(self, stream: IO[bytes]) -> None:
        """Drain what the worker prints, so that it never blocks on a full pipe."""
        with stream:
            while chunk := stream.readline(4096):
                words = chunk.decode(errors="replace").rstrip()
                if words:
                    self._words.append(words)
                    log.debug("worker %d: %s", self.pid, words)


def status_text(status: int | None) -> str:
    """An exit status in words."""
    if status is None:
        return "it cannot be killed; a driver holds it"
    if status < 0:
        with contextlib.suppress(ValueError):
            return f"killed by signal {-status} ({signal.Signals(-status).name})"
        return f"killed by signal {-status}"
    return f"exit status {status}"
