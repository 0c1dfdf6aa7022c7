"""The paper's methods from a site and a frame to measurements: what ``measure.method`` selects beside sagnode's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sagnode.calibrate.undistort import undistort_image
from sagnode.capture.port import GreyImage
from sagnode.geometry.camera import FloatArray, Intrinsics, distort, project
from sagnode.measurement import Drawing, FrameMeasurement
from sagnode.message import Estimate
from sagnode.quality import Cause, Reason, Validity
from sagnode.reference.anchored import best_anchored
from sagnode.reference.bezier import lowest_point
from sagnode.reference.library import Scene, bezier_library, cosh_library, perspective_library
from sagnode.reference.matching import TOP_QUADRANTS, Match, Mode, Roi, best_match
from sagnode.reference.uncertainty import paper_uncertainty
from sagnode.reference.world import (
    distance_to_ground,
    fictive_line_height,
    midspan_depth,
    pixel_to_world,
    sag_from_height,
)
from sagnode.site import Site, SiteConductor

_LIBRARIES = {"paper-bezier": bezier_library, "cosh": cosh_library, "cosh-perspective": perspective_library}
_K95 = 1.96
_BUDGET_SOURCE = "stated by the paper"


@dataclass(frozen=True)
class Settings:
    """What the paper fixes; every default is its own choice.

    Attributes:
        templates: size of the library; the paper has 200 to 400.
        canny: lower and upper threshold of the edge detector.
        mode: of cv2.matchTemplate, one of figure 4's six.
        roi: quadrants that are searched.
        fictive_line: take the lowest point of the Bézier curve at the projected mid-span (figure 7) in place of
            B'(t) = 0 (section 3.2.4).
        whole_map: correlate over the whole region, as the paper does; False gives the same scores sooner.
    """

    templates: int = 300
    canny: tuple[float, float] = (50.0, 150.0)
    mode: Mode = "TM_CCOEFF_NORMED"
    roi: Roi = TOP_QUADRANTS
    fictive_line: bool = False
    whole_map: bool = True


PAPER = Settings()


def measure_by_reference(site: Site, image: GreyImage, settings: Settings = PAPER) -> list[FrameMeasurement]:
    """Every measured conductor of the span by ``site.method``, one of paper-bezier, cosh and cosh-perspective.

    Args:
        site: as prepared by :func:`sagnode.site.load_site`.
        image: raw frame (height, width); the lens distortion is undone here, once for the whole frame.
        settings: the paper's by default.

    Returns:
        Measurements in the conductors' order. A found one is questionable, since its uncertainty is the paper's
        0.18 % of sag, which leaves out nearly everything that matters; its estimates are ``sag`` (attachments' mean
        height minus lowest point), ``drop``, ``lowest_height``, ``clearance`` (at mid-span, as the paper has it),
        ``midspan_sag`` and ``midspan_clearance``, the last two equal to the first and fourth.

    Raises:
        FrameError: the frame is not of the calibration's size.
    """
    flat = undistort_image(site.intrinsics, image)
    return [_measure(site, conductor, flat, settings) for conductor in site.conductors if conductor.measured]


def _measure(site: Site, conductor: SiteConductor, image: GreyImage, settings: Settings) -> FrameMeasurement:
    survey = conductor.survey
    scene = Scene(
        intrinsics=site.intrinsics.without_distortion(),
        pose=site.pose,
        near=survey.near,
        far=survey.far,
        sags=np.linspace(*survey.sag_range, settings.templates),
    )
    templates = list(_LIBRARIES[site.method](scene))
    search = best_match if settings.whole_map else best_anchored
    match = search(image, templates, settings.roi, settings.canny, settings.mode)
    if match is None:
        text = (
            f"method {site.method}: none of its {len(templates)} curves for {conductor.id} matches an edge within the"
            " searched quadrants of the picture"
        )
        return _refused(site, conductor, text)
    lowest = _lowest(site, scene, match, settings)
    if lowest is None:
        text = f"method {site.method}: the mid-span line does not cut the curve that was found for {conductor.id}"
        return _refused(site, conductor, text)
    pixel, height = lowest
    estimates = _estimates(site, scene, height)
    text = (
        f"method {site.method} is for comparison only;"
        " its stated uncertainty is the paper's and is known to be optimistic"
    )
    return FrameMeasurement(
        conductor=conductor.id,
        phase=conductor.phase,
        validity=Validity.QUESTIONABLE,
        reasons=(Reason(Cause.UNCERTAIN, text),),
        method=site.method,
        estimates=estimates,
        budget={stem: {_BUDGET_SOURCE: estimate.u} for stem, estimate in estimates.items()},
        match_score=match.score,
        drawing=_draw(site, scene, match, pixel, estimates),
    )


def _refused(site: Site, conductor: SiteConductor, text: str) -> FrameMeasurement:
    reasons = (Reason(Cause.NO_CONDUCTOR, text),)
    return FrameMeasurement(conductor.id, conductor.phase, Validity.INVALID, reasons, site.method)


def _lowest(site: Site, scene: Scene, match: Match, settings: Settings) -> tuple[FloatArray, float] | None:
    """Lowest point of the matched curve by the method's own rule: pixel (2,) and site height, m."""
    template, control = match.template, match.template.control
    middle_sag = float(np.mean(scene.sags))
    if site.method == "cosh-perspective" or (control is not None and settings.fictive_line):
        foot = 0.5 * (scene.near + scene.far) - np.array([0.0, 0.0, middle_sag])
        return fictive_line_height(scene.intrinsics, scene.pose, foot, template.points)
    pixel = template.points[int(np.argmax(template.points[:, 1]))] if control is None else lowest_point(control)
    d_cam = midspan_depth(scene.pose, scene.near, scene.far, middle_sag)
    if d_cam <= 0:
        return None
    return pixel, float(pixel_to_world(scene.intrinsics, scene.pose, pixel, d_cam)[2])


