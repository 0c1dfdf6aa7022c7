"""Readings of a replay beside earlier ones of the same frames: a journal's, an export's, another replay's."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sagnode.daemon.journal_reader import Rows, Wanted
from sagnode.daemon.places import JOURNAL
from sagnode.digits import decimals
from sagnode.errors import SagnodeError
from sagnode.message import ReadingHeader

SHOWN = 10
"""Differences that are told one by one."""
_SQLITE = b"SQLite format 3\x00"
Key = tuple[datetime, str]


@dataclass(frozen=True)
class Comparison:
    """What differs."""

    lines: list[str]
    """For a screen."""
    differs: bool
    """Whether any reading has another validity, or a value farther away than its own standard uncertainty."""


def earlier_readings(path: Path) -> dict[Key, dict[str, Any]]:
    """Published readings by time of acquisition and conductor; of several of one time the last counts.

    Args:
        path: a journal, the state directory that holds it, or a file of JSON lines.

    Raises:
        SagnodeError: there are no readings to be had from there.
    """
    journal = path / JOURNAL if path.is_dir() else path
    try:
        with journal.open("rb") as file:
            binary = file.read(len(_SQLITE)) == _SQLITE
    except OSError as error:
        raise SagnodeError(f"cannot read {journal}: {error.strerror}", "name what to compare with") from None
    documents = (stored.document for stored in Rows(journal, Wanted())) if binary else _json_lines(journal)
    return {_key(document["acquired_at"], document["conductor"]): document for document in documents}


def _json_lines(path: Path) -> Iterator[dict[str, Any]]:
    remedy = "give what sagnode replay --out or sagnode export --format jsonl wrote"
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            try:
                document = json.loads(line)
                if not {"acquired_at", "conductor", "quality"} <= document.keys():
                    raise ValueError("not a reading")
                datetime.fromisoformat(document["acquired_at"])
            except (ValueError, AttributeError, TypeError):
                raise SagnodeError(f"{path}:{number}: no reading as a JSON object", remedy) from None
            yield document


def _key(at: str | datetime, conductor: str) -> Key:
    time = datetime.fromisoformat(at) if isinstance(at, str) else at
    # files tell the second, cameras and journals its millionth
    return time.astimezone(UTC).replace(microsecond=0), conductor


def compare(readings: Iterable[ReadingHeader], earlier: dict[Key, dict[str, Any]]) -> Comparison:
    """Readings beside the earlier ones of the same second and conductor."""
    differences: list[str] = []
    sags: list[float] = []
    common = 0
    own = list(readings)
    for reading in own:
        before = earlier.get(_key(reading.acquired_at, reading.conductor))
        if before is None:
            continue
        common += 1
        now = reading.model_dump(mode="json")
        if now.get("sag_m") is not None and before.get("sag_m") is not None:
            sags.append(now["sag_m"] - before["sag_m"])
        difference = _difference(now, before)
        if difference:
            differences.append(f"  {reading.acquired_at:%Y-%m-%d %H:%M:%S} {reading.conductor}: {difference}")
    lines = [f"{common} of {len(own)} readings have an earlier one beside them; {len(differences)} differ"]
    if sags:
        rms = math.sqrt(sum(d * d for d in sags) / len(sags))
        worst = max(sags, key=abs)
        lines.append(
            f"sag now minus then, {len(sags)} readings: RMS {1000 * rms:.1f} mm, at most {1000 * worst:+.1f} mm"
        )
    lines += differences[:SHOWN]
    if len(differences) > SHOWN:
        lines.append(f"  ... and {len(differences) - SHOWN} more")
    return Comparison(lines, bool(differences))


def _difference(now: dict[str, Any], before: dict[str, Any]) -> str:
    """What a reader would act upon: another validity, or a number elsewhere than its uncertainty allows."""
    was, is_ = before["quality"]["validity"], now["quality"]["validity"]
    if was != is_:
        causes = ", ".join(reason["cause"] for reason in now["quality"]["reasons"])
        return f"{was} became {is_}" + (f" ({causes})" if causes else "")
    for field in ("sag", "clearance"):
        value, then, u = now.get(f"{field}_m"), before.get(f"{field}_m"), now.get(f"{field}_u")
        if value is not None and then is not None and u is not None and abs(value - then) > u:
            digits = decimals(u)
            return f"{field} {then:.{digits}f} m became {value:.{digits}f} m (u {u:.{digits}f} m)"
    return ""
