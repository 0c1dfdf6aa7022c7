"""Refusals explained: what the lens, fog or night have to do with it. No reading is refused for any of this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sagnode.capture.port import GreyImage
from sagnode.match.lens import LensState, lens_state
from sagnode.measurement import FrameMeasurement
from sagnode.quality import Cause, LensLook, Reason, Validity
from sagnode.site import Site

_CAUSES = {
    LensLook.DARK: Cause.DARK,
    LensLook.FOGGED: Cause.FOG,
    LensLook.WET: Cause.LENS_WET,
    LensLook.DIRTY: Cause.LENS_DIRTY,
}


def lens_of(site: Site, image: GreyImage) -> LensState:
    """What the lens looks like in this frame (height, width) uint8."""
    return lens_state(site.reference_cells, image)


def explain(site: Site, image: GreyImage, measured: Sequence[FrameMeasurement]) -> list[FrameMeasurement]:
    """The same measurements; those that were refused bear the state of the lens as one reason more."""
    if all(m.validity is not Validity.INVALID for m in measured):
        return list(measured)
    state = lens_of(site, image)
    cause = _CAUSES.get(state.look)
    if cause is None:
        return list(measured)
    return [_with_reason(m, Reason(cause, state.text)) for m in measured]


def _with_reason(measured: FrameMeasurement, reason: Reason) -> FrameMeasurement:
    known = any(r.cause is reason.cause for r in measured.reasons)
    if known or measured.validity is not Validity.INVALID:
        return measured
    return replace(measured, reasons=(*measured.reasons, reason))
