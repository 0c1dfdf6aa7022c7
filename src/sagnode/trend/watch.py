"""The watch over a span's readings: remembers the last believable ones and marks what contradicts them.

A reading that is marked is published with its number; it becomes questionable (``inconsistent``), nothing else. A new
level that lasts is no mistake: clamps slip, ice falls off, lines are re-tensioned. After :attr:`Trend.accept_after_s`
of readings that agree among themselves it is taken as the conductor's, and its readings are no longer marked.

The state is a function of the readings themselves, so that after a restart :meth:`Trend.remember` restores it from the
journal. Readings of another calibration or configuration are no past to compare with.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from sagnode.config.span import Conductor
from sagnode.message import Estimate, QualityMessage, ReadingHeader, ReasonMessage, reading_estimate
from sagnode.quality import DETAIL_QUAL, Cause, Reason, Validity
from sagnode.trend.heat import EXPANSION_PER_K, SECTION_FACTOR, WEIGHT_OVER_STIFFNESS, HeatScale
from sagnode.trend.odds import WEIGHTS, Change, odds_of_mistake

log = logging.getLogger(__name__)

ODDS = 2.0
"""A reading is marked when it is this many times more likely a mistake than anything that heat and wind do."""
ACCEPT_COUNT = 3
"""A new level needs at least so many readings, however long they take."""
NEWS_FOR = timedelta(days=1)
"""So long health shows that a new level was taken as real."""
_REMEMBERED = 60
_UNKNOWN_GAP_S = 3600.0
"""Time between readings where neither clock can tell."""
_DOUBTFUL = frozenset({Cause.THERMAL_TREND, Cause.FRAMES_DISAGREE, Cause.TOO_LITTLE_VISIBLE, Cause.AMBIGUOUS})
"""Readings with these reasons are no measure for others."""


@dataclass(frozen=True)
class Watched:
    """One conductor's survey as the watch needs it."""

    scale: HeatScale
    sag_min_m: float
    sag_max_m: float
    circuit: str | None = None

    @classmethod
    def of(cls, conductor: Conductor) -> Watched:
        """From the configuration: stringing data where they are given, conservative values else."""
        ratio, expansion = WEIGHT_OVER_STIFFNESS, EXPANSION_PER_K
        if conductor.stringing is not None:
            expansion = conductor.stringing.expansion_per_k
            if conductor.unit_weight_n_m is not None:
                stiffness_n = conductor.stringing.modulus_gpa * 1e3 * conductor.stringing.section_mm2
                ratio = conductor.unit_weight_n_m / stiffness_n
        near, far = conductor.near, conductor.far
        span_m = math.hypot(far[0] - near[0], far[1] - near[1])
        scale = HeatScale(span_m, far[2] - near[2], ratio, expansion * SECTION_FACTOR)
        return cls(scale, conductor.sag_min_m, conductor.sag_max_m, conductor.circuit)

    @property
    def range_k(self) -> float:
        """Width of the surveyed range of sag, K."""
        return self.scale.temperature_k(self.sag_max_m) - self.scale.temperature_k(self.sag_min_m)


@dataclass(frozen=True)
class Level:
    """One believable reading: its equivalent temperature, and when."""

    sag: Estimate
    kelvin: float
    u: float
    at: datetime
    boot_id: str
    monotonic_s: float

    @property
    def sag_text(self) -> str:
        """As it is written: with as many decimals as its interval has a use for."""
        return f"{self.sag.value:.{self.sag.decimals}f} m"

    def seconds_since(self, earlier: Level) -> float:
        """Time since an earlier one; the longer of the two clocks' answers, since a longer time forgives more."""
        answers = []
        if self.boot_id == earlier.boot_id and self.monotonic_s > earlier.monotonic_s:
            answers.append(self.monotonic_s - earlier.monotonic_s)
        by_day = (self.at - earlier.at).total_seconds()
        if by_day > 0:
            answers.append(by_day)
        return max(answers, default=_UNKNOWN_GAP_S)

    def since(self, earlier: Level) -> Change:
        """The change from an earlier one."""
        u = max(math.hypot(self.u, earlier.u), 1e-3)
        return Change(self.kelvin - earlier.kelvin, u, self.seconds_since(earlier))