def _estimates(site: Site, scene: Scene, lowest_height: float) -> dict[str, Estimate]:
    """The paper's numbers, m, with its own uncertainty of sag for all of them, heights being exact to it."""
    chord_middle = 0.5 * float(scene.near[2] + scene.far[2])
    highest = max(float(scene.near[2]), float(scene.far[2]))
    half_span = 0.5 * float(np.hypot(*(scene.far - scene.near)[:2]))
    ground = float(site.ground.top(np.array([half_span]))[0])
    sag = sag_from_height(chord_middle, lowest_height)
    clearance = distance_to_ground(chord_middle - ground, sag)
    d_cam = midspan_depth(scene.pose, scene.near, scene.far, sag)
    u = paper_uncertainty(sag, d_cam, scene.intrinsics.fy).stated_m
    values = {
        "sag": sag,
        "drop": sag_from_height(highest, lowest_height),
        "lowest_height": lowest_height,
        "clearance": clearance,
        "midspan_sag": sag,
        "midspan_clearance": clearance,
    }
    return {stem: Estimate(value, u, value - _K95 * u, value + _K95 * u) for stem, value in values.items()}


def _draw(site: Site, scene: Scene, match: Match, lowest: FloatArray, estimates: dict[str, Estimate]) -> Drawing:
    """What an overlay needs, in pixels of the raw frame; no blocks, landmarks or rational weights here."""
    control = match.template.control
    middle = 0.5 * (scene.near + scene.far)
    top = np.array([middle[0], middle[1], estimates["lowest_height"].value])
    foot = top - np.array([0.0, 0.0, estimates["clearance"].value])
    ends = scene.near + np.linspace(0.0, 1.0, 101)[:, None] * (scene.far - scene.near)
    none = np.empty((0, 2))
    return Drawing(
        curve=_raw(site.intrinsics, match.template.points),
        seen=none,
        lowest=_raw(site.intrinsics, lowest[None])[0],
        clearance=project(site.intrinsics, site.pose, np.stack([top, foot]))[0],
        chord=project(site.intrinsics, site.pose, ends)[0],
        landmarks=none,
        predicted=none,
        rational=(np.full((3, 2), np.nan) if control is None else control, np.ones(3)),
    )


def _raw(intrinsics: Intrinsics, pixels: FloatArray) -> FloatArray:
    """Where undistorted pixels (N, 2) lie in the raw frame."""
    x = (pixels[:, 0] - intrinsics.cx) / intrinsics.fx
    y = (pixels[:, 1] - intrinsics.cy) / intrinsics.fy
    xd, yd = distort(intrinsics, x, y)
    return np.stack([intrinsics.fx * xd + intrinsics.cx, intrinsics.fy * yd + intrinsics.cy], axis=1)
