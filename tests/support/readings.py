"""Readings for tests."""

from datetime import UTC, datetime, timedelta

from sagnode.message import QualityMessage, Reading
from sagnode.quality import Validity

START = datetime(2026, 6, 1, tzinfo=UTC)


def reading(sequence, conductor="L1", **fields):
    defaults = {
        "utility": "u",
        "line": "l",
        "span": "s",
        "unit": "n",
        "conductor": conductor,
        "sequence": sequence,
        "acquired_at": START + timedelta(minutes=15 * sequence),
        "clock_synced": True,
        "boot_id": "b",
        "monotonic_s": 1.0,
        "quality": QualityMessage(validity=Validity.GOOD),
        "frames_used": 1,
        "frames_rejected": 0,
        "method": "test",
        "calibration_id": "c",
        "configuration_id": "c",
        "software_version": "0",
        "sag_m": 8.0,
        "sag_u": 0.01,
        "sag_lo": 7.98,
        "sag_hi": 8.02,
    }
    return Reading(**{**defaults, **fields})


def numbers(journal):
    """The sequence numbers that a journal still owes the broker."""
    return [row.sequence for row in journal.pending(0, 1_000_000)]


def fill(journal, count, conductors=("L1", "L2", "L3"), *, owed=True):
    for _ in range(count):
        first = journal.next_sequence
        journal.append([reading(first + i, c) for i, c in enumerate(conductors)], owed=owed)
