"""The day's readings beside the simulated truth, and what that comes to."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from sagnode.message import Estimate, ReadingHeader, reading_estimate
from sagnode.quality import Validity


@dataclass(frozen=True)
class Truth:
    """What the scene generator knows of one conductor in one frame, metres."""

    sag: float
    clearance: float


@dataclass(frozen=True)
class Point:
    """One reading and its truth, where the frame has one beside it."""

    reading: ReadingHeader
    truth: Truth | None

    @property
    def time(self) -> datetime:
        """Of the frame."""
        return self.reading.acquired_at

    @property
    def validity(self) -> Validity:
        """Of the reading."""
        return self.reading.quality.validity

    def estimate(self, stem: str) -> Estimate | None:
        """The published estimate of ``sag`` or ``clearance``."""
        return reading_estimate(self.reading, stem)


@dataclass(frozen=True)
class Score:
    """How readings of one quantity compare with the truth."""

    count: int
    rmse: float
    """metres"""
    rmse_percent: float
    """of the true value"""
    covered: int
    """So many 95 % intervals held the truth."""


@dataclass(frozen=True)
class Delivery:
    """What became of the sequence numbers between journal and subscriber."""

    journalled: int
    lost: tuple[int, ...]
    repeated: tuple[int, ...]


def read_truth(frames: Path) -> dict[tuple[datetime, str], Truth]:
    """Truth by time and conductor, out of the JSON files beside the frames; empty where there are none."""
    truth: dict[tuple[datetime, str], Truth] = {}
    for file in sorted(frames.glob("*.json")):
        try:
            document = json.loads(file.read_text(encoding="utf-8"))
            time = datetime.fromisoformat(document["time"]).astimezone(UTC)
            for conductor, values in document["conductors"].items():
                truth[time, conductor] = Truth(float(values["sag_m"]), float(values["clearance_m"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue  # a JSON file of somebody else's
    return truth


def join(readings: Iterable[ReadingHeader], truth: dict[tuple[datetime, str], Truth]) -> list[Point]:
    """Each reading once (repeats are dropped by their sequence), in the order of frames and conductors."""
    unique = {reading.sequence: reading for reading in readings}
    points = [Point(r, truth.get((r.acquired_at.astimezone(UTC), r.conductor))) for r in unique.values()]
    return sorted(points, key=lambda point: (point.time, point.reading.conductor))


def score(points: Iterable[Point], stem: str) -> Score | None:
    """Error and coverage of one quantity over the readings that have values and truth; None when there are none."""
    pairs = []
    for point in points:
        estimate = point.estimate(stem)
        if estimate is not None and point.truth is not None:
            pairs.append((estimate, float(getattr(point.truth, stem))))
    if not pairs:
        return None
    squares = [(estimate.value - true) ** 2 for estimate, true in pairs]
    relative = [((estimate.value - true) / true) ** 2 for estimate, true in pairs]
    covered = sum(estimate.lo <= true <= estimate.hi for estimate, true in pairs)
    return Score(len(pairs), math.sqrt(_mean(squares)), 100 * math.sqrt(_mean(relative)), covered)


def delivery(journalled: Sequence[int], received: Sequence[int]) -> Delivery:
    """Compare the journal's sequence numbers with those that arrived."""
    counts = Counter(received)
    lost = tuple(sorted(set(journalled) - set(counts)))
    repeated = tuple(sorted(number for number, count in counts.items() if count > 1))
    return Delivery(len(journalled), lost, repeated)


def summary(points: Sequence[Point], sent: Delivery) -> list[str]:
    """The day in a few lines."""
    return [
        *readings_summary(points),
        f"delivery: {sent.journalled} in the journal, {len(sent.lost)} lost, {len(sent.repeated)} repeated"
        + (f"; lost: {_numbers(sent.lost)}" if sent.lost else ""),
    ]


def readings_summary(points: Sequence[Point]) -> list[str]:
    """How many readings of which quality, and how they compare with the truth where there is one."""
    by_validity = Counter(point.validity for point in points)
    counts = ", ".join(f"{by_validity[validity]} {validity}" for validity in Validity)
    lines = [f"{len(points)} readings of {len({p.time for p in points})} frames: {counts}"]
    refused = [point.reading.quality.reasons for point in points if point.validity is Validity.INVALID]
    causes = Counter(cause for reasons in refused for cause in {reason.cause: None for reason in reasons})
    if causes:
        several = sum(len({reason.cause for reason in reasons}) > 1 for reasons in refused)
        lines.append(
            "invalid because of "
            + ", ".join(f"{cause} ({count})" for cause, count in causes.most_common())
            + (f"; {several} of them for more than one of these" if several else "")
        )
    for stem in ("sag", "clearance"):
        for name, chosen in (("good", [p for p in points if p.validity is Validity.GOOD]), ("all valid", points)):
            result = score(chosen, stem)
            if result is not None:
                share = 100 * result.covered / result.count
                lines.append(
                    f"{stem + ',':<10} {name + ':':<10} RMSE {100 * result.rmse:.1f} cm ({result.rmse_percent:.2f} %),"
                    f" 95 % interval holds the truth {result.covered} of {result.count} times ({share:.0f} %)"
                )
    return lines


def best_frame(points: Sequence[Point]) -> datetime | None:
    """The frame to show: as many good readings as can be, and of those the surest; None when none has values."""
    frames: dict[datetime, list[Point]] = {}
    for point in points:
        if point.estimate("sag") is not None:
            frames.setdefault(point.time, []).append(point)
    if not frames:
        return None

    def worth(time: datetime) -> tuple[int, int, float]:
        group = frames[time]
        spread = sum(estimate.u for p in group if (estimate := p.estimate("sag")) is not None)
        return sum(p.validity is Validity.GOOD for p in group), len(group), -spread

    return max(frames, key=worth)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _numbers(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:10])) + (" ..." if len(numbers) > 10 else "")
