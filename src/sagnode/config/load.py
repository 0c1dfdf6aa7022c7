"""Reads the node file and the span file; every fault of both is found in one go.

This module imports neither NumPy nor OpenCV, for the daemon uses it. What needs them (the content of the calibration
file, the geometry of the survey) is looked at by :mod:`sagnode.check.configuration` and by the worker.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sagnode.config import node as node_model
from sagnode.config import span as span_model
from sagnode.config.base import Model
from sagnode.config.document import Document, read_document, read_file, salvage, salvage_list, validate
from sagnode.config.faults import Fault, Unreadable
from sagnode.config.node import Node
from sagnode.config.span import Span
from sagnode.errors import ConfigError

NODE_FILE = "node.toml"
SPAN_FILE = "span.toml"


@dataclass(frozen=True)
class LoadedSpan:
    """A survey that can be used."""

    span: Span
    """Its files as absolute paths."""
    path: Path
    """The span file, absolute."""
    configuration_id: str
    """12 hexadecimal digits of SHA-256 over the span and the content of the files that it names."""


@dataclass(frozen=True)
class LoadedNode:
    """A configuration that can be used."""

    node: Node
    """Its files as absolute paths."""
    span: Span
    """Its files as absolute paths."""
    path: Path
    """The node file, absolute."""
    span_path: Path
    """The span file, absolute."""
    configuration_id: str
    """12 hexadecimal digits of SHA-256 over node, span and the content of the files that the span names.

    It is made of the values in effect: neither comments, nor written-out defaults, nor moving the directory change it.
    """

    def snapshot(self) -> bytes:
        """All of it as JSON, for a process that must go by this and not by what the files have become since."""
        document = {
            "node": self.node.model_dump(mode="json"),
            "span": self.span.model_dump(mode="json"),
            "path": str(self.path),
            "span_path": str(self.span_path),
            "configuration_id": self.configuration_id,
            "files": _named_files_digest(self.span),
        }
        return json.dumps(document).encode()

    @classmethod
    def from_snapshot(cls, snapshot: bytes) -> LoadedNode:
        """What :meth:`snapshot` was made of.

        Raises:
            ConfigError: a file that the span names has another content now, which the configuration id would deny.
        """
        document = json.loads(snapshot)
        loaded = cls(
            Node.model_validate(document["node"]),
            Span.model_validate(document["span"]),
            Path(document["path"]),
            Path(document["span_path"]),
            document["configuration_id"],
        )
        if _named_files_digest(loaded.span) != document["files"]:
            camera = loaded.span.camera
            names = " or ".join(str(file) for file in (camera.intrinsics, camera.reference_image) if file)
            what = f"{names} was changed after the configuration was read"
            raise ConfigError(what, "have it read anew: systemctl reload sagnode, or SIGHUP to sagnode run")
        return loaded


@dataclass(frozen=True)
class Examined:
    """Everything that was found out about a configuration."""

    loaded: LoadedNode | LoadedSpan | None
    """None when there are faults."""
    documents: tuple[Document, ...]
    """The files that were read: the one that was named, then the span file if the first was a node file."""

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Every fault, in the order of the files."""
        return tuple(fault for document in self.documents for fault in document.faults)


def load_node(path: Path) -> LoadedNode:
    """Read a node file and the span file that it names.

    Args:
        path: the node file, or a directory that holds ``node.toml``.

    Raises:
        ConfigError: with every fault of both files.
    """
    examined = examine(path)
    if isinstance(examined.loaded, LoadedNode):
        return examined.loaded
    if isinstance(examined.loaded, LoadedSpan):
        raise _no_node_file(path)
    raise refusal(path, examined.faults)


class _CameraAlone(Model):
    """Of a node file what a picture takes."""

    camera: node_model.Camera


