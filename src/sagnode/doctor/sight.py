"""What the worker would meet: lens, reference picture, camera, and a reading out of one burst.

A process of its own (``python -m sagnode.doctor.sight``), for a camera's driver may hang or crash it. It prints one
finding a line as soon as it is made, so that what was found before a crash is not lost.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sagnode.doctor.findings import Finding, fault, ok, warning
from sagnode.errors import EndOfFrames, FrameError, SagnodeError
from sagnode.quality import Cause, Validity

if TYPE_CHECKING:
    from sagnode.config.load import LoadedNode
    from sagnode.measurement import ConductorMeasurement
    from sagnode.site import Site

CALIBRATION, REFERENCE, CAMERA, READING = "calibration", "reference picture", "camera", "reading"


def main(argv: list[str]) -> int:
    """Entry of the child process."""
    parser = argparse.ArgumentParser(prog="python -m sagnode.doctor.sight")
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--without-camera", action="store_true")
    args = parser.parse_args(argv)
    for finding in look(args.config, with_camera=not args.without_camera):
        print(json.dumps(finding.as_json()), flush=True)
    return 0


def look(config: Path, *, with_camera: bool) -> Iterator[Finding]:
    """The checks in the order in which the worker depends on them; the first fault ends it."""
    from sagnode.config.load import load_node

    try:
        from sagnode.site import load_site
    except ImportError as error:
        yield fault("mathematics", f"{error}", "NumPy or OpenCV is missing or broken: install sagnode anew")
        return
    loaded = load_node(config)
    camera = loaded.span.camera
    try:
        site = load_site(loaded.span, loaded.node.measure)
    except SagnodeError as error:
        check = REFERENCE if "reference_image" in error.what else CALIBRATION
        yield fault(check, error.what, error.remedy)
        return
    lens = site.intrinsics
    yield ok(CALIBRATION, f"{camera.intrinsics}: {lens.width}x{lens.height} px, id {site.calibration_id}")
    if site.patches is None:
        remedy = "give camera.reference_image and landmarks in the span file; without them nothing tells a moved camera"
        yield warning(REFERENCE, "none: the camera is taken to stand where the survey says", remedy)
    else:
        used = sum(patch is not None for patch in site.patches)
        text = f"{camera.reference_image}: {used} of {len(site.patches)} landmarks can be looked for in it"
        yield ok(REFERENCE, text) if used >= 3 else warning(REFERENCE, text, "three or more are wanted, well apart")
    if with_camera:
        yield from _camera(loaded, site)


def _camera(loaded: LoadedNode, site: Site) -> Iterator[Finding]:
    from sagnode.capture import open_source
    from sagnode.pipeline import measure_burst

    camera = loaded.node.camera
    try:
        source = open_source(camera)
        source.open()
        frames = source.burst(camera.burst, camera.burst_interval_s)
        described = source.describe()
        source.close()
    except EndOfFrames as error:
        yield warning(CAMERA, error.what, error.remedy)
        return
    except FrameError as error:
        level = fault if error.cause in {Cause.CAMERA_FAULT, Cause.BAD_FRAME} else warning
        yield level(CAMERA, error.what, error.remedy)
        return
    except SagnodeError as error:
        yield fault(CAMERA, error.what, error.remedy)
        return
    height, width = frames[0].image.shape
    lens = site.intrinsics
    if (width, height) != (lens.width, lens.height):
        text = f"{described}: frames of {width}x{height} px, the calibration is for {lens.width}x{lens.height}"
        yield fault(CAMERA, text, "calibrate at the size that is used, or set the calibrated size")
        return
    yield ok(CAMERA, f"{described}, {len(frames)} frames of {width}x{height} px")
    for measurement in measure_burst(site, [frame.image for frame in frames]):
        yield _reading(measurement)


def _reading(measurement: ConductorMeasurement) -> Finding:
    """An invalid reading is no fault of the node: it may be night."""
    why = "; ".join(f"{reason.cause}: {reason.text}" for reason in measurement.reasons)
    text = f"{measurement.conductor} is {measurement.validity}"
    if measurement.validity is Validity.INVALID:
        return warning(
            READING, f"{text} ({why})", "if it is day and clear: sagnode measure --overlay shows what is seen"
        )
    sag = measurement.estimates["sag"]
    digits = sag.decimals
    text += f": sag {sag.value:.{digits}f} m [{sag.lo:.{digits}f} {sag.hi:.{digits}f}]"
    return ok(READING, text) if measurement.validity is Validity.GOOD else warning(READING, f"{text} ({why})")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
