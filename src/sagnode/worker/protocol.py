"""What daemon and worker say to each other: one JSON object a line, over a pair of pipes of their own.

JSON and not pickle: whatever a dying worker leaves in the pipe is text that fails to validate, never code.
This module imports neither NumPy nor OpenCV.
"""

from __future__ import annotations

from typing import Literal

from pydantic import AwareDatetime, Field

from sagnode.message import Estimate, LandmarksMessage, LensMessage, ReasonMessage, Strict
from sagnode.quality import Validity


class Hello(Strict):
    """The worker's first line: it has read its configuration and opened its camera."""

    kind: Literal["hello"] = "hello"
    pid: int
    camera: str
    calibration_id: str
    first_frame_at: AwareDatetime | None = None


class MeasureRequest(Strict):
    """The daemon asks for one reading of all conductors."""

    kind: Literal["measure"] = "measure"
    id: int
    overlay_dir: str | None = Field(default=None, description="where to write <conductor>.jpg overlays")


class ConductorResult(Strict):
    """What was measured of one conductor."""

    conductor: str
    phase: str | None = None
    validity: Validity
    reasons: tuple[ReasonMessage, ...] = ()
    estimates: dict[str, Estimate] = Field(default={}, description="by quantity stem; empty when invalid")
    frames_used: int = 0
    frames_rejected: int = 0
    visible_share: float | None = None
    match_score: float | None = None
    pose_residual_px: float | None = None
    landmarks_used: int = 0
    landmarks_by_appearance: int = 0
    oldest_appearance_at: AwareDatetime | None = None
    method: str
    budget: dict[str, dict[str, float]] = Field(default={}, description="u by quantity stem and source, m")


class MeasureReply(Strict):
    """The worker's answer to a MeasureRequest: one result a measured conductor."""

    kind: Literal["reply"] = "reply"
    id: int
    acquired_at: AwareDatetime
    monotonic_s: float
    camera: str
    results: tuple[ConductorResult, ...]
    overlays: dict[str, str] = Field(default={}, description="conductor to path of its overlay")
    lens: LensMessage | None = None
    landmarks: LandmarksMessage | None = None
    elapsed_s: float
    memory_mb: float
    next_frame_at: AwareDatetime | None = None


class Fault(Strict):
    """The worker could not do what was asked; ``fatal`` means that it ends itself."""

    kind: Literal["fault"] = "fault"
    id: int | None = None
    reason: ReasonMessage
    end_of_frames: bool = False
    fatal: bool = False


WorkerLine = Hello | MeasureReply | Fault
