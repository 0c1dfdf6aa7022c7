"""The AsyncAPI 3 document of what goes over MQTT, made out of the message models themselves.

https://www.asyncapi.com/docs/reference/specification/v3.0.0; seen from the node: it sends readings and receives
commands. This module imports neither NumPy nor OpenCV.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from sagnode.exchange import AlarmMessage, MeasureCommand, PictureCommand, ReplyMessage, ResendCommand
from sagnode.message import HealthMessage, Reading, StatusMessage

PREFIX = "sagnode/v1/{utility}/{line}/{span}/{unit}"
"""Default of mqtt.prefix."""
_REF = "#/components/schemas/{model}"
_MARKUP = re.compile(r":\w+:`~?([^`]+)`|``([^`]+)``")
"""What docstrings mark up for Sphinx: a reference, and code."""


class _Channel(NamedTuple):
    """One topic below the prefix."""

    name: str
    topic: str
    action: str
    retain: bool
    schema: str
    """Name of the payload's schema; empty for a picture."""
    summary: str


CHANNELS = (
    _Channel("status", "status", "send", True, "StatusMessage", "online or offline; offline is also the last will"),
    _Channel(
        "measurement",
        "measurement/{conductor}",
        "send",
        True,
        "Reading",
        "the newest reading, retained; older ones that are sent late or again are marked backfill and not retained",
    ),
    _Channel("health", "health", "send", True, "HealthMessage", "the node itself, with every reading"),
    _Channel(
        "alarm",
        "alarm/{conductor}/{kind}",
        "send",
        True,
        "AlarmMessage",
        "retained while the alarm is in force; an empty message ends it",
    ),
    _Channel("picture", "picture/{conductor}", "send", False, "", "overlay of a reading, on request and on an alarm"),
    _Channel("command", "command", "receive", False, "Command", "one command; a retained one is ignored"),
    _Channel("reply", "reply", "send", False, "ReplyMessage", "the answer to one command, with its correlation data"),
)
_PARAMETERS = {
    "utility": "unit.utility of the node file",
    "line": "unit.line of the node file",
    "span": "unit.span of the node file",
    "unit": "unit.unit of the node file",
    "conductor": "id of the conductor in the span file",
    "kind": "what the alarm is about",
}


def asyncapi_document(version: str) -> dict[str, Any]:
    """The document, ready for JSON.

    Args:
        version: of the software.
    """
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "sagnode",
            "version": version,
            "description": "Sag and ground clearance of the conductors of one span, with uncertainty and quality."
            " Addresses have the default prefix; mqtt.prefix of the node file may set another.",
        },
        "defaultContentType": "application/json",
        "channels": {channel.name: _channel(channel) for channel in CHANNELS},
        "operations": {f"{channel.action}-{channel.name}": _operation(channel) for channel in CHANNELS},
        "components": {
            "messages": {channel.name: _message(channel) for channel in CHANNELS},
            "schemas": _schemas(),
        },
    }


def _channel(channel: _Channel) -> dict[str, Any]:
    address = f"{PREFIX}/{channel.topic}"
    parameters = {name: {"description": text} for name, text in _PARAMETERS.items() if f"{{{name}}}" in address}
    if "kind" in parameters:
        kinds = AlarmMessage.model_json_schema()["$defs"]["AlarmKind"]["enum"]
        parameters["kind"] = {**parameters["kind"], "enum": kinds}
    return {
        "address": address,
        "summary": channel.summary,
        "parameters": parameters,
        "messages": {channel.name: {"$ref": f"#/components/messages/{channel.name}"}},
    }


def _operation(channel: _Channel) -> dict[str, Any]:
    operation: dict[str, Any] = {
        "action": channel.action,
        "channel": {"$ref": f"#/channels/{channel.name}"},
        "summary": channel.summary,
        "messages": [{"$ref": f"#/channels/{channel.name}/messages/{channel.name}"}],
        "bindings": {"mqtt": {"qos": 1, "retain": channel.retain, "bindingVersion": "0.2.0"}},
    }
    if channel.name == "command":
        operation["reply"] = {
            "channel": {"$ref": "#/channels/reply"},
            "messages": [{"$ref": "#/channels/reply/messages/reply"}],
        }
    return operation


def _message(channel: _Channel) -> dict[str, Any]:
    if not channel.schema:
        payload: dict[str, Any] = {"type": "string", "format": "binary"}
        return {"name": channel.name, "contentType": "image/jpeg", "summary": channel.summary, "payload": payload}
    payload = {"$ref": _REF.format(model=channel.schema)}
    return {"name": channel.name, "contentType": "application/json", "summary": channel.summary, "payload": payload}


def _schemas() -> dict[str, Any]:
    sent: tuple[type[BaseModel], ...] = (Reading, StatusMessage, HealthMessage, AlarmMessage, ReplyMessage)
    received: tuple[type[BaseModel], ...] = (MeasureCommand, PictureCommand, ResendCommand)
    modes: list[tuple[type[BaseModel], JsonSchemaMode]] = [
        *((model, "serialization") for model in sent),
        *((model, "validation") for model in received),
    ]
    _, definitions = models_json_schema(modes, ref_template=_REF)
    schemas: dict[str, Any] = plain(definitions["$defs"])
    schemas["Command"] = {"oneOf": [{"$ref": _REF.format(model=model.__name__)} for model in received]}
    return schemas


def plain(schema: dict[str, Any]) -> dict[str, Any]:
    """The same schema with descriptions for readers who know no Sphinx: ``X`` becomes `X`, and a reference its name."""
    return {key: _plain(value, key) for key, value in schema.items()}


def _plain(value: Any, key: str = "") -> Any:
    if isinstance(value, dict):
        return plain(value)
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if key == "description":
        return _MARKUP.sub(r"`\1\2`", value)
    return value
