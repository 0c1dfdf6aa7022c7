"""What each kind of alarm looks at in a reading, and what it says; limits come from the configuration alone."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sagnode.config.node import Alarms as Settings
from sagnode.config.span import Span
from sagnode.exchange import AlarmKind
from sagnode.message import Estimate, ReadingHeader, reading_estimate
from sagnode.quality import Cause, Validity

ICE_Z = 4.0
"""Uneven load is suspected when it exceeds its standard uncertainty so many times."""


@dataclass(frozen=True)
class Evidence:
    """What a reading, or the time without one, says of an alarm.

    Attributes:
        shows: True for it, False against it, None neither.
        text: one sentence with the numbers.
        estimate: the quantity, where there is one.
        measure: the number that is held against the limit.
        since: when it began, where that is known otherwise than by counting readings.
    """

    shows: bool | None
    text: str = ""
    estimate: Estimate | None = None
    measure: float | None = None
    since: datetime | None = None


NOTHING = Evidence(None)


@dataclass(frozen=True)
class Rule:
    """One kind of alarm with its limit.

    Attributes:
        kind: of the alarm.
        quantity: field of the reading that is held against the limit, where there is one.
        limit: in the quantity's unit.
        hysteresis: beyond the limit by so much before the alarm clears, in the same unit.
    """

    kind: AlarmKind
    quantity: str | None = None
    limit: float | None = None
    hysteresis: float = 0.0

    def of_reading(self, reading: ReadingHeader, *, active: bool) -> Evidence:
        """Evidence in a reading; ``active``: the alarm is in force."""
        del reading, active
        return NOTHING

    def of_age(self, since: datetime, age_s: float) -> Evidence:
        """Evidence in the time since the last reading with a number."""
        del since, age_s
        return NOTHING

    def worse(self, one: float, other: float) -> bool:
        """Whether the first measure is the worse of two."""
        return one > other


@dataclass(frozen=True)
class ClearanceRule(Rule):
    """``clearance_lo`` is below its limit: it cannot be relied on that the clearance is kept."""

    def of_reading(self, reading: ReadingHeader, *, active: bool) -> Evidence:
        """See :meth:`Rule.of_reading`."""
        found = reading_estimate(reading, "clearance")
        if found is None or self.limit is None:
            return NOTHING
        low = found.lo < self.limit + (self.hysteresis if active else 0.0)
        text = f"clearance {_metres(found)}, limit {self.limit:g} m"
        return Evidence(_unless_marked(low, reading), text, found, found.lo)

    def worse(self, one: float, other: float) -> bool:
        """See :meth:`Rule.worse`."""
        return one < other


@dataclass(frozen=True)
class SagRule(Rule):
    """``sag_hi`` is above its limit."""

    def of_reading(self, reading: ReadingHeader, *, active: bool) -> Evidence:
        """See :meth:`Rule.of_reading`."""
        found = reading_estimate(reading, "sag")
        if found is None or self.limit is None:
            return NOTHING
        high = found.hi > self.limit - (self.hysteresis if active else 0.0)
        text = f"sag {_metres(found)}, limit {self.limit:g} m"
        return Evidence(_unless_marked(high, reading), text, found, found.hi)


@dataclass(frozen=True)
class SwingRule(Rule):
    """The conductor is swung beyond its limit by more than the uncertainty: many views hardly see swing at all."""

    def of_reading(self, reading: ReadingHeader, *, active: bool) -> Evidence:
        """See :meth:`Rule.of_reading`."""
        found = reading_estimate(reading, "swing")
        if found is None or self.limit is None:
            return NOTHING
        sure = max(found.lo, -found.hi, 0.0)
        swung = sure > self.limit - (self.hysteresis if active else 0.0)
        text = f"swing {found.value:.0f} degrees [{found.lo:.0f} .. {found.hi:.0f}], limit {self.limit:g} degrees"
        return Evidence(swung, text, found, sure)


@dataclass(frozen=True)
class IceRule(Rule):
    """The estimate needed an uneven load, or was refused for one; or the load is uneven surely and beyond the limit."""

    def of_reading(self, reading: ReadingHeader, *, active: bool) -> Evidence:
        """See :meth:`Rule.of_reading`."""
        found = reading_estimate(reading, "load_skew")
        for reason in reading.quality.reasons:
            if reason.cause is Cause.ICE_SUSPECT:
                return Evidence(True, reason.text, found, abs(found.value) if found else None)
        if found is None or self.limit is None:
            even = reading.quality.validity is not Validity.INVALID
            return Evidence(False, "the wire hangs as under an even load") if even else NOTHING
        size = abs(found.value)
        uneven = size > self.limit - (self.hysteresis if active else 0.0) and size > ICE_Z * found.u
        where = "far" if found.value > 0 else "near"
        text = (
            f"uneven load {found.value:+.2f} (standard uncertainty {found.u:.2f}), heavier at the {where} end:"
            " ice, or a weight on part of the span"
        )
        return Evidence(_unless_marked(uneven, reading), text, found, size)


@dataclass(frozen=True)
class CameraMovedRule(Rule):
    """The landmarks say that the camera was moved; what sees no landmarks shows nothing."""

    def of_reading(self, reading: ReadingHeader, *, active: bool) -> Evidence:
        """See :meth:`Rule.of_reading`."""
        del active
        for reason in reading.quality.reasons:
            if reason.cause is Cause.CAMERA_MOVED:
                return Evidence(True, reason.text)
        seen = reading.quality.validity is not Validity.INVALID and reading.landmarks_used > 0
        return Evidence(False) if seen else NOTHING


@dataclass(frozen=True)
class StaleRule(Rule):
    """No reading with a number for longer than the limit (s)."""

    def of_age(self, since: datetime, age_s: float) -> Evidence:
        """See :meth:`Rule.of_age`."""
        if self.limit is None:
            return NOTHING
        if age_s <= self.limit:
            return Evidence(False)
        text = f"no reading with a number since {since:%Y-%m-%d %H:%M} UTC (limit {self.limit / 60:.0f} min)"
        return Evidence(True, text, None, age_s, since)


def _metres(found: Estimate) -> str:
    """``9.00 m [8.90 .. 9.10]``, with as many decimals as the interval has a use for."""
    digits = found.decimals
    return f"{found.value:.{digits}f} m [{found.lo:.{digits}f} .. {found.hi:.{digits}f}]"


def _unless_marked(shows: bool, reading: ReadingHeader) -> bool | None:
    """A reading that contradicts its past may raise an alarm, but is no reason to clear one."""
    marked = any(reason.cause is Cause.THERMAL_TREND for reason in reading.quality.reasons)
    return None if marked and not shows else shows


def configured_rules(span: Span, settings: Settings) -> dict[str, list[Rule]]:
    """The rules of every measured conductor; a limit that is not configured makes no rule."""
    limits = span.limits
    swing_deg = settings.swing_deg if settings.swing_deg is not None else span.swing.questionable_deg
    rules: list[Rule] = [
        CameraMovedRule(AlarmKind.CAMERA_MOVED),
        StaleRule(AlarmKind.STALE, limit=settings.stale_after_s),
        SwingRule(AlarmKind.SWING, "swing_deg", swing_deg, settings.swing_hysteresis_deg),
        IceRule(AlarmKind.ICE_SUSPECT, "load_skew", settings.load_skew, settings.load_skew / 4),
    ]
    if limits.clearance_min_m is not None:
        rules.append(
            ClearanceRule(AlarmKind.CLEARANCE, "clearance_lo", limits.clearance_min_m, settings.clearance_hysteresis_m)
        )
    if limits.sag_max_m is not None:
        rules.append(SagRule(AlarmKind.SAG, "sag_hi", limits.sag_max_m, settings.sag_hysteresis_m))
    return {conductor.id: list(rules) for conductor in span.conductors if conductor.measured}
