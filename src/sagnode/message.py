"""The messages that leave the node: what a subscriber, the journal and ``sagnode status`` read.

All lengths are metres, angles degrees, times RFC 3339 UTC. Every quantity ``X`` is published as its value
(``sag_m``), its standard uncertainty (``sag_u``, GUM) and a 95 % interval (``sag_lo``, ``sag_hi``) in the same unit.
An invalid reading carries null in all four. This module imports neither NumPy nor OpenCV.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal, NamedTuple

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, create_model

from sagnode.digits import decimals
from sagnode.quality import Cause, DetailQual, LensLook, Reason, Validity


class Quantity(NamedTuple):
    """A quantity that is published: its stem, the unit's suffix, and what it means."""

    stem: str
    unit: str
    meaning: str

    @property
    def value_field(self) -> str:
        """Name of the field that holds the value, e.g. ``sag_m``; a mere number has no unit to name."""
        return f"{self.stem}_{self.unit}" if self.unit else self.stem

    @property
    def fields(self) -> tuple[str, str, str, str]:
        """Names of the fields that hold value, standard uncertainty, and the interval's lower and upper end."""
        return self.value_field, f"{self.stem}_u", f"{self.stem}_lo", f"{self.stem}_hi"


SEEN = (
    "frames_used",
    "frames_rejected",
    "visible_share",
    "match_score",
    "pose_residual_px",
    "landmarks_used",
    "landmarks_by_appearance",
    "oldest_appearance_at",
    "method",
)
"""What a reading says of how it came about, as the worker hands it on; names of fields."""
QUANTITIES: tuple[Quantity, ...] = (
    Quantity("sag", "m", "chord sag: greatest vertical distance from the straight line A-B down to the conductor"),
    Quantity("inplane_sag", "m", "the same in the conductor's swung plane, along apparent gravity"),
    Quantity("swing", "deg", "angle of the conductor's plane about the chord, positive towards the right seen from A"),
    Quantity("blowout", "m", "greatest horizontal displacement from the vertical plane through A and B"),
    Quantity("lowest_height", "m", "height of the lowest point in the site frame"),
    Quantity("lowest_along", "m", "horizontal distance of the lowest point from A along the span"),
    Quantity("drop", "m", "higher attachment minus lowest point"),
    Quantity("clearance", "m", "least vertical distance to the ground profile and its obstacles"),
    Quantity("clearance_along", "m", "horizontal distance from A along the span of the place of least clearance"),
    Quantity("midspan_sag", "m", "vertical distance from the chord at mid-span"),
    Quantity("midspan_clearance", "m", "vertical distance to the ground at mid-span"),
    Quantity("catenary_constant", "m", "horizontal tension over unit weight, H/w, if nothing hangs on the conductor"),
    Quantity("tension", "n", "horizontal tension H of the bare conductor, where its unit weight is configured"),
    Quantity("load_skew", "", "uneven load: how much heavier than the mean the span hangs at B, and lighter at A"),
    Quantity("conductor_temp", "c", "derived by the state-change equation from stringing data, where configured"),
)


class Estimate(NamedTuple):
    """A value with its standard uncertainty and 95 % interval, all in the quantity's unit."""

    value: float
    u: float
    lo: float
    hi: float

    @property
    def decimals(self) -> int:
        """With how many decimals value and interval, lengths in metres, are written."""
        return decimals(self.hi - self.lo)


FORM = "name and version of the message's form"


