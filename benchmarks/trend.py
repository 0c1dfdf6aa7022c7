"""How often the temporal model marks a sound reading, and how often a wrong one, on simulated days.

    python benchmarks/trend.py [--days 20] [--seed 1] [--out docs/trend.md]

Three phases of the demonstration's span heat and cool by the transient heat balance of IEEE Std 738-2012 (convection,
radiation, sun, current; 775 J/(m K) for 243-AL1/39-ST1A) in wind, clouds and a load that varies and steps; their sags
follow by the state-change equation. Readings err by 1 cm at random and state a standard uncertainty of 2.5 cm. Wrong
readings are put in one at a time. Everything is the same for the same options.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path

import numpy as np

from sagnode.config.load import load_span
from sagnode.config.span import Span
from sagnode.message import Estimate, QualityMessage, Reading, ReadingHeader, estimate_fields
from sagnode.quality import Cause, Validity
from sagnode.scene.day import sag_at_temperature
from sagnode.trend.watch import Trend, Watched

DIAMETER_M, HEAT_CAPACITY, R20, RATED_A = 0.0218, 775.0, 0.1188e-3, 645.0
STEP_S = 10.0
RANDOM_M, STATED_M = 0.010, 0.025
CADENCES_S = (60, 300, 900, 1800, 3600)
ACCEPT_AFTER_S = 1800.0
SPAN = load_span(Path(str(files("sagnode.demo") / "site" / "span.toml"))).span
WATCHED = {c.id: Watched.of(c) for c in SPAN.conductors if c.measured}

Day = dict[str, np.ndarray]
"""Sag of every conductor each ten seconds."""
Mistake = Callable[[float, np.random.Generator], float]
"""From the true sag to a wrong one."""


def heating(temp: float, air: float, wind: float, angle: float, sun: float, current: float) -> float:
    """Rate of the conductor's temperature, K/s: IEEE Std 738-2012, equations 2, 3a-5a, 7a, 8 and 10."""
    film = (temp + air) / 2
    density, conductivity = 1.293 / (1 + 0.00367 * film), 2.424e-2 + 7.477e-5 * film - 4.407e-9 * film**2
    reynolds = DIAMETER_M * density * wind / (1.458e-6 * (film + 273) ** 1.5 / (film + 383.4))
    direction = 1.194 - math.cos(angle) + 0.194 * math.cos(2 * angle) + 0.368 * math.sin(2 * angle)
    forced = direction * conductivity * max(1.01 + 1.35 * reynolds**0.52, 0.754 * reynolds**0.6) * (temp - air)
    free = 3.645 * density**0.5 * DIAMETER_M**0.75 * abs(temp - air) ** 1.25 * math.copysign(1, temp - air)
    convection = max(forced, free, key=abs)
    radiation = 17.8 * DIAMETER_M * 0.7 * (((temp + 273) / 100) ** 4 - ((air + 273) / 100) ** 4)
    gain = current**2 * R20 * (1 + 0.00403 * (temp - 20)) + 0.8 * sun * DIAMETER_M
    return (gain - convection - radiation) / HEAT_CAPACITY


def walk(rng: np.random.Generator, count: int, correlation_s: float) -> np.ndarray:
    """A stationary random walk of unit variance."""
    kept = math.exp(-STEP_S / correlation_s)
    noise, value = rng.standard_normal(count) * math.sqrt(1 - kept**2), rng.standard_normal()
    out = np.empty(count)
    for i in range(count):
        value = kept * value + noise[i]
        out[i] = value
    return out


def day_of_sags(span: Span, rng: np.random.Generator) -> Day:
    """Sag (m) of every phase each ten seconds of a day with gusts, clouds, a varying load and several steps of it."""
    count = int(86400 / STEP_S)
    hour = np.arange(count) * STEP_S / 3600
    air = 18 - 7 * np.cos((hour - 3) / 24 * 2 * math.pi) + 0.7 * walk(rng, count, 3600)
    wind = np.abs(rng.uniform(0.5, 5) * (1 + 0.5 * walk(rng, count, 1500) + 0.25 * walk(rng, count, 60))) + 0.2
    angle = math.pi / 2 * np.abs(np.sin(walk(rng, count, 2400)))
    clear = 1 / (1 + np.exp(-3 * (walk(rng, count, 900) + rng.uniform(-1, 2))))
    sun = 950 * np.clip(np.sin((hour - 6) / 12 * math.pi), 0, 1) * (0.2 + 0.8 * clear)
    load = rng.uniform(0.3, 0.6) + 0.25 * np.sin((hour - 9) / 24 * 2 * math.pi) + 0.04 * walk(rng, count, 900)
    for start in rng.uniform(0, 24, rng.poisson(4)):  # switching: another line takes over, or this one is switched off
        load[(hour > start) & (hour < start + rng.exponential(2.0))] = rng.choice([0.0, 0.5, 0.9, 1.0])
    sags = {}
    for conductor in (c for c in span.conductors if c.measured):
        shelter = (1 + 0.05 * rng.standard_normal()) * (1 + 0.08 * walk(rng, count, 600))
        table = np.arange(-40.0, 140.0)
        hang = np.array([sag_at_temperature(conductor, t) for t in table])
        temp, temps = float(air[0]) + 10, np.empty(count)
        for i in range(count):
            current = RATED_A * min(max(load[i], 0.0), 1.05)
            temp += STEP_S * heating(temp, air[i], max(wind[i] * shelter[i], 0.05), angle[i], sun[i], current)
            temps[i] = temp
        sags[conductor.id] = np.interp(temps, table, hang)
    return sags


