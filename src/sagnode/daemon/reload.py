"""A new configuration while the node runs: looked over first, put in force only when it is good.

What the daemon can see for itself (files, keys, values) it checks at once. What needs OpenCV, the lens and the
reference picture, is looked at by ``sagnode config check`` in a process of its own with a time limit. Until the verdict
nothing changes: worker and link go on with the old configuration, and after a refusal they have not noticed.
"""

from __future__ import annotations

import contextlib
import json
import logging
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

from sagnode.config.load import LoadedNode, load_node
from sagnode.daemon import logs
from sagnode.daemon.notify import Notifier, Watchdog
from sagnode.daemon.show import Showcase
from sagnode.errors import ConfigError

log = logging.getLogger(__name__)

CHECK_DEADLINE_S = 90.0
"""Longest wait for the thorough look: the imports alone take seconds on a slow card."""
_SLICE_S = 0.25


class Reloader:
    """Holds the configuration in force, and the next one until it is put in force.

    Args:
        loaded: in force from the start.
        notifier: for systemd, which may wait for the reload's end.
        watchdog: fed while the new configuration is looked over.
        stopping: whether there is an order to stop, which does not wait for that.
        usable: raises ConfigError for what the daemon itself could not work with.
    """

    def __init__(
        self,
        loaded: LoadedNode,
        notifier: Notifier,
        watchdog: Watchdog,
        *,
        stopping: Callable[[], bool],
        usable: Callable[[LoadedNode], None],
    ) -> None:
        self.loaded = loaded
        self._usable = usable
        self._notifier = notifier
        self._watchdog = watchdog
        self._stopping = stopping
        self._fresh: LoadedNode | None = None
        self._showcase: Showcase | None = None

    def attach(self, showcase: Showcase) -> None:
        """Where a refusal is shown from now on."""
        self._showcase = showcase

    def accept(self) -> bool:
        """Read the files anew; True when what they say now can be put in force, else the refusal is shown."""
        self._notifier.reloading()
        try:
            fresh = load_node(self.loaded.path)
            self._usable(fresh)
            self._look_closely(fresh)
        except ConfigError as error:
            self._refuse(error.faults)
            return False
        except Exception as error:  # whatever a file does to its reader, the node goes on with what it has
            log.exception("a defect met the new configuration")
            self._refuse((f"it cannot be read: unexpected {type(error).__name__}: {error}",))
            return False
        self._fresh = fresh
        return True

    def _refuse(self, faults: Sequence[str]) -> None:
        for fault in faults:
            log.error("reload refused: %s", fault)
        note = f"reload refused, the old one stays in force: {faults[0]}"
        if self._showcase is not None:
            self._showcase.configuration_note = note
            self._showcase.hurry()
        self._notifier.ready(note)

    def put_in_force(self) -> None:
        """The old one has been taken down; what :meth:`accept` found good counts from now on."""
        if self._fresh is not None:
            self.loaded, self._fresh = self._fresh, None
            logs.set_up(self.loaded.node.log_level)
            log.info("configuration %s read anew", self.loaded.configuration_id)

    def _look_closely(self, fresh: LoadedNode) -> None:
        """Raises ConfigError with the faults that only the mathematics can see."""
        words = [sys.executable, "-m", "sagnode", "config", "check", "--json", "--config", str(fresh.path)]
        self._watchdog.promise(CHECK_DEADLINE_S + 10.0)
        try:
            process = subprocess.Popen(words, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
        except OSError as error:
            log.warning("the new configuration was not looked at closely: %s", error)
            return
        give_up = time.monotonic() + CHECK_DEADLINE_S
        said = ""
        with process:
            while not self._stopping() and time.monotonic() < give_up:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    said = process.communicate(timeout=_SLICE_S)[0]
                    break
                self._watchdog.beat()
            else:
                process.kill()
                log.warning("the new configuration was not looked at closely: that took too long")
                return
        faults = _faults(said)
        if faults:
            raise ConfigError(faults[0], faults=faults)


def _faults(said: str) -> tuple[str, ...]:
    try:
        found = [one for one in json.loads(said)["findings"] if one["kind"] == "fault"]
        return tuple(f"{one['file']}, line {one['line']}: {one['key']}: {one['text']}" for one in found)
    except (ValueError, KeyError, TypeError) as error:
        log.warning("the new configuration was not looked at closely: its check answered %r (%s)", said[:200], error)
        return ()
