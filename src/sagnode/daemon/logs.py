"""Logging to stderr: priorities for systemd's journal, times for a terminal, and no line a thousand times."""

from __future__ import annotations

import logging
import os
import sys
import time

_PRIORITY = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


class _JournalFormatter(logging.Formatter):
    """``<N>message`` on each line, which systemd-journald reads as a priority; it adds the time itself."""

    def format(self, record: logging.LogRecord) -> str:
        priority = _PRIORITY.get(record.levelno, 6)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


class _UtcFormatter(logging.Formatter):
    """Time in UTC, level, message."""

    converter = staticmethod(time.gmtime)


def set_up(level: str, *, journal: bool | None = None) -> None:
    """Send all log records to stderr.

    Args:
        level: debug, info, warning or error.
        journal: write for systemd's journal; by default when stderr is connected to it.
    """
    if journal is None:
        journal = _stderr_is_the_journal()
    handler = logging.StreamHandler()
    if journal:
        handler.setFormatter(_JournalFormatter("%(message)s"))
    else:
        handler.setFormatter(_UtcFormatter("%(asctime)sZ %(levelname)-7s %(message)s", "%Y-%m-%dT%H:%M:%S"))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    logging.getLogger("apscheduler").setLevel(logging.WARNING)
    logging.getLogger("tzlocal").setLevel(logging.WARNING)


def _stderr_is_the_journal() -> bool:
    """JOURNAL_STREAM names device and inode of the socket; a child may have inherited the variable without it."""
    try:
        device, _, inode = os.environ["JOURNAL_STREAM"].partition(":")
        stat = os.fstat(sys.stderr.fileno())
        return (stat.st_dev, stat.st_ino) == (int(device), int(inode))
    except (KeyError, ValueError, OSError):
        return False


class Seldom:
    """Says a thing once, and again only after ten minutes, with how often it happened meanwhile.

    Args:
        log: where to.
        every_s: least time between two equal lines.
    """

    def __init__(self, log: logging.Logger, every_s: float = 600.0) -> None:
        self._log = log
        self._every_s = every_s
        self._said: dict[str, tuple[float, int]] = {}

    def error(self, text: str) -> None:
        """Log an error unless it was logged not long ago."""
        now = time.monotonic()
        said_at, swallowed = self._said.get(text, (float("-inf"), 0))
        if now - said_at < self._every_s:
            self._said[text] = (said_at, swallowed + 1)
            return
        if len(self._said) > 100:
            self._said.clear()
        self._said[text] = (now, 0)
        again = f" ({swallowed} times since it was last said)" if swallowed else ""
        self._log.error("%s%s", text, again)

    def forget(self) -> None:
        """Things are well again; the next trouble is news."""
        self._said.clear()
