"""What a check says: one finding each, with a remedy where there is something to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad it is."""

    OK = "ok"
    SKIPPED = "skipped"
    """Could not or should not be looked at; the text says why."""
    WARNING = "warning"
    """The node measures; something will disappoint."""
    FAULT = "fault"
    """The node does not measure, or nobody hears of it."""


@dataclass(frozen=True)
class Finding:
    """The outcome of one check."""

    check: str
    level: Level
    text: str
    remedy: str = ""

    def as_json(self) -> dict[str, str]:
        """For a program."""
        return asdict(self)

    @classmethod
    def of_json(cls, document: dict[str, str]) -> Finding:
        """What :meth:`as_json` was made of."""
        return cls(document["check"], Level(document["level"]), document["text"], document["remedy"])


def ok(check: str, text: str) -> Finding:
    """All is well."""
    return Finding(check, Level.OK, text)


def skipped(check: str, text: str) -> Finding:
    """Not looked at, and why."""
    return Finding(check, Level.SKIPPED, text)


def warning(check: str, text: str, remedy: str = "") -> Finding:
    """Something will disappoint."""
    return Finding(check, Level.WARNING, text, remedy)


def fault(check: str, text: str, remedy: str = "") -> Finding:
    """The node does not do its work."""
    return Finding(check, Level.FAULT, text, remedy)


def faults(findings: Iterable[Finding]) -> list[Finding]:
    """Those that are faults."""
    return [finding for finding in findings if finding.level is Level.FAULT]
