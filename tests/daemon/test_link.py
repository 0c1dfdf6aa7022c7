"""The link against a real mosquitto: delivery, outages, passwords, and what a technician is told."""

import logging
import os
import signal
import subprocess
import time

import pytest
from brokers import MOSQUITTO, Mosquitto, Subscriber, free_port
from descriptors import all_low_ones_taken
from links import OFFLINE, ONLINE, sequences
from nodes import wait_for
from readings import fill
from relays import Cable, Deaf

from sagnode.daemon import session
from sagnode.daemon.journal import Journal

pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


@pytest.mark.parametrize("mqtt5", [True, False])
def test_readings_arrive_and_are_delivered_on_puback(tmp_path, node, mqtt5):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port, mqtt5=mqtt5)
        n.make(3)
        n.link.show("health", b'{"ok":1}')
        subscriber.wait_for(lambda s: len(s.readings()) == 9 and s.of("health"))
        assert sorted(sequences(subscriber)) == list(range(1, 10))
        wait_for(lambda: n.journal.backlog().depth == 0)
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
        wait_for(lambda: n.journal.backlog().depth == 0)
        with Subscriber(broker.port) as late:
            late.wait_for(lambda s: len(s.readings()) == 3)
            assert sorted(sequences(late)) == [58, 59, 60]
            assert not any(r["backfill"] for r in late.readings())
            assert all(m.retain for m in late.of("measurement"))


def test_a_newest_reading_that_nobody_renews_vanishes_from_the_broker(tmp_path, node):
    def retained(broker):
        with Subscriber(broker.port) as late:
            late.wait_for(lambda s: s.of("status"))
            time.sleep(0.1)
            return sorted(sequences(late))

    with Mosquitto(tmp_path) as broker:
        n = node(port=broker.port, expiry_s=45 * 60 + 3)  # they are 45, 30 and 15 minutes old when they are sent
        n.make(1)
        wait_for(lambda: n.journal.backlog().depth == 0)
        assert retained(broker) == [1, 2, 3]
        wait_for(lambda: retained(broker) == [2, 3])


def test_under_mqtt_3_1_1_it_stays(tmp_path, node):
    with Mosquitto(tmp_path) as broker:
        n = node(port=broker.port, expiry_s=45 * 60 + 1, mqtt5=False)  # the oldest is 45 minutes old when it is sent
        n.make(1)
        wait_for(lambda: n.journal.backlog().depth == 0)
        time.sleep(2.0)
        with Subscriber(broker.port) as late:
            late.wait_for(lambda s: len(s.readings()) == 3)


def test_clean_stop_says_offline_and_a_lost_node_is_told_by_its_will(tmp_path, node):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port)
        n.make(1)
        n.wait_connected()
        n.link.stop(5.0, OFFLINE)
        subscriber.wait_for(lambda s: [m.payload for m in s.of("status")] == [ONLINE, OFFLINE])
        assert n.journal.backlog().depth == 0
        with Subscriber(broker.port, "t/1/status") as late:
            late.wait_for(lambda s: s.messages)
            assert late.messages[0].retain
            assert late.messages[0].payload == OFFLINE
        with Subscriber(broker.port) as late:  # its last readings stay
            late.wait_for(lambda s: sorted(sequences(s)) == [1, 2, 3])


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
        n.link.stop(0.5, OFFLINE)
        # one acknowledgement that is waited for would take longer
        assert time.monotonic() - before < session.PUBACK_WAIT_S


def test_a_backlog_is_drained_fast_and_a_fresh_reading_does_not_wait(tmp_path, node):
    with Mosquitto(tmp_path, "max_queued_messages 0") as broker, Subscriber(broker.port) as subscriber:
        journal = Journal(tmp_path / "journal.sqlite")
        for _ in range(12):
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
        assert sorted(sequences(subscriber)) == list(range(1, 1204))


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


def test_a_second_client_with_the_same_name_is_told(tmp_path, node):
    with Mosquitto(tmp_path) as broker:
        n = node(port=broker.port)
        n.wait_connected()
        with Subscriber(broker.port, prepare=lambda c: setattr(c, "_client_id", b"node-1")):
            n.wait_state("client_id")