def reading(conductor: str, at: datetime, sag_m: float) -> ReadingHeader:
    """A good reading of this sag."""
    sag = Estimate(sag_m, STATED_M, sag_m - 1.96 * STATED_M, sag_m + 1.96 * STATED_M)
    return Reading(
        utility="u", line="l", span="s", unit="n", conductor=conductor, sequence=1, acquired_at=at, clock_synced=True,
        boot_id="b", monotonic_s=0.0, quality=QualityMessage(validity=Validity.GOOD), frames_used=1, frames_rejected=0,
        method="simulated", calibration_id="c", configuration_id="c", software_version="0",
        **estimate_fields({"sag": sag}),
    )  # fmt: skip


def bursts(sags: Day, cadence_s: int, rng: np.random.Generator) -> Iterator[list[ReadingHeader]]:
    """Readings of the day at one cadence."""
    start = datetime(2026, 6, 21, tzinfo=UTC)
    for i in range(0, int(86400 / STEP_S), int(cadence_s / STEP_S)):
        at = start + timedelta(seconds=i * STEP_S)
        yield [reading(c, at, float(s[i]) + RANDOM_M * rng.standard_normal()) for c, s in sags.items()]


def marked(readings: list[ReadingHeader]) -> dict[str, bool]:
    """Which conductors' readings are marked."""
    return {r.conductor: any(x.cause is Cause.THERMAL_TREND for x in r.quality.reasons) for r in readings}


@dataclass(frozen=True)
class Tally:
    """What became of the readings of some days."""

    wrong: int = 0
    wrong_marked: int = 0
    sound: int = 0
    sound_marked: int = 0


def judge_days(days: list[Day], cadence_s: int, mistake: Mistake | None, seed: int) -> Tally:
    """Put a mistake into one reading every so many bursts (none without a kind of mistake), and count the marks."""
    rng = np.random.default_rng(seed)
    wrong = wrong_marked = sound = sound_marked = 0
    every = 20 if cadence_s < 1800 else 5
    for day in days:
        trend, ids = Trend({c: WATCHED[c] for c in day}, ACCEPT_AFTER_S), list(day)
        for number, burst in enumerate(bursts(day, cadence_s, rng)):
            victim = ids[int(rng.integers(len(ids)))] if mistake and number % every == every - 1 else ""
            given = [
                reading(r.conductor, r.acquired_at, mistake(float(r.sag_m), rng))
                if mistake and r.conductor == victim
                else r
                for r in burst
            ]
            for conductor, mark in marked(trend.judge(given)).items():
                wrong, wrong_marked = wrong + (conductor == victim), wrong_marked + (mark and conductor == victim)
                sound, sound_marked = sound + (conductor != victim), sound_marked + (mark and conductor != victim)
    return Tally(wrong, wrong_marked, sound, sound_marked)


def by_share(share: float) -> Mistake:
    """A sag that is too large or too small by this share."""
    return lambda sag, rng: sag * (1 + share * rng.choice([-1, 1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="write the tables there as well")
    options = parser.parse_args()
    command = f"python benchmarks/trend.py --days {options.days} --seed {options.seed}"
    lines = [
        "# Readings that contradict those before them",
        "",
        f"Written by `{command} --out docs/trend.md`; do not edit.",
        *(line.strip() for line in (__doc__ or "").split("\n\n", 2)[2].splitlines()),
        "Mistakes of a few centimetres, such as the sag of a phase that hangs nearly alike, are below what any past",
        "can tell; and where readings are rare, one conductor alone may have done nearly anything in between.",
    ]
    days = [day_of_sags(SPAN, np.random.default_rng((options.seed, k))) for k in range(options.days)]
    earth = next(c for c in SPAN.conductors if c.id == "earth")
    middle = (earth.sag_min_m + earth.sag_max_m) / 2
    mistakes: dict[str, Mistake] = {f"{share:.0%} of sag": by_share(share) for share in (0.05, 0.1, 0.2)}
    mistakes["the earth wire's"] = lambda _, rng: middle + 0.1 * rng.standard_normal()
    mistakes["the next phase's"] = lambda sag, _: sag * 10500 / 10420
    mistakes["anywhere in the range"] = lambda _, rng: rng.uniform(6.0, 11.5)
    sites = {
        "three phases": days,
        "one conductor alone": [{"L1": day["L1"]} for day in days],
        "one phase of each of two circuits that the survey does not name": [
            {"L1": one["L1"], "L2": other["L2"]} for one, other in zip(days, days[1:] + days[:1], strict=True)
        ],
    }
    for title, given in sites.items():
        lines += ["", f"**{title[0].upper()}{title[1:]}**: sound readings marked, and share of mistakes marked", ""]
        lines.append("| cadence | largest change | sound | " + " | ".join(mistakes) + " |")
        lines.append("|---|---|---|" + "---|" * len(mistakes))
        for cadence in CADENCES_S:
            largest = max(np.abs(np.diff(day["L1"][:: int(cadence / STEP_S)])).max() for day in given)
            plain = judge_days(given, cadence, None, options.seed)
            cells = []
            for mistake in mistakes.values():
                tally = judge_days(given, cadence, mistake, options.seed)
                beside = f", {tally.sound_marked} sound" if tally.sound_marked > plain.sound_marked else ""
                cells.append(f"{tally.wrong_marked / tally.wrong:.0%}{beside}")
            first = f"| {cadence // 60} min | {largest:.2f} m | {plain.sound_marked} of {plain.sound} | "
            lines.append(first + " | ".join(cells) + " |")
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if options.out:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
