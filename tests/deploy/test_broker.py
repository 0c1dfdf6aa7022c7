"""deploy/broker in a real mosquitto: who gets in, who may say and hear what, and what a kill -9 costs."""

import contextlib
import itertools
import json
import re
import shutil
import signal
import socket
import ssl

import pytest
from brokers import MOSQUITTO
from utility import CA, ROOT, Party, UtilityBroker, enrol, ran, refusal

pytestmark = pytest.mark.skipif(
    MOSQUITTO is None or shutil.which("openssl") is None, reason="mosquitto or openssl is not installed"
)

A, B = "grid/110kv-7/t12-t13/unit-1", "grid/110kv-7/t12-t13/unit-2"
OWN = ["status", "health", "measurement/L1", "alarm/L1/clearance", "picture/L1", "reply"]


@pytest.fixture(scope="module")
def ca(tmp_path_factory):
    """An authority with a broker, two units and two consumers."""
    directory = tmp_path_factory.mktemp("ca")
    ran(CA, directory / "ca", "init")
    ran(CA, directory / "ca", "broker", "localhost")
    for name in ("scada", "operator"):
        ran(CA, directory / "ca", "consumer", name)
    for unit, name in (("a", A), ("b", B)):
        enrol(directory / "ca", directory / "ca" / unit, name)
    return directory / "ca"


@pytest.fixture
def broker(tmp_path, ca):
    with UtilityBroker(tmp_path, ca) as running:
        yield running


@pytest.fixture
def party(broker, ca):
    def build(who, **options):
        if who in ("scada", "operator"):
            return Party(broker.port, ca, ca / "keys" / f"{who}.crt", key=ca / "keys" / f"{who}.key", **options)
        return Party(broker.port, ca, ca / who / "unit.pem", **options)

    return build


def test_a_unit_writes_its_own_topics_and_nobody_elses(party):
    with party("scada", topic="#") as scada, party("a") as unit:
        assert all(unit.publish(f"sagnode/v1/{A}/{topic}") for topic in OWN)
        foreign = [f"sagnode/v1/{B}/{topic}" for topic in OWN]
        others = [f"sagnode/v1/{A}/command", f"sagnode/v1/{B}/command", f"sagnode/v1/{A}/measurement/L1/more",
                  f"sagnode/v1/{A}", "sagnode/v1/grid", "sagnode", "$SYS/broker/version", "other/topic"]  # fmt: skip
        assert not any(unit.publish(topic) for topic in foreign + others)
        scada.wait_for(lambda s: len(s.messages) >= len(OWN))
        assert sorted(scada.topics()) == sorted(f"sagnode/v1/{A}/{topic}" for topic in OWN)


def test_a_unit_hears_its_own_commands_and_nothing_else(party):
    with party("a") as a, party("b") as b, party("operator") as operator:
        assert b.publish(f"sagnode/v1/{B}/status", retain=True)
        for pattern in ("#", f"sagnode/v1/{B}/#", "sagnode/v1/+/+/+/+/command", "$SYS/#"):
            a.subscribe(pattern)
        assert b.publish(f"sagnode/v1/{B}/measurement/L1")
        assert operator.publish(f"sagnode/v1/{B}/command", b"for b")
        assert operator.publish(f"sagnode/v1/{A}/command", b"for a")
        a.wait_for(lambda p: p.messages)
        assert {message.payload for message in a.messages} == {b"for a"}


def test_commands_come_from_those_who_may_command(party):
    with party("b", topic="#") as b, party("scada") as scada, party("operator") as operator:
        topic = f"sagnode/v1/{B}/command"
        assert not scada.publish(topic, b"no")
        assert operator.publish(topic, b"yes")
        assert not operator.publish(f"sagnode/v1/{B}/measurement/L1", b"forged")
        b.wait_for(lambda p: p.messages)
        assert [message.payload for message in b.messages] == [b"yes"]


def test_nobody_takes_anothers_session_by_its_name(party):
    with party("b", client_id="same") as b, party("a", client_id=B) as a, party("operator", client_id="same"):
        assert a.publish(f"sagnode/v1/{A}/status")
        assert b.publish(f"sagnode/v1/{B}/status")
        assert not b.gone.is_set()