def load_camera(path: Path) -> node_model.Camera:
    """The ``[camera]`` of a node file, its files as absolute paths; nothing else of it need be there or in order.

    The first pictures, those of the calibration's board, are taken before there is a lens file or a survey.

    Args:
        path: the node file, or a directory that holds ``node.toml``.

    Raises:
        ConfigError: with every fault of that table.
    """
    document = read_document(file_in(path, NODE_FILE, SPAN_FILE))
    if document.data is not None:
        if is_span(document.data):
            raise _no_node_file(path)
        document.data = {key: value for key, value in document.data.items() if key == "camera"}
    alone = validate(document, _CameraAlone, lambda _: ())
    if alone is None:
        raise refusal(path, document.faults)
    return _resolved_camera(alone.camera, document.path.parent)


def load_span(path: Path) -> LoadedSpan:
    """Read a span file alone.

    Args:
        path: the span file, or a directory that holds ``span.toml``.

    Raises:
        ConfigError: with every fault.
    """
    document = read_document(file_in(path, SPAN_FILE))
    loaded = _examine_span(document)
    if loaded is None:
        raise refusal(path, document.faults)
    return loaded


def load_any(path: Path) -> LoadedNode | LoadedSpan:
    """Read a node file with its span, or a span file alone, whichever ``path`` is.

    Args:
        path: a node file, a span file, or a directory that holds ``node.toml`` or else ``span.toml``.

    Raises:
        ConfigError: with every fault.
    """
    examined = examine(path)
    if examined.loaded is None:
        raise refusal(path, examined.faults)
    return examined.loaded


def examine(path: Path) -> Examined:
    """Read a node file with its span, or a span file alone, and tell every fault instead of raising."""
    document = read_document(file_in(path, NODE_FILE, SPAN_FILE))
    if document.data is not None and is_span(document.data):
        return Examined(_examine_span(document), (document,))
    node = validate(document, Node, _node_contradictions)
    span_name = (document.data or {}).get("span_file")
    if not isinstance(span_name, str):
        return Examined(None, (document,))
    span_document = read_document(document.path.parent / span_name)
    if span_document.data is None:
        # Not to be read at all: the name may be at fault as well as the file, so say where it stands.
        for fault in span_document.faults:
            document.blame(("span_file",), str(fault) if fault.line else fault.text)
        return Examined(None, (document,))
    loaded_span = _examine_span(span_document)
    if node is None or loaded_span is None:
        return Examined(None, (document, span_document))
    digest = _digest([_effective(node), loaded_span.configuration_id.encode()])
    resolved = _resolved_node(node, document.path.parent)
    loaded = LoadedNode(resolved, loaded_span.span, document.path, span_document.path, digest)
    return Examined(loaded, (document, span_document))


_INIT = "'sagnode config init' writes files to start from"


def refusal(path: Path, faults: Iterable[Fault]) -> ConfigError:
    """The error that tells every fault of a configuration."""
    faults = tuple(faults)
    sentences = tuple(str(fault) for fault in faults)
    if any(isinstance(fault, Unreadable) for fault in faults):
        return ConfigError(sentences[0], f"check the path and who may read it; {_INIT}", sentences)
    what = sentences[0] if len(sentences) == 1 else f"{len(sentences)} faults in the configuration {path}"
    return ConfigError(what, f"mend this, then look again with: sagnode config check --config {path}", sentences)


def _no_node_file(path: Path) -> ConfigError:
    return ConfigError(
        f"{path} is a span file, and this needs the node file that names it",
        f"give the path of a file with [unit], span_file, [camera] and [schedule]; {_INIT}",
    )


def file_in(path: Path, *names: str) -> Path:
    """The file that a path means, absolute: itself, or the first of the names that is in that directory."""
    # os.path and not Path's methods: names stay the user's (resolve() follows links), and a directory that may not be
    # looked into is no exception here but a fault when the file is read.
    absolute = Path(os.path.abspath(path))  # noqa: PTH100
    if not os.path.isdir(absolute):  # noqa: PTH112
        return absolute
    return next((absolute / name for name in names if os.path.isfile(absolute / name)), absolute / names[0])  # noqa: PTH113


def is_span(data: dict[str, Any]) -> bool:
    """Whether these are a span file's keys rather than a node file's."""
    return len(data.keys() & Span.model_fields.keys()) > len(data.keys() & Node.model_fields.keys())


