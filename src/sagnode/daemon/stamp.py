"""From what the worker measured, or why it did not, to readings that bear identity, time and quality.

The daemon's last look at a number before it is believed: whatever contradicts itself becomes an invalid reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime

from pydantic import ValidationError

from sagnode.message import SEEN, Estimate, Identity, QualityMessage, Reading, ReadingHeader, estimate_fields
from sagnode.quality import Cause, Reason, Validity
from sagnode.worker.protocol import ConductorResult, MeasureReply

UNNUMBERED = 1
"""Sequence of a reading that the journal has not numbered yet."""


@dataclass(frozen=True)
class Stamp:
    """What all readings of a node have in common."""

    identity: Identity
    conductors: dict[str, str | None]
    """Measured conductors and their phases, in the survey's order."""
    method: str
    configuration_id: str
    software_version: str
    boot_id: str
    test: bool

    def reply(self, reply: MeasureReply, *, clock_synced: bool, calibration_id: str) -> list[ReadingHeader]:
        """Readings of a burst: one for each measured conductor, whatever the worker left out."""
        results = {result.conductor: result for result in reply.results}
        moment = _Moment(reply.acquired_at, reply.monotonic_s, clock_synced, calibration_id)
        return [self._one(conductor, results.get(conductor), moment) for conductor in self.conductors]

    def refusal(
        self, reason: Reason, *, at: datetime, monotonic_s: float, clock_synced: bool, calibration_id: str
    ) -> list[ReadingHeader]:
        """Invalid readings of all conductors for one reason."""
        moment = _Moment(at, monotonic_s, clock_synced, calibration_id)
        return [self._invalid(conductor, (reason,), moment) for conductor in self.conductors]

    def _one(self, conductor: str, result: ConductorResult | None, moment: _Moment) -> ReadingHeader:
        if result is None:
            reason = Reason(Cause.WORKER_GARBAGE, "the worker did not mention this conductor")
            return self._invalid(conductor, (reason,), moment)
        reasons = tuple(Reason(r.cause, r.text) for r in result.reasons)
        if result.validity is Validity.INVALID:
            return self._invalid(conductor, reasons, moment, result)
        contradiction = _contradiction(result)
        if contradiction:
            reason = Reason(Cause.WORKER_GARBAGE, f"the worker's numbers contradict themselves: {contradiction}")
            return self._invalid(conductor, (reason, *reasons), moment)
        try:
            return Reading(
                **self._header(conductor, QualityMessage.of(result.validity, reasons, test=self.test), moment),
                **_seen(result),
                **estimate_fields(result.estimates),
            )
        except ValidationError as error:
            first = error.errors()[0]
            text = f"the worker's numbers are not possible: {'.'.join(map(str, first['loc']))}: {first['msg']}"
            return self._invalid(conductor, (Reason(Cause.WORKER_GARBAGE, text),), moment)

    def _invalid(
        self, conductor: str, reasons: tuple[Reason, ...], moment: _Moment, result: ConductorResult | None = None
    ) -> ReadingHeader:
        header = self._header(conductor, QualityMessage.of(Validity.INVALID, reasons, test=self.test), moment)
        unseen = {"frames_used": 0, "frames_rejected": 0, "method": self.method}
        try:
            return Reading(**header, **(_seen(result) if result else unseen))
        except ValidationError:
            return Reading(**header, **unseen)

    def _header(self, conductor: str, quality: QualityMessage, moment: _Moment) -> dict[str, object]:
        return {
            **self.identity.model_dump(),
            "conductor": conductor,
            "phase": self.conductors[conductor],
            "sequence": UNNUMBERED,
            "acquired_at": moment.at,
            "clock_synced": moment.clock_synced,
            "boot_id": self.boot_id,
            "monotonic_s": moment.monotonic_s,
            "quality": quality,
            "calibration_id": moment.calibration_id,
            "configuration_id": self.configuration_id,
            "software_version": self.software_version,
        }


@dataclass(frozen=True)
class _Moment:
    at: datetime
    monotonic_s: float
    clock_synced: bool
    calibration_id: str


def _seen(result: ConductorResult) -> dict[str, object]:
    return {name: getattr(result, name) for name in SEEN}


def _contradiction(result: ConductorResult) -> str | None:
    """Why these estimates cannot be a reading, or None."""
    if "sag" not in result.estimates:
        return f"{result.validity} without a sag"
    for stem, estimate in result.estimates.items():
        if not _ordered(estimate):
            return f"{stem} {estimate.value:g} is not within its interval {estimate.lo:g} to {estimate.hi:g}"
    return None


def _ordered(estimate: Estimate) -> bool:
    finite = all(math.isfinite(number) for number in estimate)
    return finite and estimate.u >= 0 and estimate.lo <= estimate.value <= estimate.hi
