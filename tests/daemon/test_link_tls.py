"""The link over TLS: certificates that are right, wrong, missing or too old in form."""

import ssl

import pytest
from brokers import MOSQUITTO, Mosquitto, Subscriber, make_certificates
from links import sequences
from nodes import wait_for

from sagnode.daemon.broker import Broker

needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    directory = tmp_path_factory.mktemp("certificates")
    make_certificates(directory)
    return directory


def tls_broker(tmp_path, certificates, *, client_certificates):
    lines = [
        f"cafile {certificates}/ca.crt",
        f"certfile {certificates}/server.crt",
        f"keyfile {certificates}/server.key",
    ]
    return Mosquitto(tmp_path, *lines, *(["require_certificate true"] if client_certificates else []))


@needs_broker
def test_tls_with_client_certificates(tmp_path, node, certificates):
    c = certificates

    def prepare(client):
        client.tls_set(str(c / "ca.crt"), str(c / "client.crt"), str(c / "client.key"))

    with (
        tls_broker(tmp_path, c, client_certificates=True) as broker,
        Subscriber(broker.port, prepare=prepare, host="localhost") as subscriber,
    ):
        n = node(
            host="localhost",
            port=broker.port,
            tls=True,
            ca_file=c / "ca.crt",
            cert_file=c / "client.crt",
            key_file=c / "client.key",
        )
        n.make(30)
        subscriber.wait_for(lambda s: len(set(sequences(s))) == 90)
        wait_for(lambda: n.journal.backlog().depth == 0)


@needs_broker
@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"ca_file": "other.crt"}, "certificate is not accepted"),
        ({"ca_file": "ca.crt", "host": "127.0.0.1"}, "certificate is not accepted"),
        ({"ca_file": "ca.crt"}, "wants a client certificate (certificate required)"),
        ({"ca_file": "ca.crt", "cert_file": "stranger.crt", "key_file": "stranger.key"}, "stranger.crt (unknown ca"),
        ({"ca_file": "ca.crt", "cert_file": "missing.crt", "key_file": "client.key"}, "missing.crt"),
        ({"ca_file": "ca.crt", "cert_file": "client.crt", "key_file": "stranger.key"}, "TLS fails"),
    ],
)
def test_tls_that_cannot_be_is_told(tmp_path, node, certificates, settings, text):
    files = {k: certificates / v for k, v in settings.items() if k.endswith("file")}
    with tls_broker(tmp_path, certificates, client_certificates=True) as broker:
        n = node(port=broker.port, tls=True, **{"host": settings.get("host", "localhost"), **files})
        n.wait_state(text)
        assert not n.link.connected


@needs_broker
def test_plain_against_tls_and_tls_against_plain(tmp_path, node, certificates):
    with tls_broker(tmp_path, certificates, client_certificates=False) as broker:
        node(port=broker.port).wait_state("may want TLS")
    with Mosquitto(tmp_path) as broker:
        node(host="localhost", port=broker.port, tls=True).wait_state("TLS")


def test_a_ca_from_before_rfc_5280_is_told_with_its_remedy(tmp_path):
    """Python 3.13 refuses such a CA; earlier ones take it, so there the same strictness is asked of the context."""
    make_certificates(tmp_path, key_usage=False)
    strict = ssl.create_default_context(cafile=tmp_path / "ca.crt")
    strict.verify_flags |= ssl.VERIFY_X509_STRICT
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(tmp_path / "server.crt", tmp_path / "server.key")
    ours, theirs = ssl.MemoryBIO(), ssl.MemoryBIO()
    client_side = strict.wrap_bio(ours, theirs, server_hostname="localhost")
    server_side = server.wrap_bio(theirs, ours, server_side=True)
    for side in (client_side, server_side):
        with pytest.raises(ssl.SSLWantReadError):
            side.do_handshake()
    with pytest.raises(ssl.SSLCertVerificationError) as refused:
        client_side.do_handshake()
    said = Broker("localhost", 8883, "unit").explain(refused.value)
    assert said.startswith("localhost:8883")
    assert "keyUsage" in said
