"""The link against a real mosquitto: delivery, outages, TLS, passwords, and what a technician is told."""

import logging
import signal
import socket
import ssl
import subprocess
import threading
import time
from datetime import timedelta

import pytest
from brokers import MOSQUITTO, Mosquitto, Subscriber, free_port, make_certificates
from readings import START, fill

from sagnode.daemon import session
from sagnode.daemon.broker import Broker
from sagnode.daemon.journal import Journal
from sagnode.daemon.link import Link
from sagnode.daemon.outbox import Outbox
from sagnode.daemon.session import Terms

pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")

OFFLINE, LOST, ONLINE = b'{"state":"offline"}', b'{"state":"lost"}', b'{"state":"online"}'


class Node:
    def __init__(self, directory, *, inflight=5, backlog_per_s=2000.0, expiry_s=1e9, **broker):
        self.journal = Journal(directory / "journal.sqlite")
        self.outbox = Outbox(
            self.journal,
            inflight=inflight,
            backlog_per_s=backlog_per_s,
            expiry_s=expiry_s,
            now=lambda: START + timedelta(hours=1),
        )
        settings = {"host": "127.0.0.1", "client_id": "node-1", "keepalive_s": 5, **broker}
        self.link = Link(Terms(Broker(**settings), "t/1", lambda: ONLINE, LOST, 3600.0), self.outbox)
        self.link.start()

    def make(self, bursts):
        for _ in range(bursts):
            fill(self.journal, 1)
            self.link.wake()

    def wait_connected(self, seconds=10.0):
        until = time.monotonic() + seconds
        while not self.link.connected:
            assert time.monotonic() < until, self.link.state
            time.sleep(0.01)

    def wait_state(self, text, seconds=10.0):
        until = time.monotonic() + seconds
        while text not in self.link.state:
            assert time.monotonic() < until, self.link.state
            time.sleep(0.01)

    def close(self):
        self.link.stop(0.0, OFFLINE)
        self.journal.close()


@pytest.fixture
def node(tmp_path):
    nodes = []

    def build(**options):
        nodes.append(Node(tmp_path, **options))
        return nodes[-1]

    yield build
    for made in nodes:
        made.close()


def sequences(subscriber):
    return [r["sequence"] for r in subscriber.readings()]


@pytest.mark.parametrize("mqtt5", [True, False])
def test_readings_arrive_and_are_delivered_on_puback(tmp_path, node, mqtt5):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port, mqtt5=mqtt5)
        n.make(3)
        n.link.show("health", b'{"ok":1}')
        subscriber.wait_for(lambda s: len(s.readings()) == 9 and s.of("health"))
        assert sorted(sequences(subscriber)) == list(range(1, 10))
        until = time.monotonic() + 3
        while n.journal.backlog().depth and time.monotonic() < until:
            time.sleep(0.01)
        assert n.journal.backlog().depth == 0
        assert subscriber.of("status")[0].payload == ONLINE
        message = subscriber.of("measurement")[0]
        assert message.topic.startswith("t/1/measurement/L")
        if mqtt5:
            assert message.properties.ContentType == "application/json"
            assert message.properties.MessageExpiryInterval > 0


def test_newest_is_retained_and_backfill_does_not_overwrite_it(tmp_path, node):
    with Mosquitto(tmp_path) as broker:
        n = node(port=broker.port)
        n.make(20)
        until = time.monotonic() + 10
        while n.journal.backlog().depth and time.monotonic() < until:
            time.sleep(0.01)
        with Subscriber(broker.port) as late:
            late.wait_for(lambda s: len(s.readings()) == 3)
            assert sorted(sequences(late)) == [58, 59, 60]
            assert not any(r["backfill"] for r in late.readings())
            assert all(m.retain for m in late.of("measurement"))


