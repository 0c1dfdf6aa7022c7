"""The node file: what this unit is, where its frames come from, and whom it tells."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Literal

from pydantic import Field, NonNegativeInt, PositiveInt, field_validator, model_validator

from sagnode.config.base import YEAR_S, FileName, FilePattern, Model, Name
from sagnode.config.mqtt import Mqtt

KEEP_DAYS_MAX = 36_500.0
"""A century, so that there is a date so long ago whatever the clock says."""
Method = Literal["rational-bezier", "paper-bezier", "cosh", "cosh-perspective"]


class Unit(Model):
    """Identity, as it stands in topics and messages."""

    utility: Name
    line: Name
    span: Name
    unit: Name
    commissioning: bool = False
    """Mark every reading as a test."""


class ReplaySource(Model):
    """Frames from files."""

    path: FilePattern
    """A directory, a glob or a video; relative to this file."""
    cadence_s: float | None = Field(default=None, gt=0, le=YEAR_S)
    """Time between frames; without it the files' own times are kept."""
    start: str | None = None
    """RFC 3339 time of the first frame, with cadence_s."""
    at_end: Literal["stop", "hold", "loop"] = "stop"
    """After the last frame: stop the node, report stale frames, or begin again."""

    @field_validator("start")
    @classmethod
    def _start_is_a_time(cls, start: str | None) -> str | None:
        if start is not None:
            try:
                aware = datetime.fromisoformat(start).tzinfo is not None
            except ValueError:
                raise ValueError('must be a time in RFC 3339, such as "2026-06-21T04:00:00Z"') from None
            if not aware:
                raise ValueError(f'must say its zone, such as "{start}Z" for UTC')
        return start

    @model_validator(mode="after")
    def _start_needs_cadence(self) -> ReplaySource:
        if self.start is not None and self.cadence_s is None:
            raise ValueError("start needs cadence_s; without it the files' own times are kept")
        return self


class V4l2Source(Model):
    """A V4L2 device through OpenCV."""

    device: FilePattern = "/dev/video0"
    width: int = Field(default=1456, gt=0, le=65_535)
    height: int = Field(default=1088, gt=0, le=65_535)
    pixel_format: str = Field(default="GREY", min_length=4, max_length=4)
    exposure: float | None = None
    """In the driver's unit (often 100 us); unset leaves the driver's automatic."""
    gain: float | None = None
    fps: float | None = Field(default=None, gt=0, le=10_000)
    warmup_frames: int = Field(default=5, ge=0, le=1000)
    timeout_s: float = Field(default=5.0, gt=0, le=3600)
    """Longest wait for one frame."""


class Picamera2Source(Model):
    """A Raspberry Pi camera."""

    camera: int = Field(default=0, ge=0)
    width: int = Field(default=1456, gt=0, le=65_535)
    height: int = Field(default=1088, gt=0, le=65_535)
    stream: Literal["main", "raw"] = "main"
    exposure_us: int | None = Field(default=None, gt=0, le=2**31 - 1)
    """Locked exposure; unset: settle automatically during warm-up, then lock."""
    gain: float | None = Field(default=None, gt=0)
    lens_position: float | None = Field(default=None, ge=0)
    """Dioptres; 0 is infinity."""
    crop: tuple[NonNegativeInt, NonNegativeInt, PositiveInt, PositiveInt] | None = None
    """Part of the sensor's array that the picture shows: left, top, width, height in its own pixels. Unset: what
    libcamera chooses, which may be another with its next version; the intrinsics hold for one crop only."""
    warmup_frames: int = Field(default=10, ge=0, le=1000)
    timeout_s: float = Field(default=10.0, gt=0, le=3600)


class Camera(Model):
    """Where frames come from."""

    backend: Literal["replay", "v4l2", "picamera2"]
    burst: int = Field(default=1, ge=1, le=64)
    """Frames per reading."""
    burst_interval_s: float = Field(default=0.0, ge=0, le=60)
    replay: ReplaySource | None = None
    v4l2: V4l2Source = V4l2Source()
    picamera2: Picamera2Source = Picamera2Source()

    @model_validator(mode="after")
    def _source_given(self) -> Camera:
        if self.backend == "replay" and self.replay is None:
            raise ValueError('backend = "replay" needs a table [camera.replay] with a path')
        return self


class Schedule(Model):
    """When a reading is made; exactly one of interval_s and cron."""

    interval_s: float | None = Field(default=None, ge=0.1, le=YEAR_S)
    cron: str | None = Field(default=None, max_length=1000)
    """Five-field crontab expression, in UTC."""
    deadline_s: float = Field(default=60.0, ge=0.1, le=86_400)
    """A reading that takes longer is recorded as invalid; its worker is killed and started anew."""
    clock: Literal["system", "virtual"] = "system"
    """virtual: time jumps to the next slot as soon as the node is idle; for replayed frames only."""

    @model_validator(mode="after")
    def _one_trigger(self) -> Schedule:
        if (self.interval_s is None) == (self.cron is None):
            raise ValueError("give exactly one of interval_s and cron")
        return self

    @field_validator("cron")
    @classmethod
    def _cron_is_understood(cls, cron: str | None) -> str | None:
        if cron is not None:
            # The scheduler's own word counts; imported here, since only a node with such a schedule pays for it.
            from apscheduler.triggers.cron import CronTrigger

            try:
                trigger = CronTrigger.from_crontab(cron, timezone=UTC)
            except (ValueError, TypeError) as error:
                raise ValueError(
                    f"{error}; must be five fields: minute, hour, day of month, month, day of week"
                ) from None
            if trigger.get_next_fire_time(None, datetime(2000, 1, 1, tzinfo=UTC)) is None:
                raise ValueError("there is no such day, and no reading would ever be made; check day and month")
        return cron


