"""What the journal remembers, for those who compare readings with earlier ones."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Sequence

from pydantic import ValidationError

from sagnode.config.load import LoadedNode
from sagnode.daemon.journal import Journal
from sagnode.errors import JournalError
from sagnode.message import Reading, ReadingHeader
from sagnode.trend.watch import Trend, Watched

log = logging.getLogger(__name__)

REMEMBER = 60
"""Bursts of the journal that readings after a start are compared with."""


def recent_readings(journal: Journal, conductors: int) -> Sequence[ReadingHeader]:
    """The readings of the newest bursts, oldest first; none where the journal cannot be read."""
    readings: list[ReadingHeader] = []
    try:
        rows = journal.recent(REMEMBER * conductors)
    except JournalError as error:
        log.error("%s; readings are compared with later ones only", error)
        return readings
    for row in rows:
        with contextlib.suppress(ValidationError):  # written by another version; no past to compare with
            readings.append(Reading.model_validate_json(row.json))
    return readings


def configured_trend(loaded: LoadedNode, past: Sequence[ReadingHeader]) -> Trend:
    """The watch over the readings of the configured conductors, with their past."""
    watched = {c.id: Watched.of(c) for c in loaded.span.conductors if c.measured}
    trend = Trend(watched, loaded.node.trend.accept_after_s)
    trend.remember(past)
    return trend