def test_clean_stop_says_offline_and_a_lost_node_is_told_by_its_will(tmp_path, node):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port)
        n.make(1)
        n.wait_connected()
        before = time.monotonic()
        n.link.stop(5.0, OFFLINE)
        assert time.monotonic() - before < 2.0
        subscriber.wait_for(lambda s: [m.payload for m in s.of("status")] == [ONLINE, OFFLINE])
        assert n.journal.backlog().depth == 0
        with Subscriber(broker.port, "t/1/status") as late:
            late.wait_for(lambda s: s.messages)
            assert late.messages[0].retain
            assert late.messages[0].payload == OFFLINE


def test_broker_killed_and_restarted_again_and_again_nothing_is_lost(tmp_path, node):
    broker = Mosquitto(tmp_path)
    with broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port)
        for round_ in range(3):
            n.make(20)
            time.sleep(0.05 * round_)
            broker.kill()
            n.make(20)
            broker.start()
            assert subscriber.subscribed.wait(10)
        n.make(5)
        subscriber.wait_for(lambda s: n.journal.backlog().depth == 0, 20)
        # What the broker acknowledged while the subscriber was not there yet is the broker's affair, so the journal
        # is asked what was delivered and the subscriber what arrived after the last restart.
        assert n.journal.next_sequence == 3 * 125 + 1
        subscriber.wait_for(lambda s: {373, 374, 375} <= set(sequences(s)))
        assert set(sequences(subscriber)) <= set(range(1, 376))


def test_with_a_subscriber_that_stays_nothing_is_lost_through_a_cut_link(tmp_path, node):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber, Cable(broker.port) as cable:
        n = node(port=cable.port)
        for _ in range(6):
            n.make(10)
            time.sleep(0.15)
            cable.cut()
            n.make(5)
        subscriber.wait_for(lambda s: n.journal.backlog().depth == 0 and len(set(sequences(s))) == 270, 30)
        received = sequences(subscriber)
        assert set(received) == set(range(1, 271))
        repeated = len(received) - len(set(received))
        assert repeated <= 6 * 5  # at most what was on the wire at each cut


def test_a_broker_that_falls_silent_is_left_and_found_again(tmp_path, node, monkeypatch):
    monkeypatch.setattr(session, "PUBACK_WAIT_S", 1.0)
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port)
        n.wait_connected()
        broker.signal(signal.SIGSTOP)
        n.make(2)
        n.wait_state("no acknowledgement")
        broker.signal(signal.SIGCONT)
        subscriber.wait_for(lambda s: set(sequences(s)) == {1, 2, 3, 4, 5, 6}, 25)


def test_never_more_on_the_wire_than_agreed(tmp_path, node):
    with Deaf() as deaf:
        n = node(port=deaf.port, inflight=5)
        n.make(50)
        time.sleep(1.0)
        assert deaf.publishes <= 5 + 1  # and the status
        deaf.hang_up()
        time.sleep(1.5)
        assert deaf.publishes <= 2 * (5 + 1)


def test_the_daemon_does_not_wait_for_the_network(tmp_path, node):
    with Deaf() as deaf:
        n = node(port=deaf.port)
        before = time.monotonic()
        for _ in range(100):
            n.link.wake()
            n.link.show("health", b"{}")
        assert time.monotonic() - before < 0.5
        before = time.monotonic()
        n.link.stop(0.5, OFFLINE)
        assert time.monotonic() - before < 4.0


