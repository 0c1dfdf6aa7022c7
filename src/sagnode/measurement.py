"""What a measurement hands on: of one conductor in one frame, and of one conductor in one burst."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime

from sagnode.geometry.camera import FloatArray
from sagnode.message import Estimate
from sagnode.quality import Reason, Validity


@dataclass(frozen=True)
class Drawing:
    """What an overlay shows of one conductor; pixels, NaN where outside the view.

    Attributes:
        curve: the detected curve (N, 2).
        seen: blocks in which the wire was seen (M, 2).
        lowest: the conductor's lowest point (2,).
        clearance: the place of least clearance: on the conductor and on the ground below it (2, 2).
        chord: the straight line between the attachments (K, 2).
        landmarks: where the landmarks were found (L, 2).
        predicted: where the estimated camera sees the surveyed landmarks (L, 2).
        rational: control points (3, 2) and weights (3,) of the curve as a rational quadratic Bézier.
    """

    curve: FloatArray
    seen: FloatArray
    lowest: FloatArray
    clearance: FloatArray
    chord: FloatArray
    landmarks: FloatArray
    predicted: FloatArray
    rational: tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class FrameMeasurement:
    """One conductor in one frame.

    ``estimates`` and ``budget`` are empty when the measurement is invalid.
    """

    conductor: str
    phase: str | None
    validity: Validity
    reasons: tuple[Reason, ...]
    method: str
    estimates: dict[str, Estimate] = field(default_factory=dict)
    budget: dict[str, dict[str, float]] = field(default_factory=dict)
    """Standard uncertainty by quantity stem and source, in the quantity's unit."""
    visible_share: float | None = None
    match_score: float | None = None
    pose_residual_px: float | None = None
    landmarks_used: int = 0
    landmarks_by_appearance: int = 0
    """Of these, found by a kept appearance and not by the reference picture."""
    oldest_appearance_at: datetime | None = None
    """When the oldest of those appearances was cut."""
    drawing: Drawing | None = None


@dataclass(frozen=True)
class ConductorMeasurement(FrameMeasurement):
    """One conductor in one burst; the drawing is that of the frame nearest to the combined value."""

    frames_used: int = 0
    frames_rejected: int = 0
