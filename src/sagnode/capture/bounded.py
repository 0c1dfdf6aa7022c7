"""Calls into a camera driver, each bounded in time.

Drivers block: OpenCV's V4L2 waits up to ten seconds for a frame, libcamera may wait for ever. All calls of one camera
run in one thread, in order; a caller waits only so long. What is stuck stays stuck there, and the process that owns
the camera can still report it, or be ended.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

Result = TypeVar("Result")
_Job = tuple[Callable[[], Any], "Future[Any]"]


class BoundedCalls:
    """One thread that makes the calls; start a new one when a call does not come back."""

    def __init__(self, name: str) -> None:
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        # A daemon thread: one that is stuck in a driver must not keep the process from ending.
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def call(self, function: Callable[[], Result], timeout_s: float) -> Result:
        """The function's result or exception.

        Raises:
            TimeoutError: it has not come back in time; it goes on in its thread.
        """
        future: Future[Result] = Future()
        self._jobs.put((function, future))
        return future.result(timeout_s)

    def end(self) -> None:
        """End the thread after the calls that are still queued."""
        self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            function, future = job
            try:
                future.set_result(function())
            except BaseException as error:  # noqa: BLE001 - handed to the caller, whichever it is
                future.set_exception(error)
            del job, function, future  # a frame in a result must not live until the next call
