"""Sites of rendered scenes, as a unit that was set up there has them."""

from pathlib import Path

import cv2

from sagnode.calibrate.files import save_intrinsics
from sagnode.config.node import Measure
from sagnode.config.span import Span
from sagnode.estimate.register import Registered, register
from sagnode.geometry.camera import Intrinsics
from sagnode.scene.render import Rendered
from sagnode.site import Site, load_site


def registered_site(span: Span, intrinsics: Intrinsics, picture: Rendered, folder: Path) -> tuple[Site, Registered]:
    """A span whose reference picture is this very picture, and the camera as it is registered in it."""
    reference, lens = folder / "reference.png", folder / "camera.yaml"
    cv2.imwrite(str(reference), picture.image)
    save_intrinsics(lens, intrinsics)
    camera = span.camera.model_copy(update={"reference_image": reference, "intrinsics": lens})
    site = load_site(span.model_copy(update={"camera": camera}), Measure())
    registered, reasons = register(site, picture.image)
    assert registered is not None
    assert not reasons
    return site, registered