def test_after_its_end_nothing_of_it_is_left_open_and_a_late_word_disturbs_nobody(node):
    n = node(port=free_port())
    ends = (n.link._mailbox.nudged, n.link._mailbox._nudge)
    n.link.stop(0.0, OFFLINE)
    for end in ends:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(end)
    others = os.pipe2(os.O_NONBLOCK)  # gets the numbers that have become free
    try:
        assert set(others) == set(ends)
        n.link.wake()
        n.link.stop(0.0, OFFLINE)
        with pytest.raises(BlockingIOError):
            os.read(others[0], 1)
    finally:
        for end in others:
            os.close(end)


def test_descriptors_above_a_thousand_are_as_good_as_others(tmp_path, node):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber:
        with all_low_ones_taken():
            n = node(port=broker.port)
            assert n.link._mailbox.nudged > 1023
            n.make(3)
            subscriber.wait_for(lambda s: len(s.readings()) == 9)
            n.link.stop(5.0, OFFLINE)
        assert "connected" not in n.link.state


def test_the_reason_to_hang_up_that_a_broker_gave_is_told_while_its_resets_overtake_the_next_ones(node):
    quota_exceeded = bytes([0xE0, 2, 0x97, 0])
    with Deaf(quota_exceeded, b"", b"") as broker:
        n = node(port=broker.port)
        n.wait_state("the broker hung up: Quota exceeded")
        seen = set()
        wait_for(lambda: seen.add(n.link.state) or broker.connections == 4)
    where = f"127.0.0.1:{broker.port}"
    assert seen == {f"{where}: the broker hung up: Quota exceeded", f"connected to {where}"}


def test_what_is_larger_than_the_broker_takes_is_not_sent_and_said_and_the_rest_goes(tmp_path, node, caplog):
    with Mosquitto(tmp_path, "max_packet_size 1000") as broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port)
        n.make(2)
        n.link.show("health", b"{}")
        n.link.show("alarm/L1/sag", b"x" * 1000)
        subscriber.wait_for(lambda s: s.of("health"))
        wait_for(lambda: n.link.set_aside == 6 and "alarm" in n.link.delivery)
        assert "takes packets of 1000" in n.link.delivery
        assert "limit of a packet's size" in n.link.delivery
        assert "alarm/L1/sag (" in n.link.delivery
        time.sleep(1.0)
        assert n.link.connected
        assert caplog.text.count("connection") == 0
        n.link.show("alarm/L1/sag", b"")
        wait_for(lambda: "alarm" not in n.link.delivery)


@pytest.mark.parametrize("size", [1, 100, 128, 16_300, 16_400])
def test_a_packet_is_held_against_the_limit_to_the_byte(tmp_path, node, size):
    topic, properties = len("t/1/x"), len(b"\x01\x01") + len(b"\x03\x00\x10application/json")
    rest = 2 + topic + 2 + 1 + properties + size
    packet = 1 + (1 if rest < 128 else 2 if rest < 16_384 else 3) + rest
    for limit, taken in ((max(packet, 200), True), (packet - 1, False)):
        if limit < 200:  # what the link itself says has to go through as well
            continue
        with Mosquitto(tmp_path, f"max_packet_size {limit}") as broker, Subscriber(broker.port) as subscriber:
            n = node(port=broker.port)
            n.wait_connected()
            n.link.say("x", b"x" * size, content_type="application/json")
            if taken:
                subscriber.wait_for(lambda s: s.of("x"))
            else:
                wait_for(lambda n=n: "x (" in n.link.delivery)
            assert n.link.connected
            n.close()


def test_a_broker_of_the_older_protocol_that_hangs_up_on_large_packets_is_not_blamed_on_the_name_alone(tmp_path, node):
    with Mosquitto(tmp_path, "max_packet_size 1000") as broker:
        n = node(port=broker.port, mqtt5=False)
        n.make(1)
        n.wait_state("it may not bear packets of")


def test_a_broker_that_keeps_no_messages_is_told_by_what_it_has_to_permit(tmp_path, node):
    with Mosquitto(tmp_path, "retain_available false") as broker:
        n = node(port=broker.port)
        n.wait_state("Retain not supported; it must permit QoS 1 and retained messages")