class Measure(Model):
    """How a frame becomes a reading."""

    method: Method = "rational-bezier"
    """rational-bezier is sagnode's; the others are the paper's, for comparison."""
    undistort: bool = True
    """False ignores the lens distortion, as the paper's Table 8 does."""
    appearances: bool = True
    """Keep further appearances of the landmarks, for those that the reference picture does not find."""


class Trend(Model):
    """Whether a reading can follow from those before it: conductors heat and cool, they do not jump."""

    watch: bool = True
    """Mark a reading as inconsistent when no heat or wind explains its change; its numbers stay as they are."""
    accept_after_s: float = Field(default=1800.0, gt=0, le=YEAR_S)
    """A new level that has lasted so long, in three readings at least, is real: a slipped clamp, ice that fell off."""


class Alarms(Model):
    """When alarms are raised and cleared; the limits of clearance and sag are the span file's."""

    raise_after: int = Field(default=2, ge=1, le=100)
    """Readings in a row that show it."""
    clear_after: int = Field(default=3, ge=1, le=100)
    """Readings in a row that show the contrary."""
    clearance_hysteresis_m: float = Field(default=0.1, ge=0, le=1000)
    """clearance_lo must exceed its limit by so much to clear."""
    sag_hysteresis_m: float = Field(default=0.1, ge=0, le=1000)
    swing_deg: float | None = Field(default=None, gt=0)
    """Default: swing.questionable_deg of the span file."""
    swing_hysteresis_deg: float = Field(default=3.0, ge=0)
    load_skew: float = Field(default=0.1, gt=0)
    """Uneven load above this, and above four of its standard uncertainties, is suspected ice."""
    stale_after_s: float = Field(default=7200.0, gt=0, le=YEAR_S)
    """No reading with a number for so long."""
    pictures: bool = True
    """Send the overlay of a conductor when an alarm of it is raised."""


class Commands(Model):
    """What may be asked of the node on the topic ``command``; who may ask is the broker's to say."""

    enabled: bool = True
    per_minute: int = Field(default=12, ge=1, le=600)
    """More are answered with an error."""


class Worker(Model):
    """The process that owns the camera and the mathematics."""

    max_readings: int = Field(default=1000, ge=1, le=10**9)
    """Recycle the process after so many readings."""
    memory_max_mb: int = Field(default=600, ge=64, le=10**6)
    """Address-space growth beyond this ends the process, not the daemon."""
    backoff_max_s: float = Field(default=300.0, gt=0, le=86_400)


class Recovery(Model):
    """What is done when no reading comes for long, although the worker was started anew again and again."""

    restart_after_s: float = Field(default=1800.0, gt=0, le=YEAR_S)
    """So long without a reading, for a fault that a fresh start may mend: the service is started anew."""
    restarts_before_reboot: int = Field(default=3, ge=1, le=10**6)
    """So many restarts of the service in one boot; if they do not help the machine is started anew."""
    reboot: bool = True
    """False: never start the machine anew."""
    reboot_wait_h: float = Field(default=1.0, gt=0, le=YEAR_S / 3600)
    """The machine has been up so long before; twice as long after each fruitless time, a day at most."""


class Storage(Model):
    """Where things are kept; relative paths are below the state directory."""

    state_dir: FileName | None = None
    """Default: $STATE_DIRECTORY (systemd), else ~/.local/state/sagnode."""
    keep_days: float = Field(default=400.0, gt=0, le=KEEP_DAYS_MAX)
    keep_mb: float = Field(default=512.0, gt=1, le=1e9)
    """Size limit of the journal; undelivered readings go last, and only then."""
    pictures: bool = True
    """Keep the latest overlay of each conductor."""
    pictures_keep_mb: float = Field(default=64.0, ge=0, le=1e9)


class Node(Model):
    """The whole node file."""

    unit: Unit
    span_file: FileName
    """The survey; relative to this file."""
    camera: Camera
    schedule: Schedule
    measure: Measure = Measure()
    trend: Trend = Trend()
    alarms: Alarms = Alarms()
    commands: Commands = Commands()
    worker: Worker = Worker()
    recovery: Recovery = Recovery()
    storage: Storage = Storage()
    mqtt: Mqtt | None = None
    """Without it readings are journalled and shown, and published nowhere."""
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    @model_validator(mode="after")
    def _virtual_clock_needs_replay(self) -> Node:
        for where, message in inconsistencies(self.camera, self.schedule):
            raise ValueError(f"{where}: {message}")
        return self


def inconsistencies(camera: Camera | None, schedule: Schedule | None) -> Iterator[tuple[str, str]]:
    """Contradictions between tables that are each right by themselves: (table, sentence) pairs."""
    if schedule and camera and schedule.clock == "virtual" and camera.backend != "replay":
        yield "schedule", f'clock = "virtual" works with camera backend "replay" only, and this is "{camera.backend}"'
    elif schedule and camera and camera.replay and schedule.clock == "virtual" and camera.replay.at_end == "hold":
        text = 'clock = "virtual" would race on without end after the last frame; set camera.replay.at_end = "stop"'
        yield "schedule", text
