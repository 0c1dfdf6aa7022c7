"""The way to a real mosquitto: each step that can fail is told by its own name."""

import os

import pytest
from brokers import MOSQUITTO, Mosquitto, free_port, make_certificates

from sagnode.daemon.broker import Broker
from sagnode.doctor.broker import LOGIN, NAME, PORT, TLS, check_broker
from sagnode.doctor.findings import Level

needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


def walked(broker, daemon_says=None):
    return {finding.check: finding for finding in check_broker(broker, daemon_says)}


def test_the_first_step_that_fails_is_named_and_the_others_are_told_as_not_tried():
    found = walked(Broker("no-such-host.invalid", 8883, "n", tls=True))
    assert found[NAME].level is Level.FAULT and "mqtt.host" in found[NAME].remedy
    assert {found[step].level for step in (PORT, TLS, LOGIN)} == {Level.SKIPPED}
    found = walked(Broker("127.0.0.1", free_port(), "n"))
    assert found[NAME].level is Level.OK
    assert found[PORT].level is Level.FAULT and "connection refused" in found[PORT].text
    assert "mqtt.port" in found[PORT].remedy


@needs_mosquitto
def test_a_plain_broker_with_a_password(tmp_path):
    import subprocess

    (tmp_path / "passwords").write_text("unit:right\n")
    subprocess.run(["mosquitto_passwd", "-U", tmp_path / "passwords"], check=True)
    (tmp_path / "right").write_text("right\n")
    (tmp_path / "wrong").write_text("wrong\n")
    with Mosquitto(tmp_path, f"password_file {tmp_path}/passwords", anonymous=False) as mosquitto:
        for mqtt5 in (True, False):
            right = Broker("127.0.0.1", mosquitto.port, "n", mqtt5, "unit", tmp_path / "right")
            assert {finding.level for finding in check_broker(right, None)} == {Level.OK}
            wrong = Broker("127.0.0.1", mosquitto.port, "n", mqtt5, "unit", tmp_path / "wrong")
            found = walked(wrong)[LOGIN]
            assert found.level is Level.FAULT and "refused" in found.text
            assert "wrong" not in found.text.replace("refused", "")
        assert "the daemon is connected" in walked(wrong, (True, "connected to b"))[LOGIN].text
        assert "n-doctor" in walked(right, (False, "hung up"))[LOGIN].text


@needs_mosquitto
@pytest.mark.skipif(os.geteuid() != 0, reason="takes a file from another user, which only root can")
def test_a_secret_that_this_user_may_not_read_is_no_fault(tmp_path):
    (tmp_path / "secret").write_text("right\n")
    (tmp_path / "secret").chmod(0o600)
    with Mosquitto(tmp_path) as mosquitto:
        broker = Broker("127.0.0.1", mosquitto.port, "n", True, "unit", tmp_path / "secret")
        for place in (tmp_path, *tmp_path.parents[:2]):
            place.chmod(0o755)
        os.seteuid(65534)
        try:
            found = walked(broker)[LOGIN]
        finally:
            os.seteuid(0)
    assert found.level is Level.SKIPPED and "as root" in found.text


@needs_mosquitto
def test_tls_step_by_step(tmp_path):
    make_certificates(tmp_path)
    lines = [f"cafile {tmp_path}/ca.crt", f"certfile {tmp_path}/server.crt", f"keyfile {tmp_path}/server.key"]
    with Mosquitto(tmp_path, *lines, "require_certificate true") as mosquitto:

        def broker(ca="ca", client=None, host="localhost"):
            cert, key = (tmp_path / f"{client}.crt", tmp_path / f"{client}.key") if client else (None, None)
            return Broker(host, mosquitto.port, "n", True, None, None, True, tmp_path / f"{ca}.crt", cert, key)

        found = walked(broker(client="client"))
        assert found[TLS].level is Level.WARNING and "days" in found[TLS].text  # they were made for two days
        assert found["broker client certificate"].level is Level.WARNING
        assert found[LOGIN].level is Level.OK
        assert walked(broker(ca="other", client="client"))[TLS].level is Level.FAULT
        assert "certificate" in walked(broker(ca="other"))[TLS].text
        assert walked(broker(host="127.0.0.1", client="client"))[TLS].level is Level.FAULT  # another name
        assert walked(broker())[LOGIN].level is Level.FAULT  # no client certificate
        assert walked(broker(client="stranger"))[LOGIN].level is Level.FAULT
        missing = Broker("localhost", mosquitto.port, "n", True, None, None, True, tmp_path / "none.crt")
        assert "none.crt" in walked(missing)[TLS].text
    with Mosquitto(tmp_path) as plain:
        spoken_to_in_tls = Broker("localhost", plain.port, "n", True, None, None, True, tmp_path / "ca.crt")
        assert walked(spoken_to_in_tls)[TLS].level is Level.FAULT
