"""How the broker is reached, and what each way of failing to reach it means to a technician."""

from __future__ import annotations

import os
import re
import socket
import ssl
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from sagnode.daemon import certificate

CONNECT_TIMEOUT_S = 10.0
RECEIVE_MAX_BYTES = 65536
"""Largest packet that a broker may send (MQTT 5); commands are far smaller."""
_ASKING_TIMEOUT_S = 2.0


@dataclass(frozen=True)
class Broker:
    """Where the broker is and how to speak to it; certificates and password are read anew for each connection."""

    host: str
    port: int
    client_id: str
    mqtt5: bool = True
    username: str | None = None
    password_file: Path | None = None
    tls: bool = False
    ca_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None
    keepalive_s: int = 60

    @property
    def address(self) -> str:
        """Host and port, for messages."""
        return f"{self.host}:{self.port}"

    def client(self, will_topic: str | None, will: bytes) -> mqtt.Client:
        """A client that is not connected yet, with a last will if it is given a topic.

        Raises:
            OSError: password or certificate files cannot be read; ssl.SSLError, a kind of it: they are not valid.
        """
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2,
            client_id=self.client_id,
            protocol=mqtt.MQTTv5 if self.mqtt5 else mqtt.MQTTv311,
            reconnect_on_failure=False,
        )
        client.connect_timeout = CONNECT_TIMEOUT_S
        client.max_inflight_messages_set(0)  # the outbox counts
        if will_topic is not None:
            client.will_set(will_topic, will, qos=1, retain=True, properties=self.properties(PacketTypes.WILLMESSAGE))
        if self.username is not None:
            client.username_pw_set(self.username, _first_line(self.password_file))
        if self.tls:
            client.tls_set_context(self.tls_context())
        return client

    def connect(self, client: mqtt.Client) -> None:
        """Begin to connect a client of :meth:`client`; nothing large will be sent to it.

        Raises:
            OSError, ValueError: the broker is not reached.
        """
        properties = None
        if self.mqtt5:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.MaximumPacketSize = RECEIVE_MAX_BYTES
        # paho spells MQTT 3.1.1's clean session in its constructor; clean_start is MQTT 5's, and its default there.
        client.connect(self.host, self.port, self.keepalive_s, properties=properties)

    def subscribe(self, client: mqtt.Client, topic: str) -> None:
        """Subscribe to a topic of commands: retained ones are not wanted, and are to be known as such."""
        if self.mqtt5:
            options = SubscribeOptions(qos=1, noLocal=True, retainAsPublished=True, retainHandling=2)
            client.subscribe(topic, options=options)
        else:
            client.subscribe(topic, qos=1)

    def properties(
        self,
        packet: int = PacketTypes.PUBLISH,
        expiry_s: float | None = None,
        *,
        content_type: str = "application/json",
        correlation: bytes | None = None,
        about: Iterable[tuple[str, str]] = (),
    ) -> Properties | None:
        """MQTT 5 properties of a message, of text in JSON unless told otherwise; None for MQTT 3.1.1."""
        if not self.mqtt5:
            return None
        properties = Properties(packet)  # type: ignore[no-untyped-call]
        properties.ContentType = content_type
        properties.PayloadFormatIndicator = 1 if content_type == "application/json" else 0
        if correlation is not None:
            properties.CorrelationData = correlation
        about = list(about)
        if about:
            properties.UserProperty = about
        if expiry_s is not None:
            properties.MessageExpiryInterval = max(1, min(0xFFFFFFFF, int(expiry_s)))
        return properties

    def explain(self, error: Exception) -> str:
        """One line: what is wrong with this broker, and what to do."""
        where = self.address
        match error:
            case ssl.SSLCertVerificationError():
                remedy = "check mqtt.host, mqtt.tls.ca_file and the node's clock"
                if "does not include" in error.verify_message or "Missing" in error.verify_message:
                    # Python 3.13 and later verify as RFC 5280 demands; many private authorities are older
                    remedy = (
                        "issue the CA anew with keyUsage keyCertSign, the others with their key identifiers (RFC 5280)"
                    )
                return f"{where}: its certificate is not accepted ({error.verify_message}); {remedy}"
            case ssl.SSLError() if _alert(error):
                return f"{where}: {self.refused_certificate(_alert(error))}"
            case ssl.SSLError():
                return f"{where}: TLS fails ({error.reason or error}); check mqtt.port and the files of [mqtt.tls]"
            case socket.gaierror():
                return f"{where}: name not found ({error.strerror}); check mqtt.host and the node's DNS"
            case ConnectionRefusedError():
                return f"{where}: connection refused; check that the broker runs and mqtt.port is its own"
            case TimeoutError():
                return f"{where}: no answer in {CONNECT_TIMEOUT_S:g} s; check network, firewall and mqtt.host"
            case ConnectionError():
                return f"{where}: {error.strerror or 'hung up'}; check mqtt.port, and whether it wants TLS"
            case OSError() if error.filename:
                return f"{error.filename}: {error.strerror}; the broker cannot be reached without this file"
            case OSError():
                return f"{where}: {error.strerror or error}; check the network"
            case _:
                return f"{where}: {error}; check mqtt.host"

    def certificate_ends_at(self) -> datetime | None:
        """End of the client certificate; None where there is none, or none that can be read."""
        if self.cert_file is None:
            return None
        try:
            return certificate.term(self.cert_file.read_text(encoding="utf-8")).ends
        except (OSError, ValueError):
            return None

    def how_it_hangs_up(self) -> str | None:
        """Why the broker ends a TLS connection before it has answered, or None when it does not say.

        In TLS 1.3 it looks at the client's certificate after the client's side of the handshake is over, and its word
        on that is often lost behind what the client has sent meanwhile. So it is asked again, and nothing is sent.
        """
        if not self.tls:
            return None
        try:
            with (
                socket.create_connection((self.host, self.port), _ASKING_TIMEOUT_S) as raw,
                self.tls_context().wrap_socket(raw, server_hostname=self.host) as secured,
            ):
                secured.recv(1)
        except ssl.SSLError as error:
            return self.refused_certificate(_alert(error)) if _alert(error) else None
        except OSError:
            return None
        return None

    def refused_certificate(self, alert: str) -> str:
        """A sentence for a TLS alert about this client's certificate, and what to do."""
        if alert == "certificate required" or self.cert_file is None:
            return f"wants a client certificate ({alert}); see mqtt.tls.cert_file"
        ends = self.certificate_ends_at()
        remedies = {
            "certificate expired": "renew it (sagnode-enrol request), or set the clock of whoever has a wrong one",
            "certificate revoked": "if this unit is still to be trusted, have a new one signed (sagnode-enrol request)",
            "unknown ca": "it must be signed by an authority that the broker knows",
        }
        remedy = remedies.get(alert, "it must be one for TLS clients, signed by an authority that the broker knows")
        until = f", ends {ends:%Y-%m-%d %H:%M} UTC" if ends else ""
        return f"does not accept {self.cert_file} ({alert}{until}); {remedy}"

    def tls_context(self) -> ssl.SSLContext:
        """TLS 1.2 or later, server name verified, with the client's certificate where there is one.

        Raises:
            OSError: a file cannot be read; ssl.SSLError, a kind of it: it is not valid.
        """
        if self.ca_file is not None:
            self.ca_file.open("rb").close()  # an unreadable file is named; OpenSSL would not say which
        context = ssl.create_default_context(cafile=str(self.ca_file) if self.ca_file else None)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        if self.cert_file is not None:
            for file in (self.cert_file, self.key_file):
                if file is not None:
                    file.open("rb").close()  # an unreadable file is named; load_cert_chain would not say which
            context.load_cert_chain(self.cert_file, self.key_file)
        return context


def _alert(error: ssl.SSLError) -> str:
    """The other side's reason to end the connection, in words; empty when the error is of this side.

    >>> error = ssl.SSLError()
    >>> error.reason = "SSLV3_ALERT_CERTIFICATE_REVOKED"
    >>> _alert(error)
    'certificate revoked'
    """
    found = re.fullmatch(r"(?:SSLV3|TLSV1|TLSV13)_ALERT_(\w+)", error.reason or "")
    return found[1].replace("_", " ").lower() if found else ""


def _first_line(file: Path | None) -> str | None:
    if file is None:
        return None
    credentials = os.environ.get("CREDENTIALS_DIRECTORY")
    if credentials and (Path(credentials) / file.name).exists():
        file = Path(credentials) / file.name
    lines = file.read_text(encoding="utf-8").splitlines()
    return lines[0] if lines else ""