def _examine_span(document: Document) -> LoadedSpan | None:
    span = validate(document, Span, span_contradictions)
    camera = (document.data or {}).get("camera")
    contents = list(_file_contents(document, camera)) if isinstance(camera, dict) else []
    document.faults.sort(key=lambda fault: fault.line or 0)
    if span is None or document.faults:
        return None
    digest = _digest([_effective(span), *contents])
    return LoadedSpan(resolved_span(span, document.path.parent), document.path, digest)


def _file_contents(document: Document, camera: dict[str, Any]) -> Iterator[bytes]:
    """Content of the files that a span names; one that cannot be read is a fault."""
    for key, source in (
        ("intrinsics", "make it with: sagnode calibrate"),
        ("reference_image", "or leave this key out"),
    ):
        name = camera.get(key)
        if isinstance(name, str):
            content = read_file(document.path.parent / name)
            if isinstance(content, str):
                document.blame(("camera", key), f"{content}; {source}")
            else:
                yield content


def _node_contradictions(data: dict[str, Any]) -> Iterable[tuple[str, str]]:
    return node_model.inconsistencies(
        salvage(node_model.Camera, data.get("camera")), salvage(node_model.Schedule, data.get("schedule"))
    )


def span_contradictions(data: dict[str, Any]) -> Iterable[tuple[str, str]]:
    """Contradictions between a span file's tables, those at fault left out."""
    ground = data.get("ground")
    return span_model.inconsistencies(
        salvage_list(span_model.Conductor, data.get("conductors")),
        salvage_list(span_model.Landmark, data.get("landmarks")),
        salvage_list(span_model.Obstacle, ground.get("obstacles") if isinstance(ground, dict) else None),
        salvage(span_model.CameraSurvey, data.get("camera")),
    )


def _effective(model: Node | Span) -> bytes:
    return json.dumps(model.model_dump(mode="json"), sort_keys=True).encode()


def _named_files_digest(span: Span) -> str:
    contents = (read_file(file) for file in (span.camera.intrinsics, span.camera.reference_image) if file)
    return _digest(content if isinstance(content, bytes) else b"" for content in contents)


def _digest(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "big") + part)
    return digest.hexdigest()[:12]


def resolved_span(span: Span, base: Path) -> Span:
    """The span with its files as paths below ``base``."""
    camera = span.camera
    files = {
        "intrinsics": base / camera.intrinsics,
        "reference_image": camera.reference_image and base / camera.reference_image,
    }
    return span.model_copy(update={"camera": camera.model_copy(update=files)})


def _resolved_node(node: Node, base: Path) -> Node:
    camera = _resolved_camera(node.camera, base)
    storage = node.storage
    if storage.state_dir is not None:
        storage = storage.model_copy(update={"state_dir": base / storage.state_dir})
    mqtt = node.mqtt
    if mqtt is not None:
        tls = mqtt.tls
        if tls is not None:
            names = {"ca_file": tls.ca_file, "cert_file": tls.cert_file, "key_file": tls.key_file}
            tls = tls.model_copy(update={key: name and _secret(name, base) for key, name in names.items()})
        password_file = mqtt.password_file and _secret(mqtt.password_file, base)
        mqtt = mqtt.model_copy(update={"tls": tls, "password_file": password_file})
    update = {"span_file": base / node.span_file, "camera": camera, "storage": storage, "mqtt": mqtt}
    return node.model_copy(update=update)


def _resolved_camera(camera: node_model.Camera, base: Path) -> node_model.Camera:
    if camera.replay is None:
        return camera
    replay = camera.replay.model_copy(update={"path": str(base / camera.replay.path)})
    return camera.model_copy(update={"replay": replay})


def _secret(name: Path, base: Path) -> Path:
    """A password or key file: systemd's copy of it (LoadCredential=) if there is one, else below ``base``."""
    credentials = os.environ.get("CREDENTIALS_DIRECTORY")
    if credentials and not name.is_absolute() and (Path(credentials) / name).exists():
        return Path(credentials) / name
    return base / name