def test_a_backlog_is_drained_fast_and_a_fresh_reading_does_not_wait(tmp_path, node):
    with Mosquitto(tmp_path, "max_queued_messages 0") as broker, Subscriber(broker.port) as subscriber:
        journal = Journal(tmp_path / "journal.sqlite")
        for _ in range(30):
            fill(journal, 1, [f"L{i}" for i in range(100)])
        journal.close()
        n = node(port=broker.port, backlog_per_s=300.0, inflight=20)
        n.wait_connected()
        time.sleep(0.3)
        first = n.journal.next_sequence
        n.make(1)
        subscriber.wait_for(lambda s: first in sequences(s))
        assert n.journal.backlog().depth > 0  # it passed the others
        subscriber.wait_for(lambda s: n.journal.backlog().depth == 0, 20)
        assert sorted(sequences(subscriber)) == list(range(1, 3004))


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"host": "no-such-host.invalid", "port": 1883}, "name not found"),
        ({"host": "bad..name", "port": 1883}, "bad..name"),
        ({"host": "127.0.0.1", "port": None}, "connection refused"),
    ],
)
def test_unreachable_is_one_clear_line(node, caplog, settings, text):
    with caplog.at_level(logging.ERROR):
        n = node(**{**settings, "port": settings["port"] or free_port()})
        n.wait_state(text)
        time.sleep(1.5)
    lines = [r.getMessage() for r in caplog.records if text in r.getMessage()]
    assert len(lines) == 1
    assert "check" in lines[0]
    assert not any(r.exc_info for r in caplog.records)


def test_passwords_right_wrong_and_missing(tmp_path, node, monkeypatch):
    passwords = tmp_path / "passwords"
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(passwords), "node", "s3cret"], check=True, capture_output=True)
    secret = tmp_path / "mqtt-password"
    secret.write_text("wrong\n")
    credentials = tmp_path / "credentials"
    credentials.mkdir()
    with Mosquitto(tmp_path, f"password_file {passwords}", anonymous=False) as broker:
        n = node(port=broker.port, username="node", password_file=secret)
        n.wait_state("refused")
        assert "mqtt.password_file" in n.link.state
        secret.unlink()
        n.wait_state("No such file")
        assert str(secret) in n.link.state
        # systemd's credential comes first, and is read anew at each attempt.
        monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(credentials))
        (credentials / "mqtt-password").write_text("s3cret\n")
        n.wait_connected(20)


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
        assert n.journal.backlog().depth <= 90


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


def test_plain_against_tls_and_tls_against_plain(tmp_path, node, certificates):
    with tls_broker(tmp_path, certificates, client_certificates=False) as broker:
        node(port=broker.port).wait_state("may want TLS")
    with Mosquitto(tmp_path) as broker:
        node(host="localhost", port=broker.port, tls=True).wait_state("TLS")


def test_a_second_client_with_the_same_name_is_told(tmp_path, node):
    with Mosquitto(tmp_path) as broker:
        n = node(port=broker.port)
        n.wait_connected()
        with Subscriber(broker.port, prepare=lambda c: setattr(c, "_client_id", b"node-1")):
            n.wait_state("client_id")


class Cable:
    """A TCP relay that can be cut; it lets connections through again at once."""

    def __init__(self, to_port):
        self._to = to_port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._ends = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._to))
            self._ends += [near, far]
            for a, b in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(a, b), daemon=True).start()

    @staticmethod
    def _pump(a, b):
        try:
            while chunk := a.recv(65536):
                b.sendall(chunk)
        except OSError:
            pass
        finally:
            for end in (a, b):
                end.close()

    def cut(self):
        for end in self._ends:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
        self._ends = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._server.close()
        self.cut()


class Deaf:
    """Takes an MQTT 5 connection and acknowledges nothing; counts PUBLISH packets."""

    CONNACK = bytes([0x20, 3, 0, 0, 0])

    def __init__(self):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.publishes = 0
        self._connections = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self._connections.append(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection):
        stream = connection.makefile("rb")
        try:
            while head := stream.read(1):
                length, shift = 0, 0
                while True:
                    byte = stream.read(1)[0]
                    length |= (byte & 127) << shift
                    shift += 7
                    if byte < 128:
                        break
                stream.read(length)
                if head[0] >> 4 == 1:
                    connection.sendall(self.CONNACK)
                elif head[0] >> 4 == 3:
                    self.publishes += 1
        except (OSError, IndexError, ssl.SSLError):
            pass

    def hang_up(self):
        for connection in self._connections:
            connection.shutdown(socket.SHUT_RDWR)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._server.close()


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
