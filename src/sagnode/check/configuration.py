"""Looks a configuration over: faults that stop it, and warnings about what will disappoint on site.

Nothing here imports NumPy or OpenCV by itself; the calibration file and the geometry are looked at where they are
installed, which is everywhere but on a broken installation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sagnode.config.document import Document
from sagnode.config.faults import Fault
from sagnode.config.guard import exposures
from sagnode.config.lines import KeyPath
from sagnode.config.load import LoadedNode, LoadedSpan, examine
from sagnode.config.mqtt import Mqtt
from sagnode.config.node import Node
from sagnode.config.span import Span
from sagnode.errors import ConfigError, FrameError

Warned = tuple[KeyPath, str]
"""A key path and a sentence that says what is odd, why it matters and what to do."""


@dataclass(frozen=True)
class Report:
    """The outcome of :func:`check`."""

    loaded: LoadedNode | LoadedSpan | None
    """None when it cannot even be loaded."""
    faults: tuple[Fault, ...]
    """What stops the configuration from being used."""
    warnings: tuple[Fault, ...]
    """What can be used, and is probably not what was meant."""


def check(path: Path) -> Report:
    """Look over a node file with its span, or a span file alone.

    Args:
        path: node file, span file, or a directory with ``node.toml`` or ``span.toml``.
    """
    examined = examine(path)
    loaded = examined.loaded
    if loaded is None:
        return Report(None, examined.faults, ())
    span_document = examined.documents[-1]
    faults, warnings = _look_at_span(span_document, loaded)
    warnings += [span_document.fault(key, text) for key, text in _phase_warnings(loaded.span)]
    documents = {document.path: document for document in examined.documents}
    warnings += [documents[file].fault(key, text) for file, key, text in exposures(loaded)]
    if isinstance(loaded, LoadedNode):
        node_document = examined.documents[0]
        said = [*_node_warnings(loaded.node, loaded.span), *_file_warnings(loaded.node)]
        warnings = [*(node_document.fault(key, text) for key, text in said), *warnings]
    return Report(loaded, tuple(faults), tuple(warnings))


def _look_at_span(document: Document, loaded: LoadedNode | LoadedSpan) -> tuple[list[Fault], list[Fault]]:
    """Faults of the calibration file and the reference image, and warnings about the survey's geometry."""
    span = loaded.span
    try:
        from sagnode.calibrate.files import load_intrinsics
        from sagnode.check.reference import read_reference, reference_warnings
        from sagnode.check.sightlines import survey_warnings
    except ImportError as error:
        text = f"the calibration file and the geometry were not looked at, for {error.name} cannot be imported"
        return [], [document.fault((), text)]
    faults: list[Fault] = []
    try:
        intrinsics = load_intrinsics(span.camera.intrinsics)
    except ConfigError as error:
        return [document.fault(("camera", "intrinsics"), fault) for fault in error.faults], []
    said = [*_calibration_warnings(span), *survey_warnings(span, intrinsics)]
    file = span.camera.reference_image
    if file is not None:
        try:
            said += reference_warnings(file, read_reference(file, intrinsics), span.landmarks)
        except FrameError as error:
            faults.append(document.fault(("camera", "reference_image"), str(error)))
    if isinstance(loaded, LoadedNode):
        said += _size_warnings(loaded.node, intrinsics.width, intrinsics.height)
    return faults, [document.fault(key, text) for key, text in said]


def _calibration_warnings(span: Span) -> Iterator[Warned]:
    from sagnode.calibrate.files import GOOD_RMS_PX, stated_error

    stated = stated_error(span.camera.intrinsics)
    if stated is not None and not 0 <= stated[1] <= GOOD_RMS_PX:
        text = (
            f"were made with {stated[0]} = {stated[1]:.3g} px, and {GOOD_RMS_PX:g} px is much; such a lens draws the"
            " wires elsewhere than they are; calibrate anew, with sharp pictures of a flat board"
        )
        yield ("camera", "intrinsics"), text


def _phase_warnings(span: Span) -> Iterator[Warned]:
    first: dict[tuple[str | None, str], str] = {}
    for index, conductor in enumerate(span.conductors):
        if not conductor.measured or conductor.phase is None:
            continue
        other = first.setdefault((conductor.circuit, conductor.phase), conductor.id)
        if other != conductor.id:
            text = (
                f"{conductor.id} and {other} are both {conductor.phase}; readings of the one could be taken for the"
                " other's; give each its own phase, or name the circuit of each where the towers carry several"
            )
            yield ("conductors", index, "phase"), text


def _size_warnings(node: Node, width: int, height: int) -> Iterator[Warned]:
    camera = node.camera
    source = camera.v4l2 if camera.backend == "v4l2" else camera.picamera2
    if camera.backend != "replay" and (source.width, source.height) != (width, height):
        text = (
            f"belong to pictures of {width}x{height} px, and the node's [camera.{camera.backend}] takes"
            f" {source.width}x{source.height}; every frame would be refused; calibrate at the size that is used"
        )
        yield ("camera", "intrinsics"), text


def _node_warnings(node: Node, span: Span) -> Iterator[Warned]:
    if node.unit.span != span.name:
        text = f"'{node.unit.span}' is not the name in the span file ('{span.name}'); is this the survey of that span?"
        yield ("unit", "span"), text
    if node.unit.commissioning:
        yield ("unit", "commissioning"), "every reading is marked as a test; set it to false when the unit is accepted"
    period = node.schedule.interval_s
    if period is not None and node.schedule.deadline_s > period:
        text = f"{node.schedule.deadline_s:g} s is longer than interval_s = {period:g}; a slow reading skips the next"
        yield ("schedule", "deadline_s"), text
    if node.mqtt is None:
        yield (), "there is no table [mqtt]; readings are kept and shown here, and published nowhere"
    elif node.mqtt.tls is None and node.mqtt.insecure_plaintext:
        yield ("mqtt", "insecure_plaintext"), "readings and password travel in plain text; add a table [mqtt.tls]"


def _file_warnings(node: Node) -> Iterator[Warned]:
    """Files that are not needed to measure, so that their absence stops nothing, but something else will."""
    replay = node.camera.replay
    if node.camera.backend == "replay" and replay is not None and not _matches(Path(replay.path)):
        yield ("camera", "replay", "path"), f"there are no frames: {replay.path} matches nothing"
    if node.camera.backend == "v4l2" and not Path(node.camera.v4l2.device).exists():
        yield ("camera", "v4l2", "device"), f"{node.camera.v4l2.device} is not there (on this machine, now)"
    for key, path in _mqtt_files(node.mqtt) if node.mqtt else ():
        if path is not None and not _seen(path):
            yield key, f"file not found: {path}; without it the broker is not spoken to"


def _mqtt_files(mqtt: Mqtt) -> Iterator[tuple[KeyPath, Path | None]]:
    yield ("mqtt", "password_file"), mqtt.password_file
    if mqtt.tls is not None:
        yield ("mqtt", "tls", "ca_file"), mqtt.tls.ca_file
        yield ("mqtt", "tls", "cert_file"), mqtt.tls.cert_file
        yield ("mqtt", "tls", "key_file"), mqtt.tls.key_file


def _matches(path: Path) -> bool:
    """Whether a path, directory or glob names anything."""
    if path.exists():
        return not path.is_dir() or any(path.iterdir())
    return any(path.parent.glob(path.name)) if path.parent.is_dir() and path.name else False


def _seen(path: Path) -> bool:
    """Whether a file is there; one in a directory that this user may not look into gets the benefit of the doubt."""
    try:
        return path.exists()
    except PermissionError:
        return True
