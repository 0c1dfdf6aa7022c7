"""What is done when no reading comes for long: the rungs above killing the worker and opening the camera anew.

::

    deadline -> worker killed -> started anew -> camera opened anew     (sagnode.worker, within seconds)
      no reading for restart_after_s          -> the service ends itself, and systemd starts it anew
      restarts_before_reboot such in one boot -> the watchdog is left unfed and a reboot asked for

How often has to be remembered by what is started anew. A small file in the state directory counts, without any time
of day, which nobody vouches for: a service may be started anew so often in one boot, and the reboot after n fruitless
ones waits until the machine has been up for ``reboot_wait_h`` times 2 to the n, a day at most. One reading that comes
ends all of it. A state directory that cannot be written remembers nothing, so nothing is started anew either.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from enum import Enum
from pathlib import Path

from sagnode.daemon.files import write_atomic
from sagnode.quality import Cause, Reason

log = logging.getLogger(__name__)

REBOOT_WAIT_MAX_S = 86400.0
FAILURES_MIN = 3
"""So many readings in a row must have failed, however rare they are."""
MENDABLE = frozenset(
    {Cause.CAMERA_FAULT, Cause.STALE_FRAME, Cause.DEADLINE, Cause.WORKER_CRASHED, Cause.WORKER_GARBAGE}
)
"""What a fresh start may mend; neither night nor a wrong calibration is among them."""


class Rung(Enum):
    """What is to be done now."""

    STAY = "go on"
    RESTART = "start the service anew"
    REBOOT = "start the machine anew"


@dataclass(frozen=True)
class Steps:
    """When each rung is reached; see the node file's table recovery."""

    restart_after_s: float
    restarts_before_reboot: int
    reboot: bool
    reboot_wait_h: float


@dataclass(frozen=True)
class _Memory:
    """What outlives the process."""

    boot_id: str = ""
    restarts: int = 0
    """Of the service in this boot, without a reading since."""
    reboots: int = 0
    """Of the machine, without a reading since."""


class Ladder:
    """Counts what was tried, and says what comes next.

    Args:
        path: the file that remembers.
        steps: when each rung is reached.
        boot_id: of this boot.
        request: file that asks for a reboot when it appears (``sagnode-reboot.path``), None where nobody looks.
        uptime: seconds since the machine was started.
    """

    def __init__(
        self,
        path: Path,
        steps: Steps,
        boot_id: str,
        request: Path | None = None,
        uptime: Callable[[], float] = time.monotonic,
    ) -> None:
        self._path = path
        self._steps = steps
        self._request = request
        self._uptime = uptime
        self._memory = _read(path)
        if self._memory.boot_id != boot_id:
            self._memory = replace(self._memory, boot_id=boot_id, restarts=0)
        self._failing_since: float | None = None
        self._failures = 0
        self._rebooting = False

    @property
    def state(self) -> str:
        """One line for health: ``ok``, or what was tried."""
        if self._rebooting:
            return "the watchdog is left unfed, for the machine to start anew"
        tried = [
            f"{count} {word} without a reading since"
            for count, word in (
                (self._memory.restarts, "restarts of the service"),
                (self._memory.reboots, "restarts of the machine"),
            )
            if count
        ]
        return ", ".join(tried) or "ok"

    def answered(self) -> None:
        """A reading came, whatever it says of the conductors."""
        self._failing_since = None
        self._failures = 0
        if self._memory.restarts or self._memory.reboots:
            log.info("readings come again after %s", self.state)
            self._remember(replace(self._memory, restarts=0, reboots=0))

    def failed(self, reason: Reason | None) -> Rung:
        """No reading came; says what is to be done about it."""
        if reason is not None and reason.cause not in MENDABLE:
            self._failing_since = None
            self._failures = 0
            return Rung.STAY
        now = self._uptime()
        if self._failing_since is None:
            self._failing_since = now
        self._failures += 1
        if self._failures < FAILURES_MIN or now - self._failing_since < self._steps.restart_after_s:
            return Rung.STAY
        if self._memory.restarts < self._steps.restarts_before_reboot:
            return self._restart()
        return self._reboot(now)

    def _restart(self) -> Rung:
        memory = replace(self._memory, restarts=self._memory.restarts + 1)
        if not self._remember(memory):
            return Rung.STAY
        log.critical(
            "no reading for %.0f s; the service is started anew (%d of %d times)",
            self._steps.restart_after_s,
            memory.restarts,
            self._steps.restarts_before_reboot,
        )
        return Rung.RESTART

    def _reboot(self, now: float) -> Rung:
        wait_s = min(REBOOT_WAIT_MAX_S, self._steps.reboot_wait_h * 3600 * 2.0 ** min(self._memory.reboots, 20))
        if not self._steps.reboot or self._rebooting or now < wait_s:
            return Rung.STAY
        if not self._remember(replace(self._memory, reboots=self._memory.reboots + 1)):
            return Rung.STAY
        self._rebooting = True
        log.critical(
            "no reading, and %d restarts did not help; the watchdog is left unfed for the machine to start anew",
            self._memory.restarts,
        )
        if self._request is not None:
            try:
                write_atomic(self._request, f"{self._steps.restart_after_s:g} s without a reading\n", durable=False)
            except OSError as error:
                log.error("%s: %s; the watchdog alone is left to act", self._request, error.strerror)
        return Rung.REBOOT

    def _remember(self, memory: _Memory) -> bool:
        try:
            write_atomic(self._path, json.dumps(asdict(memory)) + "\n")
        except OSError as error:
            log.error("%s: %s; nothing is started anew that could not be counted", self._path, error.strerror)
            return False
        self._memory = memory
        return True


def _read(path: Path) -> _Memory:
    """What was remembered; a file that cannot be understood counts as the fullest memory that does no harm: none."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        return _Memory(str(kept["boot_id"]), max(0, int(kept["restarts"])), max(0, int(kept["reboots"])))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return _Memory()
