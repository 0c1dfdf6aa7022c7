"""Whether readings reach the broker once it is connected: a log-in alone says nothing of that."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from sagnode.daemon.journal_table import Backlog

STUCK_S = 900.0
"""A connected broker that has not acknowledged the oldest reading for so long is a trouble."""


class Delivers(Protocol):
    """What is looked at of the link."""

    @property
    def connected(self) -> bool:
        """Whether the broker has taken the connection."""

    @property
    def delivery(self) -> str:
        """``ok``, or what the broker does not take."""


class Delivery:
    """Watches the oldest reading that is owed.

    Args:
        monotonic: seconds that never step.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._oldest: int | None = None
        self._since = 0.0

    def state(self, link: Delivers, backlog: Backlog) -> str:
        """``ok``, or why readings do not arrive; a broker that is not connected is told elsewhere."""
        oldest = backlog.oldest_sequence if link.connected else None
        if oldest != self._oldest:
            self._oldest, self._since = oldest, self._monotonic()
        if link.delivery != "ok":
            return link.delivery
        waits_s = self._monotonic() - self._since
        if oldest is None or waits_s < STUCK_S:
            return "ok"
        return (
            f"reading {oldest} was not acknowledged for {waits_s / 60:.0f} min though the broker is connected,"
            f" and {backlog.depth} wait; see the broker's log"
        )
