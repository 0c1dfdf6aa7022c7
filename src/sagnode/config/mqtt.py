"""The node file's table ``[mqtt]``: which broker, how encrypted, under which topics."""

from __future__ import annotations

import string
from typing import Literal

from pydantic import Field, field_validator, model_validator

from sagnode.config.base import FileName, Model, Text


class Tls(Model):
    """TLS to the broker: 1.2 or later, server name verified."""

    ca_file: FileName | None = None
    """Default: the system's."""
    cert_file: FileName | None = None
    """Client certificate."""
    key_file: FileName | None = None

    @model_validator(mode="after")
    def _pair(self) -> Tls:
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file go together")
        return self


class Mqtt(Model):
    """The broker."""

    host: str = Field(min_length=1, max_length=253)
    port: int = Field(default=8883, ge=1, le=65535)
    protocol: Literal["5", "3.1.1"] = "5"
    client_id: Text | None = None
    """Default: sagnode-<unit>."""
    prefix: Text = "sagnode/v1/{utility}/{line}/{span}/{unit}"
    username: Text | None = None
    password_file: FileName | None = None
    """First line is the password; relative to $CREDENTIALS_DIRECTORY under systemd, else to this file."""
    tls: Tls | None = None
    insecure_plaintext: bool = False
    """Say it twice: without [mqtt.tls] only the loopback is spoken to unless this is true."""
    keepalive_s: int = Field(default=60, ge=5, le=3600)
    expiry_s: int = Field(default=86400, ge=60, le=2**32 - 2)
    """MQTT 5 message expiry of measurements."""
    inflight: int = Field(default=5, ge=1, le=100)
    """Readings handed to the client at once; the journal holds the rest."""
    backlog_per_s: float = Field(default=50.0, ge=0.001, le=1e6)
    """Rate at which old readings are drained after an outage."""

    @field_validator("host")
    @classmethod
    def _host_is_a_name(cls, host: str) -> str:
        if set(host) & set("/@[]") or host.count(":") == 1 or not host.isprintable() or " " in host:
            raise ValueError("must be a name or an address alone; port, username and password_file have their own keys")
        return host

    @field_validator("prefix")
    @classmethod
    def _prefix_is_a_topic(cls, prefix: str) -> str:
        known = {"utility", "line", "span", "unit"}
        try:
            fields = {field for _, field, _, _ in string.Formatter().parse(prefix) if field is not None}
        except ValueError as error:
            raise ValueError(f"{error}; write {{utility}}, {{line}}, {{span}} or {{unit}}") from None
        if fields - known:
            raise ValueError(
                f"unknown field {{{min(fields - known)}}}; there are {{utility}}, {{line}}, {{span}}, {{unit}}"
            )
        if not prefix or set("+#\0") & set(prefix) or prefix.startswith(("/", "$")) or prefix.endswith("/"):
            raise ValueError("must be a topic: not empty, without + and #, no / at either end, no $ in front")
        return prefix

    @model_validator(mode="after")
    def _encrypted_or_said_twice(self) -> Mqtt:
        local = self.host in {"localhost", "127.0.0.1", "::1"}
        if self.tls is None and not local and not self.insecure_plaintext:
            raise ValueError(
                f"{self.host} would be spoken to in plain text; add a table [mqtt.tls],"
                " or say insecure_plaintext = true"
            )
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file needs a username")
        return self
