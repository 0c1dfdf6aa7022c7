"""A first look from afar: as far aside of a candidate's curve as the survey leaves the wire.

Near the camera, centimetres of an attachment are tens of pixels, and no sag and swing make up for that. The search sees
so far, since it compares bands that are as wide as the attachments leave a curve; a refinement looks a few pixels
aside, and would lose what the search has found.
"""

from __future__ import annotations

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.joint import solve
from sagnode.estimate.refinement import MAX_BLOCKS, STAGES, offsets_of, spread_along, view_of
from sagnode.estimate.register import Registered
from sagnode.geometry.camera import FloatArray
from sagnode.match.refine import observe
from sagnode.match.track import trace
from sagnode.site import SiteConductor
from sagnode.survey import CAMERA, SAG, SWING, Survey

REACH_Z, REACH_PX = 2.0, 30.0
"""Standard uncertainties of the curve, by all but its sag and swing, that are looked aside, and px at most."""


def approached(
    image: GreyImage, conductor: SiteConductor, survey: Survey, registered: Registered, theta: FloatArray
) -> FloatArray:
    """θ (28,) of a sag and a swing after that look; as it was where nothing is to be seen."""
    view = view_of(survey, conductor, theta)
    curve = trace(view, float(theta[SAG]), float(theta[SWING]))
    if curve is None:
        return theta
    aside = spread_along(survey, theta, _all_but_sag_and_swing(survey, registered), curve)
    first = STAGES[0]
    half_range = np.clip(REACH_Z * aside, first.half_range_px, REACH_PX)
    block_px = max(first.block_px, float(curve.arc[-1]) / MAX_BLOCKS)
    observed = observe(image, curve, half_range, [], block_px, first.shifts, first.run)
    if int(observed.usable.sum()) < 4:
        return theta
    return solve(survey, theta, registered.camera, offsets_of(observed, bent=False), first.iterations).theta


def _all_but_sag_and_swing(survey: Survey, registered: Registered) -> FloatArray:
    """Covariance (28, 28) of the unknowns by survey and landmarks, sag and swing taken for known."""
    known = survey.prior_information()
    known[CAMERA, CAMERA] += registered.camera.precision
    free = np.setdiff1d(survey.unknowns(), (SAG, SWING))
    covariance = np.zeros_like(known)
    covariance[np.ix_(free, free)] = np.linalg.inv(known[np.ix_(free, free)])
    return covariance
