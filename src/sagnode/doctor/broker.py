"""The way to the broker, step by step: name, port, TLS, certificates' dates, log-in.

Each step is a finding of its own, since each has another remedy. Nothing is published, for whatever were sent to try
the broker could pass for a reading; whether readings arrive the daemon knows, while it runs.
"""

from __future__ import annotations

import contextlib
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import paho.mqtt.client as mqtt

from sagnode.capture.bounded import BoundedCalls
from sagnode.daemon.broker import CONNECT_TIMEOUT_S, Broker
from sagnode.doctor.findings import Finding, Level, fault, ok, skipped, warning

EXPIRY_DAYS = 30.0
"""A certificate that ends sooner is a warning: a tower is not visited overnight."""
NAME, PORT, TLS, LOGIN = "broker name", "broker port", "broker TLS", "broker log-in"
DELIVERY = "broker delivery"
_DATE = "%b %d %H:%M:%S %Y %Z"  # as OpenSSL writes them


def check_broker(broker: Broker, daemon_says: tuple[bool, str] | None) -> Iterator[Finding]:
    """Walk to the broker; steps behind one that fails are reported as skipped.

    Args:
        broker: of the configuration.
        daemon_says: whether a running daemon is connected and its own words; None while none runs. A second client of
            the same name would throw it out, so then the log-in is tried under another name, or not at all.
    """
    steps = [(NAME, _name), (PORT, _port)]
    if broker.tls:
        steps.append((TLS, _tls))
    failed = ""
    for check, step in steps:
        finding = skipped(check, f"not tried, for {failed} failed") if failed else step(broker)
        failed = check if finding.level is Level.FAULT else failed
        yield finding
    if broker.cert_file is not None:
        yield _own_certificate(broker, broker.cert_file)
    if failed:
        yield skipped(LOGIN, f"not tried, for {failed} failed")
    elif daemon_says is not None and daemon_says[0]:
        yield ok(LOGIN, f"the daemon is connected ({daemon_says[1]})")
    else:
        yield _log_in(broker, beside=daemon_says is not None)


def _name(broker: Broker) -> Finding:
    calls = BoundedCalls("name")
    try:
        found = calls.call(lambda: socket.getaddrinfo(broker.host, broker.port, type=socket.SOCK_STREAM), 15.0)
    except TimeoutError:
        return fault(
            NAME, f"{broker.host}: no answer from the name server in 15 s", "check network and /etc/resolv.conf"
        )
    except (OSError, UnicodeError) as error:
        return _explained(NAME, broker, error)
    finally:
        calls.end()
    return ok(NAME, f"{broker.host} is {', '.join(sorted({str(entry[4][0]) for entry in found}))}")


def _port(broker: Broker) -> Finding:
    began = time.monotonic()
    try:
        socket.create_connection((broker.host, broker.port), CONNECT_TIMEOUT_S).close()
    except OSError as error:
        return _explained(PORT, broker, error)
    return ok(PORT, f"{broker.address} answers, {1000 * (time.monotonic() - began):.0f} ms")


def _tls(broker: Broker) -> Finding:
    try:
        with (
            socket.create_connection((broker.host, broker.port), CONNECT_TIMEOUT_S) as plain,
            broker.tls_context().wrap_socket(plain, server_hostname=broker.host) as secure,
        ):
            version, certificate = secure.version(), secure.getpeercert() or {}
    except OSError as error:
        return _explained(TLS, broker, error)
    ends = str(certificate.get("notAfter", ""))
    left = _days_left(ends)
    text = f"{version}, the server's certificate is accepted and ends {ends}"
    if left is not None and left < EXPIRY_DAYS:
        return warning(TLS, f"{text}, in {left:.0f} days", "have the broker's certificate renewed")
    return ok(TLS, text)


def _own_certificate(broker: Broker, file: Path) -> Finding:
    """Python's ssl does not tell the dates of a client's own certificate; openssl does, where it is installed."""
    check = "broker client certificate"
    try:
        file.open("rb").close()
    except OSError as error:
        return _explained(check, broker, error)
    program = shutil.which("openssl")
    if program is None:
        return skipped(check, f"the dates of {file} are not known here: openssl is not installed")
    words = [program, "x509", "-noout", "-enddate", "-in", str(file)]
    try:
        said = subprocess.run(words, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return skipped(check, f"the dates of {file} are not known here: {error}")
    if said.returncode:
        return fault(check, f"{file} is no certificate that can be read", "put the client's PEM certificate there")
    ends = said.stdout.strip().removeprefix("notAfter=")
    left = _days_left(ends)
    if left is not None and left < EXPIRY_DAYS:
        level = fault if left <= 0 else warning
        when = f"ended {ends}" if left <= 0 else f"ends {ends}, in {left:.0f} days"
        return level(check, f"{file} {when}", "enrol the unit anew, before it is locked out")
    return ok(check, f"{file} ends {ends}")


def _log_in(broker: Broker, *, beside: bool) -> Finding:
    if beside:
        broker = Broker(**{**vars(broker), "client_id": f"{broker.client_id}-doctor"})
    answers: list[object] = []
    try:
        client = broker.client(None, b"")
        client.on_connect = lambda _client, _userdata, _flags, reason, _properties: answers.append(reason)
        client.connect(broker.host, broker.port, broker.keepalive_s)
    except (OSError, ValueError) as error:
        return _explained(LOGIN, broker, error)
    until = time.monotonic() + CONNECT_TIMEOUT_S
    code = mqtt.MQTT_ERR_SUCCESS
    while not answers and code == mqtt.MQTT_ERR_SUCCESS and time.monotonic() < until:
        code = client.loop(0.2)
    with contextlib.suppress(OSError, ValueError):
        client.disconnect()
    if not answers:
        said = "hung up before it answered" if code != mqtt.MQTT_ERR_SUCCESS else "accepts but does not answer"
        remedy = "it may want TLS, a client certificate (mqtt.tls.cert_file), or another mqtt.protocol"
        return fault(LOGIN, f"{broker.address} {said}", remedy)
    reason = answers[0]
    if getattr(reason, "is_failure", False):
        remedy = "check mqtt.username, password_file and certificate"
        if "not supported" in str(reason).lower():
            remedy = "it must permit QoS 1 and retained messages"
        return fault(LOGIN, f"{broker.address} refused: {reason}", remedy)
    return ok(LOGIN, f"{broker.address} accepts {broker.client_id}, MQTT {'5' if broker.mqtt5 else '3.1.1'}")


def _explained(check: str, broker: Broker, error: Exception) -> Finding:
    if isinstance(error, PermissionError) and error.filename:
        # What is secret is the service's to read; that says nothing of the way to the broker.
        return skipped(check, f"not tried: {error.filename} may not be read by this user; run doctor as root")
    what, _, remedy = broker.explain(error).rpartition("; ")
    return fault(check, what or remedy, remedy if what else "")


def _days_left(ends: str) -> float | None:
    try:
        return (datetime.strptime(ends, _DATE).replace(tzinfo=UTC) - datetime.now(UTC)).total_seconds() / 86400
    except ValueError:
        return None