def test_who_has_no_certificate_of_the_authority_stays_outside(broker, ca, tmp_path):
    assert "certificate required" in refusal(broker.port, ca)
    ran(CA, tmp_path / "strange", "init")
    pem = enrol(tmp_path / "strange", tmp_path / "stranger", A)
    assert "unknown ca" in refusal(broker.port, ca, pem)
    # The broker's own certificate is for servers.
    keys = ca / "keys"
    assert "unsupported certificate" in refusal(broker.port, ca, keys / "broker.crt", key=keys / "broker.key")
    pem = enrol(ca, tmp_path / "old", A, by_hand=True, UNTIL="20200101000000Z")
    assert "certificate expired" in refusal(broker.port, ca, pem)
    with socket.create_connection(("localhost", broker.port), 5) as plain:
        plain.sendall(bytes.fromhex("100c00044d5154540402003c0000"))  # an MQTT 3.1.1 CONNECT
        with contextlib.suppress(ConnectionResetError):
            assert plain.recv(1) in (b"", b"\x15")  # the end, or a TLS alert: no CONNACK


def test_nothing_below_tls_1_2_is_spoken(broker, ca):
    old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    old.load_verify_locations(ca / "ca.crt")
    old.set_ciphers("ALL:@SECLEVEL=0")
    with pytest.warns(DeprecationWarning):
        old.minimum_version, old.maximum_version = ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1
    assert "version" in refusal(broker.port, ca, context=old)


def test_a_revoked_unit_is_shut_out_after_the_broker_was_told(tmp_path, party, broker, ca):
    pem = enrol(ca, tmp_path / "lost", B)
    with Party(broker.port, ca, pem):
        pass
    serial = ran("openssl", "x509", "-in", pem, "-noout", "-serial").stdout.strip().removeprefix("serial=")
    ran(CA, ca, "revoke", B, serial)
    broker.take_crl(ca)
    broker.signal(signal.SIGHUP)
    with party("a") as unit:  # the others go on
        assert unit.publish(f"sagnode/v1/{A}/status")
    assert "certificate revoked" in refusal(broker.port, ca, pem)
    with party("b") as unit:  # the same name with its other certificate
        assert unit.publish(f"sagnode/v1/{B}/status")


def test_a_kill_9_costs_nothing_that_was_stored(party, broker):
    """Retained documents, and what waits for a consumer that is away."""
    with party("scada", session_s=3600) as scada:
        scada.subscribe("sagnode/v1/#")
    with party("a") as unit:
        for i in range(50):
            assert unit.publish(f"sagnode/v1/{A}/measurement/L1", f"reading {i}.".encode(), retain=True)
    broker.stored(b"reading 49.")
    broker.kill()
    broker.start()
    with party("scada", session_s=3600) as scada:
        scada.wait_for(lambda s: len(s.messages) >= 50)
        assert [m.payload for m in scada.messages] == [f"reading {i}.".encode() for i in range(50)]
    with party("operator", topic="sagnode/v1/#") as late:
        late.wait_for(lambda s: s.messages)
        assert [m.payload for m in late.messages] == [b"reading 49."]


def test_a_message_too_large_ends_the_connection_of_who_sends_it_only(party):
    with party("b") as b:
        with party("a") as a:
            a.client.reconnect_delay_set(60, 60)
            a.client.publish(f"sagnode/v1/{A}/picture/L1", bytes(2_100_000), qos=0)
            assert a.gone.wait(5)
        assert b.publish(f"sagnode/v1/{B}/status")


def test_every_line_of_the_shipped_files_is_known_to_mosquitto(broker):
    """It starts with them (above); an unknown line would have been refused, and a doubled one too."""
    log = broker.log.read_text()
    assert not [
        line for line, word in itertools.product(log.splitlines(), ("Error", "Invalid", "Unknown")) if word in line
    ]


def test_the_access_list_is_the_published_interface():
    """Neither more nor less than docs/schema/asyncapi.json says of a unit."""
    document = json.loads((ROOT / "docs" / "schema" / "asyncapi.json").read_text())
    wanted = set()
    for operation in document["operations"].values():
        address = document["channels"][operation["channel"]["$ref"].rpartition("/")[2]]["address"]
        topic = address.replace("{utility}/{line}/{span}/{unit}", "%u")
        wanted.add(
            (operation["action"].replace("send", "write").replace("receive", "read"), re.sub(r"{\w+}", "+", topic))
        )
    lines = (ROOT / "deploy/broker/sagnode.acl").read_text().splitlines()
    assert {tuple(line.split()[1:]) for line in lines if line.startswith("pattern ")} == wanted
