"""What passes between a node and its broker, counted for docs/performance.md."""

import socket
import threading

import pytest

from performance import proxy
from performance.packets import Packets


def test_the_proxy_counts_what_passes():
    with socket.create_server(("127.0.0.1", 0)) as broker:
        answered = threading.Event()

        def answer():
            connection, _ = broker.accept()
            with connection:
                got = 0
                while got < 5000:
                    got += len(connection.recv(65536))
                connection.sendall(b"y" * 700)
                answered.wait(5)

        threading.Thread(target=answer, daemon=True).start()
        with proxy.Proxy(broker.getsockname()[1]) as between:
            with socket.create_connection(("127.0.0.1", between.port)) as client:
                client.sendall(b"x" * 5000)
                got = 0
                while got < 700:
                    got += len(client.recv(65536))
                passed = between.passed()
                answered.set()
            assert (passed.up, passed.down) == (5000, 700)
            # one segment at least for the data and one for the connection
            assert passed.segments_up >= 2
            assert passed.since(passed) == proxy.Passed(0, 0, 0)


def mqtt_publish(topic, payload):
    """A PUBLISH packet of QoS 1 in MQTT 3.1.1 (its chapter 3.3)."""
    body = len(topic).to_bytes(2, "big") + topic.encode() + b"\x00\x01" + payload
    length, rest = b"", len(body)
    while True:
        rest, digit = divmod(rest, 128)
        length += bytes([digit | (128 if rest else 0)])
        if not rest:
            return bytes([0x32]) + length + body


@pytest.mark.parametrize("step", [1, 2, 7, 4000])
def test_what_was_sent_is_told_by_message_however_the_stream_is_cut(step):
    long = mqtt_publish("line/unit/measurement/L1", b"x" * 3000)
    stream = long + b"\xc0\x00" + mqtt_publish("line/unit/health", b"y" * 90) + b"\x40\x02\x00\x01" + long
    packets = Packets("line/unit")
    for begin in range(0, len(stream), step):
        packets.take(stream[begin : begin + step])
    assert packets.count == {"measurement": 2, "keep-alive": 1, "health": 1, "acknowledgements": 1}
    assert packets.size["measurement"] == 2 * len(long)
    assert packets.segments["measurement"] == 6
    assert packets.size.total() == len(stream)


def test_half_a_packet_of_a_lost_connection_is_forgotten():
    packets = Packets("")
    packets.take(mqtt_publish("health", b"y" * 90)[:50])
    packets.begin()
    packets.take(b"\xc0\x00")
    assert packets.count == {"keep-alive": 1}