class Strict(BaseModel):
    """Base of all messages: frozen, unknown fields are an error, NaN and infinity are no numbers.

    What is sent has every field, so a schema of what is sent requires them all; what is read may leave defaults out.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, json_schema_serialization_defaults_required=True
    )


class ReasonMessage(Strict):
    """One reason for less than good quality."""

    cause: Cause = Field(description="the node's own word for it")
    detail_qual: DetailQual = Field(description="the IEC 61850-7-3 word that the cause belongs to")
    text: str = Field(description="what was seen, with numbers, and what to do")

    @classmethod
    def of(cls, reason: Reason) -> ReasonMessage:
        """The message form of a :class:`sagnode.quality.Reason`."""
        return cls(cause=reason.cause, detail_qual=reason.detail_qual, text=reason.text)


class QualityMessage(Strict):
    """IEC 61850-7-3 quality of a reading."""

    validity: Validity = Field(description="good, questionable (with a number and reasons) or invalid (without)")
    detail_qual: tuple[DetailQual, ...] = Field(default=(), description="the IEC word of every reason, each once")
    reasons: tuple[ReasonMessage, ...] = Field(default=(), description="why it is not good")
    source: Literal["process", "substituted"] = Field(default="process", description="always process: measured")
    test: bool = Field(default=False, description="made while the unit is being commissioned: not to be acted on")

    @classmethod
    def of(cls, validity: Validity, reasons: tuple[Reason, ...], *, test: bool = False) -> QualityMessage:
        """Quality from a judgement; ``detail_qual`` lists each IEC word once, in the order of the reasons."""
        words = tuple(dict.fromkeys(reason.detail_qual for reason in reasons))
        return cls(validity=validity, detail_qual=words, reasons=tuple(ReasonMessage.of(r) for r in reasons), test=test)


class Identity(Strict):
    """Which conductor of which span, seen by which unit."""

    utility: str = Field(description="unit.utility of the node file")
    line: str = Field(description="unit.line of the node file")
    span: str = Field(description="unit.span of the node file")
    unit: str = Field(description="unit.unit of the node file")


class ReadingHeader(Strict):
    """Everything of a reading but its quantities; :class:`Reading` adds those."""

    schema_version: Literal["sagnode.reading/1"] = Field(default="sagnode.reading/1", description=FORM)
    utility: str = Field(description="unit.utility of the node file")
    line: str = Field(description="unit.line of the node file")
    span: str = Field(description="unit.span of the node file")
    unit: str = Field(description="unit.unit of the node file")
    conductor: str = Field(description="id of the conductor in the span file")
    phase: str | None = Field(default=None, description="of the conductor, where the span file names one")
    sequence: int = Field(
        ge=1, description="one count a unit, over all its conductors, never used again; drop what you have seen"
    )
    acquired_at: AwareDatetime = Field(description="UTC of the first frame used (or of the attempt)")
    published_at: AwareDatetime | None = Field(default=None, description="UTC of this transmission")
    clock_synced: bool = Field(description="whether the system clock was synchronised at acquisition")
    boot_id: str = Field(description="of the machine at acquisition; monotonic_s can be compared while it is the same")
    monotonic_s: float = Field(description="seconds of the monotonic clock since boot at acquisition")
    quality: QualityMessage = Field(description="whether to believe the numbers, and why not")
    frames_used: int = Field(ge=0, description="frames of the burst that the numbers come from")
    frames_rejected: int = Field(ge=0, description="frames of the burst that were not used")
    visible_share: float | None = Field(default=None, ge=0, le=1, description="share of the span that was seen")
    match_score: float | None = Field(default=None, description="robust z-score over shifted curves")
    pose_residual_px: float | None = Field(
        default=None,
        ge=0,
        description="root mean square, an axis, of how far the landmarks are from where the pose puts them",
    )
    landmarks_used: int = Field(default=0, ge=0, description="landmarks that held the camera's place")
    landmarks_by_appearance: int = Field(
        default=0, ge=0, description="of these, found by a kept appearance and not by the reference picture"
    )
    oldest_appearance_at: AwareDatetime | None = Field(
        default=None, description="when the oldest of those appearances was cut; null where none was used"
    )
    method: str = Field(description="matcher that made the reading")
    calibration_id: str = Field(
        description="hash of lens, camera survey and landmarks; unknown before a camera was ready"
    )
    configuration_id: str = Field(description="hash of all that is configured, defaults included")
    software_version: str = Field(description="of sagnode")
    backfill: bool = Field(default=False, description="sent late or again, out of the journal, and not retained")


def _quantity_fields() -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for quantity in QUANTITIES:
        stem = quantity.stem
        fields[quantity.value_field] = (float | None, Field(default=None, description=quantity.meaning))
        fields[f"{stem}_u"] = (float | None, Field(default=None, ge=0, description=f"standard uncertainty of {stem}"))
        fields[f"{stem}_lo"] = (
            float | None,
            Field(default=None, description=f"lower end of the 95 % interval of {stem}"),
        )
        fields[f"{stem}_hi"] = (
            float | None,
            Field(default=None, description=f"upper end of the 95 % interval of {stem}"),
        )
    return fields


Reading: type[ReadingHeader] = create_model(
    "Reading",
    __base__=ReadingHeader,
    __doc__="One conductor, one burst: what is published on ``measurement/<conductor>``.",
    **_quantity_fields(),
)


def estimate_fields(estimates: dict[str, Estimate]) -> dict[str, float]:
    """Flat fields of a reading from estimates by quantity stem.

    >>> sorted(estimate_fields({"sag": Estimate(8.0, 0.1, 7.8, 8.2)}))
    ['sag_hi', 'sag_lo', 'sag_m', 'sag_u']
    """
    fields: dict[str, float] = {}
    for quantity in QUANTITIES:
        if quantity.stem in estimates:
            fields.update(zip(quantity.fields, estimates[quantity.stem], strict=True))
    return fields


def reading_estimate(reading: ReadingHeader, stem: str) -> Estimate | None:
    """The estimate of one quantity of a reading, or None where it is null."""
    quantity = next(q for q in QUANTITIES if q.stem == stem)
    values = [getattr(reading, name) for name in quantity.fields]
    return None if any(v is None for v in values) else Estimate(*values)


class StatusMessage(Strict):
    """Retained on ``status``; ``offline`` is the last will."""

    schema_version: Literal["sagnode.status/1"] = Field(default="sagnode.status/1", description=FORM)
    state: Literal["online", "offline"] = Field(description="whether the node is connected to the broker")
    since: datetime | None = Field(description="when it connected or left; null in the last will, which knows no time")
    software_version: str = Field(description="of sagnode")
    boot_id: str = Field(description="of the machine")
    configuration_id: str = Field(description="hash of all that is configured, as in readings")
    text: str = Field(default="", description="why it is offline")


class LensMessage(Strict):
    """What is between the camera and the scene, told by comparison with the reference picture."""

    look: LensLook = Field(description="what the lens looks like")
    share: float = Field(ge=0, le=1, description="of the view's detail that is affected, of the picture for dirt")
    text: str = Field(description="one sentence with the numbers")


class LandmarksMessage(Strict):
    """How old the pictures are by which landmarks are recognised."""

    reference_taken_at: AwareDatetime | None = Field(
        default=None, description="of the reference picture; null: unknown"
    )
    reference_taken_from: Literal["name", "exif", "modified"] | None = Field(
        default=None,
        description="what says so: the file's name, its EXIF, or its modification time (it may have been taken before)",
    )
    appearances: int = Field(ge=0, description="further appearances of landmarks that may be used")
    on_trial: int = Field(
        ge=0, description="appearances that have not found their landmark again yet, and are not used"
    )
    oldest_at: AwareDatetime | None = Field(default=None, description="when the oldest usable appearance was cut")
    newest_at: AwareDatetime | None = Field(default=None, description="when the newest usable appearance was cut")


class HealthMessage(Strict):
    """Retained on ``health``: the node itself."""

    schema_version: Literal["sagnode.health/1"] = Field(default="sagnode.health/1", description=FORM)
    at: AwareDatetime = Field(description="when this was written")
    uptime_s: float = Field(description="seconds since the daemon started")
    cpu_temperature_c: float | None = Field(description="of the processor; null where the machine does not tell")
    throttled: bool | None = Field(description="a Raspberry Pi is short of voltage or too hot now; null: not told")
    memory_available_mb: float | None = Field(description="what programs may still take without swapping")
    disk_free_mb: float | None = Field(description="free on the file system of the journal")
    camera: str = Field(description="back end and state: ok, or the last fault")
    worker_restarts: int = Field(description="workers replaced after a failure, since the daemon started")
    readings_made: int = Field(description="since the daemon started")
    readings_invalid: int = Field(description="of these, without a number")
    last_good_at: AwareDatetime | None = Field(
        description="acquisition of the last good reading since the daemon started; null: none"
    )
    outbox_depth: int = Field(description="readings that the broker has not acknowledged yet")
    outbox_oldest_s: float | None = Field(description="age of the oldest of them; null where none waits")
    outbox_set_aside: int = Field(
        default=0, ge=0, description="of these, readings that the broker would not take; each is tried again in an hour"
    )
    delivery: str = Field(
        default="ok", description="ok, or what is not delivered and why, though the broker is connected"
    )
    broker: str = Field(description="connected to which broker, or what went wrong last")
    certificate_ends_at: AwareDatetime | None = Field(
        default=None, description="end of the client certificate at the broker; null without one"
    )
    clock_synced: bool = Field(description="whether the system clock is synchronised")
    journal: str = Field(description="ok, or what is wrong with the disk and how many bursts wait in memory")
    configuration: str = Field(default="ok", description="ok, or why the last reload was refused")
    recovery: str = Field(default="ok", description="what was started anew because no reading came, or ok")
    lens: LensMessage | None = Field(default=None, description="as the newest frame shows it; null without a reading")
    landmarks: LandmarksMessage | None = Field(
        default=None, description="by which pictures landmarks are recognised; null without a reference picture"
    )
    trend: str = Field(default="ok", description="ok, or which conductors' readings contradict those before them")