@dataclass
class _Past:
    """What is remembered of one conductor, oldest first."""

    origin: tuple[str, str] = ("", "")
    """Calibration and configuration of the readings."""
    believed: list[Level] = field(default_factory=list)
    doubted: list[Level] = field(default_factory=list)
    """Marked readings since the last believed one."""

    def believe(self, level: Level) -> None:
        if self.doubted and (not self.believed or _nearer(level, self.doubted[-1], self.believed[-1])):
            self.believed = self.doubted
        self.believed = [*self.believed, level][-_REMEMBERED:]
        self.doubted = []


class Trend:
    """Watches the measured conductors of one span.

    Args:
        watched: by conductor id.
        accept_after_s: a new level that has lasted so long, in at least three readings, is taken as real.
    """

    def __init__(self, watched: dict[str, Watched], accept_after_s: float) -> None:
        self.accept_after_s = accept_after_s
        self._watched = watched
        self._pasts = {conductor: _Past() for conductor in watched}
        self._news: tuple[datetime, str] | None = None

    @property
    def state(self) -> str:
        """One line for health: ``ok``, which conductors are under doubt, or for a day a new level taken as real."""
        doubted = [f"{c} ({len(p.doubted)} readings)" for c, p in self._pasts.items() if p.doubted]
        if doubted:
            return f"contradicts its past: {', '.join(doubted)}"
        return f"at {self._news[0]:%Y-%m-%d %H:%M} UTC {self._news[1]}" if self._news else "ok"

    def remember(self, readings: Iterable[ReadingHeader]) -> None:
        """Take note of readings that were judged already, oldest first."""
        for reading in readings:
            level = self._level(reading)
            past = self._pasts.get(reading.conductor)
            if level is None or past is None:
                continue
            self._begin_anew_if_other(past, reading)
            causes = {reason.cause for reason in reading.quality.reasons}
            if Cause.THERMAL_TREND in causes:
                past.doubted.append(level)
            elif not causes & _DOUBTFUL:
                past.believe(level)

    def judge(self, burst: Sequence[ReadingHeader]) -> list[ReadingHeader]:
        """The readings of one burst, those marked that contradict the past; and remember them."""
        levels: dict[str, Level] = {}
        for reading in burst:
            level = self._level(reading)
            if level is not None and reading.conductor in self._pasts:
                self._begin_anew_if_other(self._pasts[reading.conductor], reading)
                levels[reading.conductor] = level
                if self._news and level.at - self._news[0] > NEWS_FOR:
                    self._news = None
        reasons = {conductor: self._doubt(conductor, levels) for conductor in levels}
        judged = [_marked(reading, reasons.get(reading.conductor)) for reading in burst]
        self.remember(judged)
        return judged

    def _doubt(self, conductor: str, levels: dict[str, Level]) -> Reason | None:
        """Why this reading contradicts the past, or None."""
        past, level = self._pasts[conductor], levels[conductor]
        if not past.believed:
            return None
        agreeing = self._agreeing(conductor, level)
        odds = self._odds(conductor, past.believed, levels)
        if odds < ODDS and not (agreeing and _nearer(level, agreeing[-1], past.believed[-1])):
            return None
        newest = past.believed[-1]
        if len(agreeing) + 1 >= ACCEPT_COUNT and level.seconds_since(agreeing[0]) >= self.accept_after_s:
            text = (
                f"{conductor}: sag is {level.sag_text} and was {newest.sag_text}; no heat explains that, but it"
                " has lasted, and is taken as real from here on: look at clamps, ice and trees"
            )
            log.warning("%s", text)
            self._news = (level.at, text)
            return None
        return Reason(Cause.THERMAL_TREND, self._text(conductor, levels))

    def _odds(self, conductor: str, earlier: Sequence[Level], levels: dict[str, Level]) -> float:
        level = levels[conductor]
        since = [(level.since(b), self._others_since(conductor, b, levels)) for b in earlier[: -len(WEIGHTS) - 1 : -1]]
        return odds_of_mistake(since, self._watched[conductor].range_k)

    def _others_since(self, conductor: str, before: Level, levels: dict[str, Level]) -> list[Change]:
        """How the other conductors of the circuit changed since the same earlier burst."""
        circuit = self._watched[conductor].circuit
        return [
            now.since(then)
            for other, now in levels.items()
            for then in self._pasts[other].believed
            if other != conductor and self._watched[other].circuit == circuit and then.at == before.at
        ]

    def _agreeing(self, conductor: str, level: Level) -> list[Level]:
        """The newest marked readings that agree with each other and with this one, oldest first."""
        agreeing: list[Level] = []
        following = level
        for before in reversed(self._pasts[conductor].doubted):
            if odds_of_mistake([(following.since(before), ())], self._watched[conductor].range_k) >= ODDS:
                break
            agreeing.insert(0, before)
            following = before
        return agreeing

    def _text(self, conductor: str, levels: dict[str, Level]) -> str:
        level, newest = levels[conductor], self._pasts[conductor].believed[-1]
        change = level.since(newest)
        text = (
            f"sag {level.sag_text} after {newest.sag_text} {_time_text(change.after_s)} ago:"
            f" {change.kelvin:+.0f} K of conductor temperature"
        )
        others = self._others_since(conductor, newest, levels)
        if others:
            text += f", while the others changed by {', '.join(f'{other.kelvin:+.0f}' for other in others)} K"
        lasting = _time_text(self.accept_after_s)
        return f"{text}; heat and wind do not explain that; taken as real when it has lasted {lasting}"

    def _level(self, reading: ReadingHeader) -> Level | None:
        watched = self._watched.get(reading.conductor)
        # The swung conductor's own sag does not change with the wind as its vertical part does.
        sag = reading_estimate(reading, "inplane_sag") or reading_estimate(reading, "sag")
        if watched is None or sag is None or reading.quality.validity is Validity.INVALID:
            return None
        if not 0.01 * watched.sag_min_m < sag.value < 100 * watched.sag_max_m:  # of no wire, and of no use to others
            return None
        swing = reading_estimate(reading, "swing")
        heavier = 1 / max(math.cos(math.radians(swing.value)), 0.1) - 1 if swing is not None else 0.0
        scale = watched.scale
        return Level(
            sag=sag,
            kelvin=scale.temperature_k(sag.value),
            u=math.hypot(sag.u * scale.kelvin_per_m(sag.value), scale.stretch_k(sag.value) * heavier),
            at=reading.acquired_at,
            boot_id=reading.boot_id,
            monotonic_s=reading.monotonic_s,
        )

    @staticmethod
    def _begin_anew_if_other(past: _Past, reading: ReadingHeader) -> None:
        origin = (reading.calibration_id, reading.configuration_id)
        if past.origin != origin:
            past.origin, past.believed, past.doubted = origin, [], []


def _nearer(level: Level, one: Level, other: Level) -> bool:
    return abs(level.kelvin - one.kelvin) < abs(level.kelvin - other.kelvin)


def _marked(reading: ReadingHeader, reason: Reason | None) -> ReadingHeader:
    """The reading with one reason more; good becomes questionable, and no number changes."""
    if reason is None:
        return reading
    quality = reading.quality
    words = dict.fromkeys((*quality.detail_qual, DETAIL_QUAL[reason.cause]))
    marked = QualityMessage(
        validity=Validity.QUESTIONABLE,
        detail_qual=tuple(words),
        reasons=(*quality.reasons, ReasonMessage.of(reason)),
        source=quality.source,
        test=quality.test,
    )
    return reading.model_copy(update={"quality": marked})


def _time_text(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"
