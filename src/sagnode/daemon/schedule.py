"""When the next reading is due: APScheduler's triggers, asked one slot at a time.

Missed slots cannot pile up, because only the first slot after *now* is ever computed; the decision record
``docs/decisions/0001-triggers-without-the-scheduler.md`` says why APScheduler's own scheduler is not used.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from apscheduler.triggers.base import BaseTrigger
from apscheduler.triggers.cron import CronTrigger
from apscheduler.triggers.interval import IntervalTrigger

from sagnode.errors import ConfigError

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_TICK = timedelta(microseconds=1)


class Schedule:
    """The slots of one node, in UTC.

    Args:
        interval_s: a slot every so many seconds, counted from ``anchor``.
        cron: or five crontab fields, days of the week by name or, as crontab has it, 0 for Sunday.
        anchor: start of the count; the default puts 900 s on the quarters of each hour, whenever the node starts.

    Raises:
        ConfigError: the crontab expression is not understood.
    """

    def __init__(
        self, interval_s: float | None = None, cron: str | None = None, anchor: datetime | None = None
    ) -> None:
        self._trigger: BaseTrigger
        if cron is not None:
            self._trigger = _cron_trigger(cron)
        else:
            self._trigger = IntervalTrigger(seconds=interval_s, start_date=anchor or _EPOCH, timezone=UTC)

    def next_after(self, instant: datetime) -> datetime | None:
        """First slot later than ``instant``; None when there will never be one (a 30th of February)."""
        slot: datetime | None = self._trigger.get_next_fire_time(None, instant + _TICK)
        while slot is not None and slot <= instant:  # a float's rounding
            slot = self._trigger.get_next_fire_time(slot, slot + _TICK)
        return slot.astimezone(UTC) if slot else None

    def gap_s(self, instant: datetime) -> float:
        """Seconds between the two slots that follow ``instant``; infinite when there are none."""
        first = self.next_after(instant)
        second = self.next_after(first) if first else None
        return (second - first).total_seconds() if first and second else float("inf")


def _cron_trigger(expression: str) -> CronTrigger:
    fields = expression.split()
    remedy = 'give five crontab fields in UTC, such as "*/15 6-20 * * *"'
    if len(fields) != 5:
        raise ConfigError(f"schedule.cron = {expression!r} has {len(fields)} fields", remedy)
    try:
        return CronTrigger(
            minute=fields[0],
            hour=fields[1],
            day=fields[2],
            month=fields[3],
            day_of_week=_weekdays_by_name(fields[4]),
            timezone=UTC,
        )
    except ValueError as error:
        raise ConfigError(f"schedule.cron = {expression!r}: {error}", remedy) from error


def _weekdays_by_name(field: str) -> str:
    """Crontab's weekday numbers (0 and 7 are Sunday) as names: APScheduler counts its numbers from Monday.

    >>> _weekdays_by_name("1-5"), _weekdays_by_name("0,6"), _weekdays_by_name("mon"), _weekdays_by_name("5-7")
    ('mon,tue,wed,thu,fri', 'sun,sat', 'mon', 'fri,sat,sun')
    """
    names = ("sun", "mon", "tue", "wed", "thu", "fri", "sat", "sun")
    parts: list[str] = []
    for part in field.split(","):
        days, _, step = part.partition("/")
        first, _, last = days.partition("-")
        if days == "*" and step.isdigit():
            parts += names[0 : 7 : max(1, int(step))]
        elif first.isdigit() and (not last or last.isdigit()) and int(first) <= 7 and int(last or first) <= 7:
            end = int(last) if last else (6 if step else int(first))
            parts += names[int(first) : end + 1 : int(step) if step.isdigit() and int(step) else 1]
        else:
            parts.append(part)
    return ",".join(parts)
